"""The normal equations of a bundle: boards eliminated, cameras solved, covariance read off.

With U of cameras and the board's shape, V of the boards (one 6x6 block a frame) and W between,

    S = U - W V^-1 W'        (Schur complement)
    S dc = -gc + W V^-1 gb,   db = V^-1 (-gb - W' dc)

and the inverse of S *is* the joint covariance of all that is not a board.

References
----------
.. [1] D. C. Brown, "A solution to the general problem of multiple station analytical
   stereotriangulation", RCA-MTP Data Reduction Technical Report 43, 1958.
.. [2] B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle Adjustment - A Modern
   Synthesis", 2000, section 6.1.
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.least_squares import Step, inverse_of_scaled
from calichrome.core.pose import cross_matrix
from calichrome.geometry.bundle.blocks import ViewBlocks
from calichrome.geometry.bundle.observations import Observations
from calichrome.geometry.bundle.state import BundleState, Free, Priors, adjoint

__all__ = ["BundleEquations"]

_TAKES_PART = 0.1  # component of a unit vector, scaled: smaller ones are passengers; a choice


class BundleEquations:
    """A bundle linearised at one state.

    Parameters
    ----------
    observations, state, free, priors
        What it belongs to.
    blocks
        Of the views.
    """

    __slots__ = (
        "_blocks",
        "_boards",
        "_camera_gradient",
        "_cameras",
        "_coupling",
        "_diagonal",
        "_free",
        "_freedom",
        "_is_seen",
        "_observations",
        "_priors",
        "_starts",
        "_state",
        "cost",
        "n_residuals",
    )

    def __init__(
        self,
        observations: Observations,
        state: BundleState,
        free: Free,
        blocks: ViewBlocks,
        priors: Priors | None = None,
    ) -> None:
        self._observations, self._state = observations, state
        self.cost = blocks.cost
        self.n_residuals = 2 * observations.n_corners
        self._blocks, self._freedom, self._priors = blocks, free, priors
        self._free = np.flatnonzero(free.mask)
        n_cameras, n_lens = state.lens_parameters.shape
        n_own, n_shape = n_lens + 6, len(state.shape)
        n_all, n_views = n_cameras * n_own + n_shape, len(observations.camera)
        products = blocks.products

        hessian = np.zeros((n_all, n_all))
        gradient = np.zeros(n_all)
        by_shape = slice(n_cameras * n_own, n_all)
        for camera in range(n_cameras):  # one at a time: the copy of its products stays in cache
            block = products[observations.camera == camera].sum(axis=0)
            own = slice(camera * n_own, (camera + 1) * n_own)
            hessian[own, own] = block[:n_own, :n_own]
            hessian[own, by_shape] = block[:n_own, n_own:-1]
            hessian[by_shape, own] = block[n_own:-1, :n_own]
            hessian[by_shape, by_shape] += block[n_own:-1, n_own:-1]
            gradient[own] = block[:n_own, -1]
            gradient[by_shape] += block[n_own:-1, -1]
        if priors is not None:
            deviation, weight = priors.pull(state)
            hessian[np.diag_indices(n_all)] += weight**2
            gradient += weight * deviation
            self.cost += 0.5 * float(deviation @ deviation)
            self.n_residuals += int((weight > 0).sum())
        self._cameras, self._camera_gradient = hessian, gradient

        moves = adjoint(state.cam_rotations, state.cam_trans_m)[observations.camera]
        pose = slice(n_lens, n_own)
        self._coupling = products[:, :-1, pose] @ moves
        boards = moves.transpose(0, 2, 1) @ self._coupling[:, pose]
        slopes = np.einsum("vij,vi->vj", moves, products[:, pose, -1])
        frames, self._starts = np.unique(observations.frame, return_index=True)
        n_frames = observations.n_frames
        hessians, gradients = np.zeros((n_frames, 6, 6)), np.zeros((n_frames, 6))
        if n_views:
            hessians[frames] = np.add.reduceat(boards, self._starts)
            gradients[frames] = np.add.reduceat(slopes, self._starts)
        self._is_seen: BoolArray = np.asarray(hessians.any(axis=(1, 2)))
        hessians[~self._is_seen] = np.eye(6)  # a frame without weight stays where it is
        self._boards = frames, hessians[frames], gradients[frames]
        self._diagonal = np.einsum("fii->fi", self._boards[1]).copy()

    def reweighted(self, factors: FloatArray) -> "BundleEquations":
        """Return the same with every view's whitening multiplied by its factor, (V,).

        Of least squares; a robust cost would have other weights.
        """
        products = self._blocks.products * (factors**2)[:, None, None]
        blocks = ViewBlocks(products, 0.5 * float(products[:, -1, -1].sum()))
        return BundleEquations(self._observations, self._state, self._freedom, blocks, self._priors)

    def step(self, damping: float) -> Step | None:
        """Solve (H + damping diag H) d = -g."""
        frames, hessians, board_gradient = self._boards
        damped = hessians.copy()
        damped[:, range(6), range(6)] += damping * np.maximum(self._diagonal, 1e-300)
        try:
            inverse_roots = np.linalg.inv(np.linalg.cholesky(damped))
        except np.linalg.LinAlgError:
            return None
        diagonal = np.diag(self._cameras).copy()
        reduced, eliminated = self._eliminate(inverse_roots)
        lowered = np.einsum("fij,fj->fi", inverse_roots, board_gradient)
        rows = self._frame_rows()
        side = -self._camera_gradient + self._scatter((lowered[rows, None] @ eliminated)[:, 0])
        camera_step = np.zeros(len(diagonal))
        free = self._free
        if len(free):
            scale = np.sqrt(np.maximum(diagonal[free], 1e-300))
            matrix = reduced[np.ix_(free, free)] / np.outer(scale, scale)
            matrix[np.diag_indices(len(free))] += damping  # also of what nothing depends on
            try:
                factor = cho_factor(matrix, overwrite_a=True)
            except LinAlgError:
                return None
            camera_step[free] = cho_solve(factor, side[free] / scale) / scale
        taken = (eliminated @ self._gather(camera_step)[:, :, None])[:, :, 0]
        answers = -lowered
        if len(taken):
            answers -= np.add.reduceat(taken, self._starts)
        board_step = np.einsum("fij,fi->fj", inverse_roots, answers)

        slope = float(self._camera_gradient @ camera_step) + float(
            np.vdot(board_gradient, board_step)
        )
        held = float(diagonal @ camera_step**2) + float(np.vdot(self._diagonal, board_step**2))
        largest = max(
            float(np.max(np.abs(camera_step) * np.sqrt(diagonal), initial=0.0)),
            float(np.max(np.abs(board_step) * np.sqrt(self._diagonal), initial=0.0)),
        )
        by_frame = np.zeros((self._observations.n_frames, 6))
        by_frame[frames] = board_step
        vector = np.concatenate([camera_step, by_frame.ravel()])
        return Step(vector, 0.5 * (damping * held - slope), largest)

    def reduced_hessian(self) -> FloatArray | None:
        """S over the free camera-side unknowns; None where a frame fixes no pose."""
        inverse_roots = self._inverse_roots()
        if inverse_roots is None:
            return None
        reduced, _ = self._eliminate(inverse_roots)
        return reduced[np.ix_(self._free, self._free)]

    def open_columns(self) -> frozenset[int]:
        """Camera-side columns that take part in a direction which the data leave open."""
        reduced = self.reduced_hessian()
        if reduced is None:
            return frozenset(self._free.tolist())
        diagonal = np.diag(reduced)
        scale = np.sqrt(np.maximum(diagonal, 1e-300 + 1e-15 * np.diag(self._cameras)[self._free]))
        values, vectors = np.linalg.eigh(reduced / np.outer(scale, scale))
        is_open = values <= len(values) * np.finfo(np.float64).eps * values[-1:]
        takes_part = (np.abs(vectors[:, is_open]) > _TAKES_PART).any(axis=1)
        return frozenset(self._free[takes_part].tolist())

    def covariance(self) -> FloatArray | None:
        """Joint covariance of lenses, camera poses and shape, for unit noise.

        Returns
        -------
        (C (P + 6) + S, same) float or None
            Zero rows for what is not free; poses as (omega, tau) of `Pose.perturbed`. None where
            the data leave a direction open.
        """
        reduced = self.reduced_hessian()
        inverse = None if reduced is None else inverse_of_scaled(reduced)
        if inverse is None:
            return None
        covariance = np.zeros_like(self._cameras)
        covariance[np.ix_(self._free, self._free)] = inverse
        n_own = self._state.lens_parameters.shape[1] + 6
        for camera, trans_m in enumerate(self._state.cam_trans_m):
            pose = slice((camera + 1) * n_own - 6, (camera + 1) * n_own)
            apart = rotation_and_position(trans_m)
            covariance[pose] = apart @ covariance[pose]
            covariance[:, pose] = covariance[:, pose] @ apart.T
        return covariance

    def board_covariances(self, camera_covariance: FloatArray) -> FloatArray | None:
        """Covariance (F, 6, 6) of (omega, tau) of every board; nan for frames nobody saw.

        V^-1 + V^-1 W' S^-1 W V^-1: the noise of its own corners, and of all cameras.

        Parameters
        ----------
        camera_covariance
            What `covariance` returned.
        """
        inverse_roots = self._inverse_roots()
        if inverse_roots is None:
            return None
        frames, *_ = self._boards
        n_own = self._state.lens_parameters.shape[1] + 6
        joint = camera_covariance.copy()
        for camera, trans_m in enumerate(self._state.cam_trans_m):
            pose = slice((camera + 1) * n_own - 6, (camera + 1) * n_own)
            together = np.linalg.inv(rotation_and_position(trans_m))
            joint[pose] = together @ joint[pose]
            joint[:, pose] = joint[:, pose] @ together.T
        result = np.full((self._observations.n_frames, 6, 6), np.nan)
        ends = [*self._starts[1:], len(self._observations.camera)]
        for row, (frame, first, last) in enumerate(zip(frames, self._starts, ends, strict=True)):
            columns = self._columns(self._observations.camera[first:last])
            coupling = self._frame_coupling(self._coupling[first:last])
            inverse = inverse_roots[row].T @ inverse_roots[row]
            passed = inverse @ coupling.T
            both = inverse + passed @ joint[np.ix_(columns, columns)] @ passed.T
            apart = rotation_and_position(self._state.board_trans_m[frame])
            result[frame] = apart @ both @ apart.T if self._is_seen[frame] else np.nan
        return result

    def shares(self) -> FloatArray:
        """Part of each view in what is known of its board: tr(V^-1 V_view) / 6, (V,); 0 of none."""
        moves = adjoint(self._state.cam_rotations, self._state.cam_trans_m)
        moves = moves[self._observations.camera]
        n_lens = self._state.lens_parameters.shape[1]
        own = moves.transpose(0, 2, 1) @ self._coupling[:, n_lens : n_lens + 6]
        roots = self._inverse_roots()
        inverse = (
            np.linalg.pinv(self._boards[1], hermitian=True)  # where a board's pose is not fixed
            if roots is None
            else roots.transpose(0, 2, 1) @ roots
        )
        return np.asarray(np.einsum("vij,vji->v", inverse[self._frame_rows()], own) / 6)

    def _inverse_roots(self) -> FloatArray | None:
        try:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self._boards[1])))
        except np.linalg.LinAlgError:
            return None

    def _frame_rows(self) -> IntArray:
        """Position of each view's frame among the frames that were seen."""
        return np.searchsorted(self._boards[0], self._observations.frame)

    def _eliminate(self, inverse_roots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return S (before damping) and L^-1 W' of each view, (V, 6, K)."""
        rows = self._frame_rows()
        eliminated = inverse_roots[rows] @ self._coupling.transpose(0, 2, 1)
        reduced = self._cameras.copy()
        n_cameras, n_lens = self._state.lens_parameters.shape
        n_own = n_lens + 6
        own = np.ascontiguousarray(eliminated[:, :, :n_own])
        for pair in self._observations.shared:
            first, second = (slice(camera * n_own, (camera + 1) * n_own) for camera in pair.cameras)
            left, right = own[pair.first], own[pair.second]
            product = left.reshape(-1, n_own).T @ right.reshape(-1, n_own)
            reduced[first, second] -= product
            if pair.cameras[0] != pair.cameras[1]:
                reduced[second, first] -= product.T
        if len(self._state.shape) and len(rows):
            by_shape = slice(n_cameras * n_own, len(reduced))
            shape = np.add.reduceat(eliminated[:, :, n_own:], self._starts)
            by_camera = np.zeros((n_cameras, n_own, len(self._state.shape)))
            np.add.at(by_camera, self._observations.camera, own.transpose(0, 2, 1) @ shape[rows])
            coupled = by_camera.reshape(n_cameras * n_own, -1)
            reduced[: by_shape.start, by_shape] -= coupled
            reduced[by_shape, : by_shape.start] -= coupled.T
            flat = shape.reshape(-1, shape.shape[2])
            reduced[by_shape, by_shape] -= flat.T @ flat
        return reduced, eliminated

    def _columns(self, cameras: IntArray) -> IntArray:
        """Camera-side columns of some cameras, then of the shape."""
        n_cameras, n_lens = self._state.lens_parameters.shape
        own = cameras[:, None] * (n_lens + 6) + np.arange(n_lens + 6)
        shape = n_cameras * (n_lens + 6) + np.arange(len(self._state.shape))
        return np.concatenate([own.ravel(), shape])

    def _frame_coupling(self, views: FloatArray) -> FloatArray:
        """Stack W of the views of one frame: their cameras, then the shape."""
        n_own = self._state.lens_parameters.shape[1] + 6
        return np.concatenate([views[:, :n_own].reshape(-1, 6), views[:, n_own:].sum(axis=0)])

    def _scatter(self, by_view: FloatArray) -> FloatArray:
        """Sum (V, K) of views to the camera side."""
        n_cameras, n_lens = self._state.lens_parameters.shape
        n_own = n_lens + 6
        own = np.zeros((n_cameras, n_own))
        np.add.at(own, self._observations.camera, by_view[:, :n_own])
        return np.concatenate([own.ravel(), by_view[:, n_own:].sum(axis=0)])

    def _gather(self, camera_side: FloatArray) -> FloatArray:
        """Hand each view its columns of the camera side, (V, K)."""
        n_cameras, n_lens = self._state.lens_parameters.shape
        n_own = n_lens + 6
        own = camera_side[: n_cameras * n_own].reshape(n_cameras, n_own)
        shape = camera_side[n_cameras * n_own :]
        camera = self._observations.camera
        return np.hstack([own[camera], np.broadcast_to(shape, (len(camera), len(shape)))])


def rotation_and_position(trans_m: FloatArray) -> FloatArray:
    """From a left perturbation to (omega, change of position) of `Pose.perturbed`, (6, 6).

    exp(omega) (R x + t) + tau moves the position t by omega x t + tau.
    """
    jacobian = np.eye(6)
    jacobian[3:, :3] = -cross_matrix(trans_m)
    return jacobian

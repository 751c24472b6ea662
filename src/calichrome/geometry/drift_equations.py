"""New views against a calibration: least squares over boards, its doubts, and allowed changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Protocol

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.least_squares import Step, damped_step, inverse_of_scaled, levenberg_marquardt
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import BoardShape, BundleState, Observations, ObservedView
from calichrome.geometry.bundle.blocks import view_blocks
from calichrome.geometry.bundle.state import adjoint
from calichrome.geometry.camera_start import PlacedView
from calichrome.geometry.comparison import root_of
from calichrome.geometry.displacement import about_camera, displacement
from calichrome.geometry.lenses import Lens

__all__ = ["LENS_CHANGE", "Change", "DriftFit", "DriftProblem", "leftovers"]

Change = tuple[Literal["place", "lens"], str]
LENS_CHANGE = ("focal", "cx", "cy")
"""Relative change of fx and fy together; shift of the principal point, pixels."""

Views = Mapping[str, Mapping[str, ObservedView]]
_CONVERGED = 1e-9  # of a chi-square of thousands, whose differences are judged to tenths
_N_MOTION, _N_LENS = 6, len(LENS_CHANGE)


class Known(Protocol):
    """What is used of a `KnownRig`."""

    @property
    def lenses(self) -> Mapping[str, Lens]: ...
    @property
    def cams_from_ref(self) -> Mapping[str, Pose]: ...
    @property
    def corners_board(self) -> FloatArray: ...
    @property
    def shape(self) -> BoardShape: ...
    @property
    def shape_parameters(self) -> FloatArray: ...
    @property
    def cov(self) -> FloatArray | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Where a fit stands.

    Parameters
    ----------
    bundle
        Lenses, cameras, boards and shape with all that follows applied.
    doubts : (r,) float
        Errors of the calibration, of unit variance.
    motions : (C, 6) float
        Moves of cameras, about each.
    lenses : (C, 3) float
        Changes of lenses.
    """

    bundle: BundleState
    doubts: FloatArray
    motions: FloatArray
    lenses: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations over the columns that are free."""

    cost: float
    n_residuals: int
    hessian: FloatArray
    gradient: FloatArray

    def step(self, damping: float) -> Step | None:
        return damped_step(self.hessian, self.gradient, damping)


@dataclass(frozen=True, slots=True, eq=False)
class DriftFit:
    """The minimum with some changes allowed.

    Parameters
    ----------
    state
        There.
    chi_square
        Squared whitened residuals, of corners and of the calibration.
    estimates
        Change -> value and covariance; empty where the views leave a direction open.
    """

    state: _State
    chi_square: float
    estimates: Mapping[Change, tuple[FloatArray, FloatArray]]

    def estimate(self, change: Change) -> tuple[FloatArray, FloatArray] | None:
        """Value and covariance of an allowed change; None where it is open."""
        return self.estimates.get(change)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftProblem:
    """Views, linearised in doubts, boards, moves and lens changes.

    Parameters
    ----------
    cameras
        Ids, in the order of the rows of all states.
    observations, start
        Whitened to unit variance; everything as calibrated.
    passed : (V, K, N) float
        What a step of all N unknowns (doubts, boards, motions, lenses) does to the K columns of a
        view (lens, pose, shape), boards aside: these turn with the cameras.
    roots : (n, r) float
        Of the calibration's covariance, in the rows of a state.
    own_places
        Row of a camera -> one of its frames and where the board is in that view.
    """

    cameras: tuple[str, ...]
    observations: Observations
    start: _State
    passed: FloatArray
    roots: FloatArray
    own_places: Mapping[int, tuple[int, Pose]]

    @classmethod
    def build(
        cls,
        known: Known,
        views: Views,
        boards: Mapping[str, Pose],
        places: Mapping[tuple[str, str], PlacedView],
    ) -> "DriftProblem":
        """Pack `views`; `boards` is where frames, `places` where single views have the board."""
        cameras: tuple[str, ...] = tuple(known.lenses)
        frames: list[str] = list(boards)
        packed = [
            replace(view, camera=cameras.index(camera), frame=frames.index(frame))
            for camera, own in views.items()
            for frame, view in own.items()
        ]
        lenses = [known.lenses[camera] for camera in cameras]
        motions = [known.cams_from_ref[camera] for camera in cameras]
        bundle = BundleState.build(
            lenses, motions, list(boards.values()), known.shape, known.shape_parameters
        )
        observations = Observations.pack(packed, known.corners_board, bundle.models, len(frames))
        roots = _roots(known, bundle)
        n_doubts, n_cameras = roots.shape[1], len(cameras)
        start = _State(
            bundle, np.zeros(n_doubts), np.zeros((n_cameras, _N_MOTION)),
            np.zeros((n_cameras, _N_LENS)),
        )  # fmt: skip
        passed = _passed(observations, bundle, roots)
        return cls(
            cameras=cameras,
            observations=observations,
            start=start,
            passed=passed,
            roots=roots,
            own_places={
                cameras.index(camera): (
                    frames.index(frame), places[camera, frame].cams_from_board[0]
                )
                for camera, frame in reversed(list(places))
            },
        )  # fmt: skip

    def columns(self, change: Change) -> IntArray:
        """Unknowns of a change."""
        kind, camera = change
        n_cameras, row = len(self.cameras), self.cameras.index(camera)
        first = len(self.start.doubts) + 6 * self.observations.n_frames
        if kind == "place":
            return first + _N_MOTION * row + np.arange(_N_MOTION)
        return first + _N_MOTION * n_cameras + _N_LENS * row + np.arange(_N_LENS)

    def allow(self, change: Change, beside: DriftFit, changes: Sequence[Change]) -> DriftFit:
        """Minimise with one more change allowed beside `changes`, whose fit is `beside`.

        A camera that moved far is best begun where its own views put it; if that leads astray, from
        where the rest of the rig left it.
        """
        begin = beside.state if changes else self.start
        if change[0] == "place":
            begin = self._replaced(begin, self.cameras.index(change[1]))
        trial = self.fit((*changes, change), begin)
        if trial.chi_square > beside.chi_square:
            trial = self.fit((*changes, change), beside.state)
        return trial

    def _replaced(self, state: _State, row: int) -> _State:
        """Put a camera where its own view of the first shared board says."""
        frame, cam_from_board = self.own_places[row]
        bundle = state.bundle
        before = Pose(bundle.cam_rotations[row], bundle.cam_trans_m[row])
        board = Pose(bundle.board_rotations[frame], bundle.board_trans_m[frame])
        after = cam_from_board @ board.inverse()
        rotations, trans_m = bundle.cam_rotations.copy(), bundle.cam_trans_m.copy()
        rotations[row], trans_m[row] = after.rotation, after.trans_m
        motions = state.motions.copy()
        motions[row] += displacement(before, after, None).motion
        return replace(
            state,
            bundle=replace(bundle, cam_rotations=rotations, cam_trans_m=trans_m),
            motions=motions,
        )

    def fit(self, changes: Sequence[Change], start: _State | None = None) -> DriftFit:
        """Minimise with some changes allowed."""
        n_always = len(self.start.doubts) + 6 * self.observations.n_frames
        free = np.concatenate(
            [np.arange(n_always), *(self.columns(change) for change in changes)]
        ).astype(np.int64)
        begin = start or self.start
        with np.errstate(invalid="ignore", over="ignore"):  # of impossible trial states
            found = levenberg_marquardt(
                begin, partial(self._linearise, free=free), partial(self._moved, free=free),
                relative_decrease=_CONVERGED, damping=1e-6,
            )  # fmt: skip
        cov = inverse_of_scaled(found.equations.hessian)
        estimates = {}
        if cov is not None:
            for change in changes:
                rows = np.flatnonzero(np.isin(free, self.columns(change)))
                values = found.state.motions if change[0] == "place" else found.state.lenses
                estimates[change] = (
                    values[self.cameras.index(change[1])], cov[np.ix_(rows, rows)]
                )  # fmt: skip
        return DriftFit(found.state, 2 * found.cost, estimates)

    def _linearise(self, state: _State, free: IntArray) -> _Equations:
        blocks = view_blocks(self.observations, state.bundle)
        camera = self.observations.camera
        n_lens = state.bundle.lens_parameters.shape[1]
        n_doubts = len(state.doubts)
        passed = self.passed.copy()
        moves = adjoint(state.bundle.cam_rotations, state.bundle.cam_trans_m)[camera]
        for view, frame in enumerate(self.observations.frame):
            board = slice(n_doubts + 6 * frame, n_doubts + 6 * frame + 6)
            passed[view, n_lens : n_lens + 6, board] = moves[view]
        passed = passed[:, :, free]
        products = blocks.products
        hessian = np.einsum("vkn,vkm->nm", passed, products[:, :-1, :-1] @ passed, optimize=True)
        gradient = np.einsum("vkn,vk->n", passed, products[:, :-1, -1])
        hessian[range(n_doubts), range(n_doubts)] += 1
        gradient[:n_doubts] += state.doubts
        cost = blocks.cost + 0.5 * float(state.doubts @ state.doubts)
        n_residuals = 2 * self.observations.n_corners + n_doubts
        return _Equations(cost, n_residuals, hessian, gradient)

    def _moved(self, state: _State, vector: FloatArray, free: IntArray) -> _State:
        n_doubts, n_boards = len(state.doubts), 6 * self.observations.n_frames
        step = np.zeros(self.passed.shape[2])
        step[free] = vector
        doubts, boards = step[:n_doubts], step[n_doubts : n_doubts + n_boards]
        n_motions = state.motions.size
        motions = step[n_doubts + n_boards :][:n_motions].reshape(state.motions.shape)
        lenses = step[n_doubts + n_boards + n_motions :].reshape(state.lenses.shape)
        by_camera, by_shape = self._split(self.roots @ doubts)
        n_lens = state.bundle.lens_parameters.shape[1]
        by_camera[:, :4] += _lens_step(self.start.bundle, lenses)
        by_camera[:, n_lens:] += motions
        bundle = state.bundle.moved(np.concatenate([by_camera.ravel(), by_shape, boards]))
        return _State(bundle, state.doubts + doubts, state.motions + motions,
                      state.lenses + lenses)  # fmt: skip

    def _split(self, camera_side: FloatArray) -> tuple[FloatArray, FloatArray]:
        n_cameras, n_lens = self.start.bundle.lens_parameters.shape
        n_own = n_cameras * (n_lens + 6)
        return camera_side[:n_own].reshape(n_cameras, -1).copy(), camera_side[n_own:]


def _lens_step(start: BundleState, changes: FloatArray) -> FloatArray:
    """Return steps (C, 4) of fx, fy, cx, cy."""
    focal = start.lens_parameters[:, :2] * changes[:, :1]
    return np.hstack([focal, changes[:, 1:]])


def _roots(known: Known, bundle: BundleState) -> FloatArray:
    """Root of the calibration's covariance, about each camera, in rows as states step."""
    n_cameras, n_lens = bundle.lens_parameters.shape
    n_all = n_cameras * (n_lens + 6) + len(bundle.shape)
    if known.cov is None:
        return np.zeros((n_all, 0))
    root = root_of(known.cov)
    placed = np.zeros((n_all, root.shape[1]))
    first = 0
    for row, (lens, pose) in enumerate(
        zip(known.lenses.values(), known.cams_from_ref.values(), strict=True)
    ):
        n_own, place = len(lens.NAMES), row * (n_lens + 6)
        placed[place : place + n_own] = root[first : first + n_own]
        motion = root[first + n_own : first + n_own + 6]
        placed[place + n_lens : place + n_lens + 6] = about_camera(pose.trans_m) @ motion
        first += n_own + 6
    placed[n_cameras * (n_lens + 6) :] = root[first:]
    return placed


def _passed(observations: Observations, bundle: BundleState, roots: FloatArray) -> FloatArray:
    n_cameras, n_lens = bundle.lens_parameters.shape
    n_doubts, n_shape, n_boards = roots.shape[1], len(bundle.shape), 6 * observations.n_frames
    n_all = n_doubts + n_boards + n_cameras * (_N_MOTION + _N_LENS)
    passed = np.zeros((len(observations.camera), n_lens + 6 + n_shape, n_all))
    for view, camera in enumerate(observations.camera):
        own = slice(camera * (n_lens + 6), (camera + 1) * (n_lens + 6))
        passed[view, : n_lens + 6, :n_doubts] = roots[own]
        passed[view, n_lens + 6 :, :n_doubts] = roots[n_cameras * (n_lens + 6) :]
        motion = n_doubts + n_boards + _N_MOTION * camera
        passed[view, n_lens : n_lens + 6, motion : motion + 6] = np.eye(6)
        lens = n_doubts + n_boards + _N_MOTION * n_cameras + _N_LENS * camera
        passed[view, :2, lens] = bundle.lens_parameters[camera, :2]
        passed[view, 2:4, lens + 1 : lens + 3] = np.eye(2)
    return passed


def leftovers(
    known: Known, views: Views, places: Mapping[tuple[str, str], PlacedView]
) -> dict[tuple[str, str], tuple[float, int]]:
    """Return what no place, lens or board shape explains: chi-square and its degrees.

    (camera, frame) -> for each view by itself, to first order from its own place.
    """
    found = {}
    for camera, own in views.items():
        lens = known.lenses[camera]
        poses = [places[camera, frame].cams_from_board[0] for frame in own]
        state = BundleState.build(
            [lens], [Pose.identity()], poses, known.shape, known.shape_parameters
        )
        packed = [replace(view, camera=0, frame=row) for row, view in enumerate(own.values())]
        observations = Observations.pack(packed, known.corners_board, state.models, len(packed))
        products = view_blocks(observations, state).products
        for view, order in enumerate(observations.order):
            frame = list(own)[order]
            block = products[view]
            scale = np.sqrt(np.maximum(np.diag(block)[:-1], 1e-300))
            columns = block[:-1, :-1] / np.outer(scale, scale)
            values, vectors = np.linalg.eigh(columns)
            kept = values > 1e-10 * values[-1]
            along = (vectors[:, kept].T @ (block[:-1, -1] / scale)) ** 2 / values[kept]
            freedom = 2 * len(packed[order].pixels) - int(kept.sum())
            found[camera, frame] = max(float(block[-1, -1] - along.sum()), 0.0), freedom
    return found

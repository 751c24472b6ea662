"""What is unknown, how it moves, and what of it is free."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.bundle.board_shape import BoardShape
from calichrome.geometry.lenses import Lens

__all__ = ["BundleState", "Free", "Priors", "adjoint"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BundleState:
    """All unknowns, in arrays: one row a camera or frame.

    Parameters
    ----------
    models
        Lens model of each camera.
    lens_parameters : (C, P) float
        In the order of each model's names; P is the longest, the rest is 0.
    cam_rotations, cam_trans_m : (C, 3, 3), (C, 3) float
        cam_from_ref.
    board_rotations, board_trans_m : (F, 3, 3), (F, 3) float
        ref_from_board.
    shape
        What the board's shape is made of.
    shape_parameters : (S,) float

    Notes
    -----
    A step moves poses by their *left* perturbation, x -> exp(omega) x + tau, so that the derivative
    of a view by its camera's pose is that by the view's pose cam_from_board itself.
    """

    models: tuple[type[Lens], ...]
    lens_parameters: FloatArray
    cam_rotations: FloatArray
    cam_trans_m: FloatArray
    board_rotations: FloatArray
    board_trans_m: FloatArray
    shape: BoardShape
    shape_parameters: FloatArray

    @classmethod
    def build(
        cls,
        lenses: Sequence[Lens],
        cams_from_ref: Sequence[Pose],
        ref_from_boards: Sequence[Pose],
        shape: BoardShape,
        shape_parameters: FloatArray | None = None,
    ) -> "BundleState":
        """Gather a state from values."""
        parameters = np.zeros((len(lenses), max(len(lens.NAMES) for lens in lenses)))
        for row, lens in zip(parameters, lenses, strict=True):
            row[: len(lens.NAMES)] = lens.parameters
        return cls(
            models=tuple(type(lens) for lens in lenses),
            lens_parameters=parameters,
            cam_rotations=np.stack([pose.rotation for pose in cams_from_ref]),
            cam_trans_m=np.stack([pose.trans_m for pose in cams_from_ref]),
            board_rotations=np.stack([pose.rotation for pose in ref_from_boards]),
            board_trans_m=np.stack([pose.trans_m for pose in ref_from_boards]),
            shape=shape,
            shape_parameters=np.zeros(len(shape)) if shape_parameters is None else shape_parameters,
        )

    @property
    def lenses(self) -> tuple[Lens, ...]:
        """Lenses by camera."""
        return tuple(
            model.from_parameters(row[: len(model.NAMES)])
            for model, row in zip(self.models, self.lens_parameters, strict=True)
        )

    @property
    def cams_from_ref(self) -> tuple[Pose, ...]:
        """Camera poses."""
        return tuple(map(Pose, self.cam_rotations, self.cam_trans_m))

    @property
    def ref_from_boards(self) -> tuple[Pose, ...]:
        """Board poses by frame."""
        return tuple(map(Pose, self.board_rotations, self.board_trans_m))

    def moved(self, step: FloatArray) -> "BundleState":
        """Apply a step (C (P + 6) + S + 6 F,): camera by camera, shape, frame by frame."""
        n_cameras, n_lens = self.lens_parameters.shape
        n_cams, n_shape = n_cameras * (n_lens + 6), len(self.shape)
        by_camera = step[:n_cams].reshape(n_cameras, n_lens + 6)
        by_frame = step[n_cams + n_shape :].reshape(-1, 6)
        cam_rotations, cam_trans_m = _perturbed(
            self.cam_rotations, self.cam_trans_m, by_camera[:, n_lens:]
        )
        board_rotations, board_trans_m = _perturbed(
            self.board_rotations, self.board_trans_m, by_frame
        )
        return replace(
            self,
            lens_parameters=self.lens_parameters + by_camera[:, :n_lens],
            cam_rotations=cam_rotations,
            cam_trans_m=cam_trans_m,
            board_rotations=board_rotations,
            board_trans_m=board_trans_m,
            shape_parameters=self.shape_parameters + step[n_cams : n_cams + n_shape],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Free:
    """What may move; boards always do.

    Parameters
    ----------
    lenses : (C, P) bool
    cameras : (C,) bool
        Poses.
    shape : (S,) bool
    """

    lenses: BoolArray
    cameras: BoolArray
    shape: BoolArray

    @classmethod
    def everything(cls, state: BundleState, reference: int = 0) -> "Free":
        """All but the pose of the reference camera."""
        lengths = np.array([len(model.NAMES) for model in state.models])
        n_cameras, n_lens = state.lens_parameters.shape
        return cls(
            lenses=np.arange(n_lens) < lengths[:, None],
            cameras=np.arange(n_cameras) != reference,
            shape=np.ones(len(state.shape), dtype=bool),
        )

    @classmethod
    def only_boards(cls, state: BundleState) -> "Free":
        """Cameras, lenses and the board's shape are known."""
        return cls(
            lenses=np.zeros(state.lens_parameters.shape, dtype=bool),
            cameras=np.zeros(len(state.models), dtype=bool),
            shape=np.zeros(len(state.shape), dtype=bool),
        )

    @property
    def mask(self) -> BoolArray:
        """Of the camera side of a step, (C (P + 6) + S,)."""
        poses = np.repeat(self.cameras[:, None], 6, axis=1)
        return np.concatenate([np.hstack([self.lenses, poses]).ravel(), self.shape])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Priors:
    """Gaussian knowledge from elsewhere.

    Parameters
    ----------
    lens_mean, lens_sigma : (C, P) float
        Sigma inf where nothing is known.
    shape_mean, shape_sigma : (S,) float
    """

    lens_mean: FloatArray
    lens_sigma: FloatArray
    shape_mean: FloatArray
    shape_sigma: FloatArray

    def pull(self, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Return weighted deviations and weights (1/sigma) of the camera side of a step."""
        n_cameras = len(state.models)
        poses = np.zeros((n_cameras, 6))
        weight = np.concatenate(
            [np.hstack([1 / self.lens_sigma, poses]).ravel(), 1 / self.shape_sigma]
        )
        deviation = np.concatenate(
            [
                np.hstack([state.lens_parameters - self.lens_mean, poses]).ravel(),
                state.shape_parameters - self.shape_mean,
            ]
        )
        return weight * deviation, weight


def adjoint(rotations: FloatArray, trans_m: FloatArray) -> FloatArray:
    """Return Ad of motions, (..., 6, 6): T exp(x) = exp(Ad x) T, for x = (omega, tau).

    References
    ----------
    .. [1] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
       2018, eq. 175 (there with tau first).
    """
    result = np.zeros((*trans_m.shape[:-1], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotations
    result[..., 3:, :3] = cross_matrix(trans_m) @ rotations
    return result


def _perturbed(
    rotations: FloatArray, trans_m: FloatArray, steps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
    return turns @ rotations, np.einsum("nij,nj->ni", turns, trans_m) + steps[:, 3:]

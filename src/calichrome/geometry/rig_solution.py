"""What a solved rig holds, whichever way it was solved."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import BoardShape
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.lenses import Lens
from calichrome.observations import Dataset

__all__ = ["JointCovariance", "PairSummary", "RigSolution", "rms_px"]


def rms_px(residuals_px: FloatArray) -> float:
    """Root mean square 2-D distance, as OpenCV reports it."""
    return float(np.sqrt((residuals_px**2).sum(axis=-1).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class PairSummary:
    """Two cameras that share frames, and their error together."""

    n_shared: int
    rms_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointCovariance:
    """Covariance of all cameras together.

    Parameters
    ----------
    columns : camera -> (P + 6,) int
        Rows of each camera: its lens in the order of the model's names, then (omega, tau) of
        cam_from_ref as `Pose.perturbed` defines them.
    shape : (S,) int
        Rows of the board's shape.
    matrix : (n, n) float
        Zero where a parameter is fixed.
    """

    columns: Mapping[str, IntArray]
    shape: IntArray
    matrix: FloatArray

    def of(self, *cameras: str) -> FloatArray:
        """Joint covariance of some cameras, lens then pose of each in turn."""
        rows = np.concatenate([self.columns[camera] for camera in cameras])
        return np.asarray(self.matrix[np.ix_(rows, rows)])

    def lens(self, camera: str) -> FloatArray:
        """Of a camera's lens, (P, P)."""
        return self.of(camera)[:-6, :-6]

    def pose(self, camera: str) -> FloatArray:
        """Of a camera's pose, (6, 6)."""
        return self.of(camera)[-6:, -6:]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigSolution:
    """Lenses, cameras and boards at the minimum.

    Parameters
    ----------
    dataset
        The observations, with corners renumbered where a board was turned.
    reference
        Camera whose frame is ref.
    lenses, cams_from_ref
        By camera.
    ref_from_boards
        By frame.
    residuals_px, inliers
        (camera, frame) -> (N, 2) projected minus observed, and (N,) which corners were believed.
    lens_cov, pose_cov
        By camera; None where the data leave a direction open. Rows of fixed parameters are zero.
    pairs
        (a, b) -> summary, of cameras that share a frame.
    joint
        All cameras together; None for the pairwise way, or where a direction is open.
    noise
        camera -> by what its residuals exceed the stated covariance (pixels, where none was).
    noise_alone
        The same for each camera when it was solved alone.
    shape, shape_parameters
        Of the board.
    apart
        (camera, frame) of views that no board place shared with the other cameras explains; each
        has a place of its own.
    turned
        (camera, frame) of views whose corners were counted from the other end.
    held
        camera -> optional lens parameters that the data do not support and that kept their start.
    converged
        False if the solve gave up before it reached a minimum.
    shape_held
        True if the board was kept flat because the views do not show whether it is.
    open_directions
        camera -> parameters that the data do not determine.
    """

    dataset: Dataset
    reference: str
    lenses: Mapping[str, Lens]
    cams_from_ref: Mapping[str, Pose]
    ref_from_boards: Mapping[str, Pose]
    residuals_px: Mapping[tuple[str, str], FloatArray]
    inliers: Mapping[tuple[str, str], BoolArray]
    lens_cov: Mapping[str, FloatArray | None]
    pose_cov: Mapping[str, FloatArray | None]
    pairs: Mapping[tuple[str, str], PairSummary]
    joint: JointCovariance | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    noise_alone: Mapping[str, float] = field(default_factory=dict)
    shape: BoardShape | None = None
    shape_parameters: FloatArray = field(default_factory=lambda: np.zeros(0))
    apart: Mapping[tuple[str, str], Pose] = field(default_factory=dict)
    turned: tuple[tuple[str, str], ...] = ()
    held: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    converged: bool = True
    shape_held: bool = False
    open_directions: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def has_aspect(self) -> bool:
        """Whether the squares were found not to be square."""
        return self.shape is not None and "aspect" in self.shape.names

    def bow_m(self, points_board: FloatArray) -> tuple[float, float] | None:
        """Height of the board's highest over its lowest point, and the largest sigma of a term.

        None where no bow was estimated, or the data leave it open.
        """
        if self.shape is None or self.joint is None or self.shape_held:
            return None
        terms = [row for row, name in enumerate(self.shape.names) if name in BOW_TERMS]
        if not terms:
            return None
        heights = self.shape.displaced(points_board, self.shape_parameters)[:, 2]
        variances = np.diag(self.joint.matrix)[self.joint.shape[terms]]
        return float(np.ptp(heights)), float(np.sqrt(variances.max()))

    def camera_residuals(self, camera: str) -> FloatArray:
        """Residuals (N, 2) of the corners of a camera that were believed."""
        return np.concatenate(
            [part[self.inliers[key]] for key, part in self.residuals_px.items() if key[0] == camera]
        )

    def cameras_of(self, frame: str) -> tuple[str, ...]:
        """Cameras that see the board where the frame has it."""
        return tuple(
            camera
            for camera, views in self.dataset.views.items()
            if frame in views and (camera, frame) not in self.apart
        )

    def rms_px(self, camera: str) -> float:
        """Root mean square error of a camera."""
        return rms_px(self.camera_residuals(camera))

    def cam_from_board(self, camera: str, frame: str) -> Pose:
        """Place of the board in a view."""
        apart = self.apart.get((camera, frame))
        if apart is not None:
            return apart
        return self.cams_from_ref[camera] @ self.ref_from_boards[frame]

"""Reprojection of boards into cameras, and its least-squares adjustment.

One function serves a camera (lens and boards free), a pair (second camera and boards free) and a
board pose (boards free): they differ only in what is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.least_squares import (
    DenseEquations,
    covariance_from_jacobian,
    levenberg_marquardt,
)
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import BoardView
from calichrome.target import Target

__all__ = [
    "Adjustment",
    "Free",
    "PlanarView",
    "Scene",
    "Sightings",
    "adjust",
    "planar_view",
    "residuals_of",
    "rms_px",
    "whitened_residuals",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanarView:
    """Corners of one board in one picture.

    Parameters
    ----------
    points_board : (N, 3) float, metres
    pixels : (N, 2) float, pixels
    whitening : (N, 2, 2) float, 1/pixels, or None
        W with W'W = inverse covariance of a corner; None: all corners are equally sure.
    """

    points_board: FloatArray
    pixels: FloatArray
    whitening: FloatArray | None = None


def planar_view(view: BoardView, target: Target) -> PlanarView:
    """Pair the corners of a view with their places on the board."""
    whitening = None
    if view.cov_px is not None:
        whitening = np.linalg.inv(np.linalg.cholesky(view.cov_px))
    return PlanarView(
        points_board=target.corners_board[view.corner_ids],
        pixels=view.corners_px,
        whitening=whitening,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Corners of many views, one row each: which camera, which board, where.

    Parameters
    ----------
    camera, board : (M,) int
        Positions in the lists of a `Scene`.
    points_board : (M, 3) float, metres
    pixels : (M, 2) float, pixels
    whitening : (M, 2, 2) float, 1/pixels
    """

    camera: IntArray
    board: IntArray
    points_board: FloatArray
    pixels: FloatArray
    whitening: FloatArray

    @classmethod
    def collect(cls, views: Sequence[tuple[int, int, PlanarView]]) -> "Sightings":
        """Stack views given as (camera, board, view)."""
        counts = [len(view.pixels) for _, _, view in views]
        whitening = [
            np.broadcast_to(np.eye(2), (count, 2, 2)) if view.whitening is None else view.whitening
            for count, (_, _, view) in zip(counts, views, strict=True)
        ]
        return cls(
            camera=np.repeat([camera for camera, _, _ in views], counts),
            board=np.repeat([board for _, board, _ in views], counts),
            points_board=np.concatenate([view.points_board for _, _, view in views]),
            pixels=np.concatenate([view.pixels for _, _, view in views]),
            whitening=np.concatenate(whitening),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Lenses, camera poses and board poses: everything that a pixel depends on."""

    lenses: tuple[BrownConrady, ...]
    cams_from_ref: tuple[Pose, ...]
    ref_from_boards: tuple[Pose, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Free:
    """What may move: lens parameters (n_cameras, 9), camera poses (n_cameras,); boards always."""

    lenses: BoolArray
    cameras: BoolArray

    @classmethod
    def only_boards(cls, n_cameras: int) -> "Free":
        """Cameras and lenses are known."""
        return cls(np.zeros((n_cameras, 9), dtype=bool), np.zeros(n_cameras, dtype=bool))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """The adjusted scene.

    Parameters
    ----------
    scene
        At the minimum.
    residuals_px : (M, 2) float, pixels
        Projected minus observed, not whitened.
    jacobian : (2M, P) float
        Of the whitened residuals: free lens parameters, free camera poses, board poses.
    covariance : (P, P) float or None
        Scaled by the residual variance; None where the data leave a direction open.
    variance : float
        Of one whitened residual.
    """

    scene: Scene
    residuals_px: FloatArray
    jacobian: FloatArray
    covariance: FloatArray | None
    variance: float


def rms_px(residuals_px: FloatArray) -> float:
    """Root mean square 2-D distance, as OpenCV reports it."""
    return float(np.sqrt((residuals_px**2).sum(axis=-1).mean()))


def adjust(
    sightings: Sightings, start: Scene, free: Free, *, max_iterations: int = 100
) -> Adjustment:
    """Minimise the whitened reprojection error over what is free.

    Raises
    ------
    ValueError
        If `start` puts a board behind a camera that sees it.
    """

    def linearise(scene: Scene) -> DenseEquations:
        return DenseEquations(*whitened_residuals(sightings, scene, free))

    def move(scene: Scene, step: FloatArray) -> Scene:
        return _moved(scene, free, step)

    result = levenberg_marquardt(start, linearise, move, max_iterations=max_iterations)
    jacobian = result.equations.jacobian
    n_residuals, n_free = jacobian.shape
    variance = 2 * result.cost / max(n_residuals - n_free, 1)
    covariance = covariance_from_jacobian(jacobian) if n_residuals > n_free else None
    return Adjustment(
        scene=result.state,
        residuals_px=residuals_of(sightings, result.state),
        jacobian=jacobian,
        covariance=None if covariance is None else covariance * variance,
        variance=variance,
    )


def residuals_of(sightings: Sightings, scene: Scene) -> FloatArray:
    """Projected minus observed corners, (M, 2), pixels; nan behind a camera."""
    _, _, points_cam = _points(sightings, scene)
    residuals = np.empty_like(sightings.pixels)
    for index, lens in enumerate(scene.lenses):
        rows = sightings.camera == index
        residuals[rows] = lens.project(points_cam[rows]) - sightings.pixels[rows]
    return residuals


def _points(sightings: Sightings, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return board offsets turned into ref, points in ref and points in the camera, (M, 3)."""
    rotation = np.stack([pose.rotation for pose in scene.ref_from_boards])[sightings.board]
    trans_m = np.stack([pose.trans_m for pose in scene.ref_from_boards])[sightings.board]
    turned = np.einsum("nij,nj->ni", rotation, sightings.points_board)
    points_ref = turned + trans_m
    cam_rotation = np.stack([pose.rotation for pose in scene.cams_from_ref])[sightings.camera]
    cam_trans_m = np.stack([pose.trans_m for pose in scene.cams_from_ref])[sightings.camera]
    points_cam = np.einsum("nij,nj->ni", cam_rotation, points_ref) + cam_trans_m
    return turned, points_ref, points_cam


def whitened_residuals(
    sightings: Sightings, scene: Scene, free: Free
) -> tuple[FloatArray, FloatArray]:
    """Return whitened residuals (2M,) and their Jacobian (2M, P) by what is free.

    Columns: free lens parameters camera by camera, then six of each free camera pose, then six of
    each board pose; pose columns are (omega, tau) as `Pose` defines them.
    """
    turned, points_ref, points_cam = _points(sightings, scene)
    n_corners, n_boards = len(sightings.pixels), len(scene.ref_from_boards)
    n_lens, n_cams = int(free.lenses.sum()), int(free.cameras.sum())
    lens_column = np.cumsum(free.lenses.ravel()).reshape(free.lenses.shape) - 1
    cam_column = n_lens + 6 * (np.cumsum(free.cameras) - 1)
    board_column = n_lens + 6 * n_cams

    residuals = np.empty((n_corners, 2))
    jacobian = np.zeros((n_corners, 2, board_column + 6 * n_boards))
    identity = np.broadcast_to(np.eye(3), (n_corners, 3, 3))
    d_ref_d_board = np.concatenate([-cross_matrix(turned), identity], axis=2)
    for index, (lens, cam_from_ref) in enumerate(
        zip(scene.lenses, scene.cams_from_ref, strict=True)
    ):
        rows = np.flatnonzero(sightings.camera == index)
        whitening = sightings.whitening[rows]
        pixels, d_lens, d_points = lens.project_with_jacobians(points_cam[rows])
        residuals[rows] = np.einsum("nij,nj->ni", whitening, pixels - sightings.pixels[rows])
        d_points = whitening @ d_points
        if free.lenses[index].any():
            columns = lens_column[index][free.lenses[index]]
            jacobian[rows[:, None], :, columns] = np.swapaxes(
                whitening @ d_lens[:, :, free.lenses[index]], 1, 2
            )
        if free.cameras[index]:
            turned_cam = points_ref[rows] @ cam_from_ref.rotation.T
            block = np.concatenate([-cross_matrix(turned_cam), identity[rows]], axis=2)
            start = cam_column[index]
            jacobian[rows, :, start : start + 6] = d_points @ block
        d_board = d_points @ cam_from_ref.rotation @ d_ref_d_board[rows]
        columns = board_column + 6 * sightings.board[rows][:, None] + np.arange(6)
        jacobian[rows[:, None], :, columns] = np.swapaxes(d_board, 1, 2)
    return residuals.ravel(), jacobian.reshape(2 * n_corners, -1)


def _moved(scene: Scene, free: Free, step: FloatArray) -> Scene:
    n_lens, n_cams = int(free.lenses.sum()), int(free.cameras.sum())
    parameters = np.stack([lens.parameters for lens in scene.lenses])
    parameters[free.lenses] += step[:n_lens]
    cam_steps = iter(step[n_lens : n_lens + 6 * n_cams].reshape(-1, 6))
    board_steps = step[n_lens + 6 * n_cams :].reshape(-1, 6)
    return Scene(
        tuple(BrownConrady.from_parameters(row) for row in parameters),
        tuple(
            pose.perturbed(next(cam_steps)) if moves else pose
            for pose, moves in zip(scene.cams_from_ref, free.cameras, strict=True)
        ),
        tuple(
            pose.perturbed(board_step)
            for pose, board_step in zip(scene.ref_from_boards, board_steps, strict=True)
        ),
    )

"""Rigs and boards with known truth, and what is seen of them: no pictures are drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import BoardView, Dataset
from calichrome.target import Target
from calichrome.target.board import chessboard

__all__ = [
    "BOARD",
    "SIGMA_PX",
    "SIZE_WH",
    "Recording",
    "Scene",
    "bare_scene",
    "bent",
    "observed",
    "whole_views",
]

SIGMA_PX = 0.2
GROSS_PX = (3.0, 20.0)
SIZE_WH = (1280, 960)
BOARD = chessboard((11, 8), (0.025, 0.025))
"""The rig of the issue: 11x8 inner corners, 250 mm wide, sigma 0.2 px per axis."""

MIN_COSINE = 0.5  # between line of sight and normal: detectors lose a board seen more obliquely


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """The truth: cameras, boards and who sees which.

    Parameters
    ----------
    target
        The board as it is described to a solver: flat.
    corners_board : (n_corners, 3) float, metres
        Where its corners really are.
    size_wh
        Of every picture, pixels.
    lenses, cams_from_ref
        By camera; the first camera is the reference.
    ref_from_boards
        By frame.
    seen
        camera -> frames in which it sees the whole board.
    """

    target: Target
    corners_board: FloatArray
    size_wh: tuple[int, int]
    lenses: Mapping[str, BrownConrady]
    cams_from_ref: Mapping[str, Pose]
    ref_from_boards: Mapping[str, Pose]
    seen: Mapping[str, tuple[str, ...]]

    @property
    def reference(self) -> str:
        """The camera whose frame is `ref`."""
        return next(iter(self.lenses))

    def exact_px(self, camera: str, frame: str) -> FloatArray:
        """Corners without noise, (n_corners, 2)."""
        cam_from_board = self.cams_from_ref[camera] @ self.ref_from_boards[frame]
        return self.lenses[camera].project(cam_from_board.apply(self.corners_board))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One draw of the noise.

    Parameters
    ----------
    dataset
        What a solver gets.
    gross
        (camera, frame) -> which corners are gross errors, (n_corners,).
    """

    dataset: Dataset
    gross: Mapping[tuple[str, str], BoolArray]


def observed(
    scene: Scene, seed: Sequence[int], *, gross_share: float = 0.0, sigma_px: float = SIGMA_PX
) -> Recording:
    """Draw the corners that a detector would see.

    Parameters
    ----------
    seed
        The noise of a seed is the same with gross errors and without.
    gross_share
        Share of corners that lie 3-20 px off in a random direction.

    Notes
    -----
    Corners are rounded to single precision, which is what OpenCV computes with.
    """
    noise, mishap = (np.random.default_rng([*seed, stream]) for stream in (0, 1))
    gross: dict[tuple[str, str], BoolArray] = {}
    views: dict[str, dict[str, BoardView]] = {}
    n_corners = scene.target.n_corners
    for camera, frames in scene.seen.items():
        views[camera] = {}
        for frame in frames:
            corners = scene.exact_px(camera, frame)
            corners = corners + noise.normal(0, sigma_px, corners.shape)
            is_gross = mishap.random(n_corners) < gross_share
            angle = mishap.uniform(0, 2 * np.pi, n_corners)
            length = mishap.uniform(*GROSS_PX, n_corners)
            offset = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            corners = np.where(is_gross[:, None], corners + offset, corners)
            gross[camera, frame] = is_gross
            views[camera][frame] = BoardView(
                corner_ids=np.arange(n_corners),
                corners_px=corners.astype(np.float32).astype(np.float64),
                cov_px=np.tile(np.eye(2) * sigma_px**2, (n_corners, 1, 1)),
            )
    sizes_wh = dict.fromkeys(views, scene.size_wh)
    return Recording(Dataset(sizes_wh=sizes_wh, views=views), gross)


def bent(
    scene: Scene, sagitta_m: float, *, axis_rad: float = 0.0, keeps_lengths: bool = False
) -> Scene:
    """Return the scene with a cylindrical board.

    Parameters
    ----------
    sagitta_m
        Height of the arc over the board's width.
    axis_rad
        Turn of the cylinder's axis; 0 bends along the rows.
    keeps_lengths
        Whether lengths along the surface stay, as in bent paper, or the lengths of its shadow,
        as the models of a bow have it.

    Notes
    -----
    A parabola: a circle of this arc differs by 1e-7 of the board's width. Mean and slope of the
    height are zero, which only moves the board.
    """
    flat = scene.target.corners_board
    middle = flat[:, :2].mean(axis=0)
    across = np.array([np.cos(axis_rad), np.sin(axis_rad)])
    along = (flat[:, :2] - middle) @ across
    half_m = np.ptp(flat[:, 0]) / 2
    curvature = 2 * sagitta_m / half_m**2
    height = curvature / 2 * along**2
    corners = flat.copy()
    corners[:, 2] = height - height.mean()
    if keeps_lengths:
        corners[:, :2] -= (curvature**2 * along**3 / 6)[:, None] * across
    return replace(scene, corners_board=corners)


def bare_scene(
    cams_from_ref: Mapping[str, Pose],
    lenses: Mapping[str, BrownConrady],
    target: Target = BOARD,
    size_wh: tuple[int, int] = SIZE_WH,
) -> Scene:
    """Return cameras without boards."""
    return Scene(
        target=target,
        corners_board=target.corners_board,
        size_wh=size_wh,
        lenses=lenses,
        cams_from_ref=cams_from_ref,
        ref_from_boards={},
        seen={},
    )


def whole_views(
    scene: Scene, ref_from_board: Pose, cameras: Sequence[str]
) -> dict[str, FloatArray] | None:
    """Return the corners in the pictures of `cameras`; None if one does not see them all."""
    pixels = {}
    for camera in cameras:
        cam_from_board = scene.cams_from_ref[camera] @ ref_from_board
        points_cam = cam_from_board.apply(scene.corners_board)
        lens = scene.lenses[camera]
        sight = points_cam.mean(axis=0)
        if cam_from_board.rotation[:, 2] @ sight < MIN_COSINE * np.linalg.norm(sight):
            return None
        at = lens.project(points_cam)
        inside = (at >= 0) & (at <= np.array(scene.size_wh) - 1)
        if not (inside.all() and lens.sees(points_cam).all()):
            return None
        pixels[camera] = at
    return pixels

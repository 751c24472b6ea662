"""Patterns in residuals, poses that repeat, coverage: what no single residual shows."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.pose import Pose

__all__ = [
    "board_share",
    "covered_share",
    "covers",
    "distinct_poses",
    "normals_spread_rad",
    "radial_share",
    "smooth_share",
    "systematic_share",
]

_CELLS = (8, 6)
_RINGS = 12
_LEAST_CORNERS = 8  # in a cell, for its mean to say something


def systematic_share(
    pixels: FloatArray, residuals_px: FloatArray, size_wh: tuple[int, int]
) -> float:
    """Part of the residuals' variance that repeats over the picture, 0..1.

    A lens model that cannot bend as the lens does leaves residuals that point the same way wherever
    views cover the same part of the picture. In a cell of n corners the mean m of independent
    residuals of variance s^2 per axis has E|m|^2 = 2 s^2 / n; what is above that is the pattern's:

        v = sum(n |m|^2 - 2 s^2) / sum(n) / (2 s^2)

    Parameters
    ----------
    pixels, residuals_px : (N, 2) float
        Of the corners of one camera that were believed.
    size_wh
        Pixels.
    """
    place = np.clip((pixels + 0.5) / size_wh * _CELLS, 0, np.subtract(_CELLS, 1e-9)).astype(int)
    cell = place[:, 0] * _CELLS[1] + place[:, 1]
    return _share_of_groups(cell, residuals_px, _LEAST_CORNERS)


def board_share(
    corner_ids: Sequence[IntArray], residuals_px: Sequence[FloatArray], least: int = 3
) -> float:
    """Part of the residuals' variance that belongs to the board, 0..1.

    As `systematic_share`, with the corners of the board as cells.

    Parameters
    ----------
    corner_ids, residuals_px
        (N,) ids and (N, 2) residuals of each view.
    least
        Views of a corner, for their mean to say something.
    """
    return _share_of_groups(
        np.concatenate(list(corner_ids)), np.concatenate(list(residuals_px)), least
    )


def _share_of_groups(group: IntArray, residuals_px: FloatArray, least: int) -> float:
    variance = float((residuals_px**2).mean())
    counts = np.bincount(group)
    good = counts >= least
    if variance == 0 or not good.any():
        return 0.0
    sums = np.stack([np.bincount(group, residuals_px[:, axis]) for axis in (0, 1)])
    above = (sums[:, good] ** 2).sum(axis=0) / counts[good] - 2 * variance
    return float(np.clip(above.sum() / counts[good].sum() / (2 * variance), 0, 1))


def radial_share(pixels: FloatArray, residuals_px: FloatArray, centre: FloatArray) -> float:
    """Part of the residuals' variance that is a function of the distance from the middle, 0..1.

    A lens curve of the wrong family misses in rings, inwards and outwards in turn. The mean m of n
    radial components in a ring has E m^2 = s^2 / n by chance, so with rings of equally many corners

        v = sum(n m^2 - s^2) / sum(n) / (2 s^2)

    of which five times its scatter by chance, sqrt(2 rings) s^2 in the first sum, is taken off.

    Parameters
    ----------
    pixels, residuals_px : (N, 2) float
        Of the corners of one camera that were believed.
    centre : (2,) float, pixels
        Principal point.
    """
    variance = float((residuals_px**2).mean())
    if variance == 0 or len(pixels) < _RINGS * _LEAST_CORNERS:
        return 0.0
    arms = pixels - centre
    distance = np.linalg.norm(arms, axis=1)
    radial = (arms * residuals_px).sum(axis=1) / np.maximum(distance, 1e-9)
    rings = np.array_split(radial[np.argsort(distance)], _RINGS)
    above = sum(len(ring) * float(ring.mean()) ** 2 - variance for ring in rings)
    above -= 5 * np.sqrt(2 * _RINGS) * variance
    return float(np.clip(above / len(radial) / (2 * variance), 0, 1))


def smooth_share(
    corner_ids: Sequence[IntArray], residuals_px: Sequence[FloatArray], n_columns: int
) -> float:
    """Part of the residuals' variance that a corner has in common with its right neighbour, 0..1.

    Noise differs from corner to corner, what a model misses hardly does. With neighbours r and s:

        v = sum(r . s) / sum((|r|^2 + |s|^2) / 2)

    Parameters
    ----------
    corner_ids, residuals_px
        (N,) row-major ids and (N, 2) residuals of each view.
    n_columns
        Of the board's corners.
    """
    common, total = 0.0, 0.0
    for ids, residuals in zip(corner_ids, residuals_px, strict=True):
        follows, here, there = np.intersect1d(ids + 1, ids, return_indices=True)
        same_row = follows % n_columns != 0
        left, right = residuals[here[same_row]], residuals[there[same_row]]
        common += float((left * right).sum())
        total += float((left**2 + right**2).sum()) / 2
    return float(np.clip(common / total, 0, 1)) if total > 0 else 0.0


def covered_share(pixels: FloatArray, size_wh: tuple[int, int]) -> float:
    """Area of the convex hull of all corners over that of the picture."""
    try:
        hull = ConvexHull(pixels)
    except (QhullError, ValueError):  # all on one line, or too few
        return 0.0
    return float(hull.volume) / (size_wh[0] * size_wh[1])


def covers(pixels: FloatArray, point: FloatArray) -> bool:
    """Whether a point lies inside the convex hull of the corners."""
    try:
        return bool(Delaunay(pixels).find_simplex(point) >= 0)
    except (QhullError, ValueError):
        return False


def distinct_poses(
    cams_from_board: Sequence[Pose], *, angle_rad: float, distance_share: float
) -> int:
    """Count poses of which no two are nearer than both limits.

    Parameters
    ----------
    cams_from_board
        Of one camera's views.
    angle_rad
        Between rotations.
    distance_share
        Between positions, over the distance from the camera.
    """
    chosen: list[Pose] = []
    for pose in cams_from_board:
        reach = distance_share * float(np.linalg.norm(pose.trans_m))
        if not any(
            _angle(pose, other) < angle_rad and np.linalg.norm(pose.trans_m - other.trans_m) < reach
            for other in chosen
        ):
            chosen.append(pose)
    return len(chosen)


def normals_spread_rad(cams_from_board: Sequence[Pose]) -> float:
    """Largest angle between a board's normal and the mean of all."""
    normals = np.stack([pose.rotation[:, 2] for pose in cams_from_board])
    mean = normals.mean(axis=0)
    cosines = normals @ mean / max(float(np.linalg.norm(mean)), 1e-9)
    return float(np.arccos(np.clip(cosines.min(), -1, 1)))


def _angle(a: Pose, b: Pose) -> float:
    return float(np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1) / 2, -1, 1)))

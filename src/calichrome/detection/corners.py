"""Inner corners of a whole chessboard: found by OpenCV, refined to sub-pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, UInt8Array

__all__ = ["corner_spacing", "find_corner_grid", "refine_corners", "seen_corner_counts"]

_SEARCH_PIXELS = 2_000_000
"""Boards are searched at most at this size; a board of 9x6 then still has squares of 30 px when
it fills an eighth of the picture. Refinement always uses all pixels."""

_WINDOW = 0.18
"""Half-width of the refinement window in corner spacings. A window of half-width w px is clear of
a disc of diameter ratio r while w <= (0.5 - 0.354 r) s - (1 + sigma_psf) px [1]_: 0.18 is clear
of discs of 0.7 for squares of 30 px and of 0.6 for 20 px. A larger window gains little on clean
corners (0.033 px RMS at 0.18, 0.026 at 0.25, on rendered boards) and loses on printed marks.

.. [1] A disc of radius r s/2 in the centre of a square whose side is s comes as close as
   0.5 s - r s / (2 sqrt 2) to its corner along both axes; 1/(2 sqrt 2) = 0.354.
"""


_REACH = 0.3
"""The same for catching corners: the classic detector is off by over 2 px on small tilted squares
(it grows and shrinks them), where `_WINDOW` misses some (of 72 corners of 15 px three stayed 2 px
off, now none; rendered boards). What a disc does to so wide a window the second pass undoes."""


def find_corner_grid(grey: UInt8Array, corners_xy: tuple[int, int]) -> FloatArray | None:
    """Find all inner corners of a board, to about a pixel.

    Parameters
    ----------
    grey : (H, W) uint8
    corners_xy
        Inner corners along the two sides of the board.

    Returns
    -------
    (ny, nx, 2) float, pixels, or None
        In any of the orders that the grid's symmetry allows.

    References
    ----------
    .. [1] V. Vezhnevets, "OpenCV Calibration Object Detection" (classic: adaptive threshold,
       contours of black squares), 2005.
    .. [2] A. Duda, U. Frese, "Accurate Detection and Localization of Checkerboard Corners for
       Calibration", BMVC 2018 (SB, the second try).
    """
    height, width = grey.shape
    scale = min(1.0, (_SEARCH_PIXELS / (height * width)) ** 0.5)
    small = grey
    if scale < 1:
        size_wh = round(width * scale), round(height * scale)
        small = cv2.resize(grey, size_wh, interpolation=cv2.INTER_AREA)
    found, corners = cv2.findChessboardCorners(small, corners_xy)
    if not found:
        found, corners = cv2.findChessboardCornersSB(small, corners_xy)
    if not found:
        return None
    grid = corners.reshape(corners_xy[1], corners_xy[0], 2).astype(np.float64)
    stretch = np.array([width / small.shape[1], height / small.shape[0]])
    return np.asarray((grid + 0.5) * stretch - 0.5)


def corner_spacing(grid: FloatArray) -> FloatArray:
    """Return for each corner the distance to its nearest neighbour in the grid, (ny, nx), px."""
    spacing = np.full(grid.shape[:2], np.inf)
    along_x = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    along_y = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    for part, distance in (
        (spacing[:, :-1], along_x),
        (spacing[:, 1:], along_x),
        (spacing[:-1], along_y),
        (spacing[1:], along_y),
    ):
        np.minimum(part, distance, out=part)
    return spacing


def refine_corners(grey: NDArray[np.float32], grid: FloatArray) -> FloatArray:
    """Refine corners by gradient orthogonality in a window that follows the local square size.

    A wide window catches corners that were found badly, a narrow one measures them. A corner that
    leaves its window was drawn to something else and keeps its position.

    References
    ----------
    .. [1] W. Foerstner, E. Guelch, "A Fast Operator for Detection and Precise Location of Distinct
       Points, Corners and Centres of Circular Features", ISPRS, 1987 (as in cv2.cornerSubPix).
    """
    for share in (_REACH, _WINDOW):
        grid = _moved_to_saddles(grey, grid, np.maximum(2, np.rint(share * corner_spacing(grid))))
    return grid


def _moved_to_saddles(
    grey: NDArray[np.float32], grid: FloatArray, half_widths: FloatArray
) -> FloatArray:
    refined = grid.copy()
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    for half_width in np.unique(half_widths):
        chosen = half_widths == half_width
        points = np.ascontiguousarray(grid[chosen].reshape(-1, 1, 2), dtype=np.float32)
        window = (int(half_width), int(half_width))
        moved = cv2.cornerSubPix(grey, points, window, (-1, -1), criteria).reshape(-1, 2)
        stays = np.abs(moved - grid[chosen]).max(axis=1) > half_width
        refined[chosen] = np.where(stays[:, None], grid[chosen], moved)
    return refined


def seen_corner_counts(grey: UInt8Array) -> tuple[int, int] | None:
    """Return the inner corner counts (long side first) of the largest board in sight, if any."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    if not found or meta is None:
        return None
    return max(meta.shape), min(meta.shape)

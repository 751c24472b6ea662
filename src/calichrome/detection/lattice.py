"""Which corner of the board is which: orientation from the colours of the squares."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import homographies_of_cells
from calichrome.target import Target

__all__ = ["OrientedGrid", "goes_on", "is_regular", "no_order_fits", "orient_grid"]

_MIN_CONTRAST = 5.0  # of 255 levels: below, "black" and "white" squares are noise

_ALTERNATING = 0.9
"""Share of neighbouring squares that must differ as on a chessboard; the rest may be hidden."""

_UNEVEN = 0.3
"""Spread of grey within a square over the step to its neighbour, at most: 0.01 to 0.05 on the real
and rendered boards of the tests, above 0.6 (once 0.2) where every other corner of a board was taken
for another board, whose "squares" then hold pieces of several."""

_BEND = 0.35
"""Second difference of neighbouring corners over their spacing, at most. A 9x6 board tilted by 60
degrees and as near as it is wide reaches 0.27, by 45 degrees 0.21; a grid that skips or shears by
one corner reaches 1."""

_GOES_ON = 0.5
"""Contrast beyond the last squares over that within the board: 1 where the board goes on, 0 on a
plain margin. Clutter may do it for one column of corners, hardly for half of them."""


@dataclass(frozen=True, slots=True)
class OrientedGrid:
    """Corners in the order of the target, (ny, nx, 2), and whether half a turn also fits."""

    corners_px: FloatArray
    half_turn_ambiguous: bool


def orient_grid(grid: FloatArray, grey: NDArray[np.float32], target: Target) -> OrientedGrid | str:
    """Order a grid of corners as the target numbers them.

    Only orders that keep the handedness are considered: a camera sees the printed side, so x to y
    turns the same way on the board and in the picture.

    Returns
    -------
    OrientedGrid or str
        The sentence says why no order fits.
    """
    nx, ny = target.corners_xy
    right_handed = grid if _is_right_handed(grid) else grid[:, ::-1]
    turns = [np.rot90(right_handed, quarter) for quarter in range(4)]
    fitting = [turn for turn in turns if turn.shape[:2] == (ny, nx)]
    signs = [_first_square_sign(_square_samples(turn, grey)) for turn in fitting]
    if 0 in signs:
        return f"what looks like {nx}x{ny} corners does not alternate between black and white"
    wanted = -1 if target.top_left == "black" else 1
    matching = [turn for turn, sign in zip(fitting, signs, strict=True) if sign == wanted]
    if not matching:
        return no_order_fits(target)
    # Of equal orders take the one that stands most upright: it reads like the printed sheet.
    upright = max(matching, key=lambda turn: float((turn[0, -1] - turn[0, 0])[0]))
    return OrientedGrid(np.ascontiguousarray(upright), half_turn_ambiguous=len(matching) > 1)


def no_order_fits(target: Target) -> str:
    """Say what is wrong where the corners are all there and the colours of the squares are not."""
    nx, ny = target.corners_xy
    seen = "white" if target.top_left == "black" else "black"
    if nx % 2 == 1 and nx != ny:
        return (
            f"square [0,0] is {seen} in every order of {nx}x{ny} corners: if the board is right, "
            f"the target is {ny}x{nx} (its mirror image) or the picture is mirrored"
        )
    return (
        f"the corner squares are {seen}, the target has them {target.top_left}; use a target.json "
        f'with "top_left_square": "{seen}"'
    )


def is_regular(grid: FloatArray) -> bool:
    """Tell whether neighbouring corners are about evenly spaced on about straight lines."""
    for along in (grid, np.swapaxes(grid, 0, 1)):
        bend = np.linalg.norm(along[:-2] - 2 * along[1:-1] + along[2:], axis=-1)
        span = np.linalg.norm(along[2:] - along[:-2], axis=-1) / 2
        if (bend > _BEND * span).any():
            return False
    return True


def goes_on(grid: FloatArray, grey: NDArray[np.float32]) -> bool:
    """Tell whether the chessboard continues beyond the outermost corners that were found.

    A detector that looks for too few corners may find a part of a larger board, each time another.
    One step outside the grid the true board ends: its last squares meet the white margin. If it
    goes on, four squares meet there as everywhere, and the contrast across the last squares comes
    back with the opposite sign one square further out.

    Parameters
    ----------
    grid : (ny, nx, 2) float, pixels
    grey : (H, W) float32
    """
    return any(_continues_upwards(np.rot90(grid, quarter), grey) for quarter in range(4))


def _continues_upwards(grid: FloatArray, grey: NDArray[np.float32]) -> bool:
    cells = homographies_of_cells(grid)[0]  # the uppermost row; y grows into the board
    # left and right of each column of corners: in the first row of squares between corners, in the
    # last row of the board (-1 to 0), and where a further row would be
    x, y = np.array([[-0.3, 0.3] * 3, [0.3, 0.3, -0.7, -0.7, -1.3, -1.3]])
    points = np.stack([x, y, np.ones(6)], axis=1)
    mapped = np.einsum("cij,nj->cni", cells[1:], points)
    pixels = np.rint(mapped[..., :2] / mapped[..., 2:])
    inside = ((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1)).all(axis=(1, 2))
    if inside.sum() < 2:
        return False
    column, row = np.moveaxis(pixels[inside].astype(int), -1, 0)
    levels = grey[row, column]
    within, last, beyond = (levels[:, at] - levels[:, at + 1] for at in (0, 2, 4))
    scale = np.where(np.abs(within) < _MIN_CONTRAST, np.inf, within)
    alternates = (last / scale < -_GOES_ON) & (beyond / scale > _GOES_ON)
    return bool(alternates.mean() > _GOES_ON)


def _is_right_handed(grid: FloatArray) -> bool:
    along_x = grid[:, -1] - grid[:, 0]
    along_y = grid[-1] - grid[0]
    x, y = along_x.mean(axis=0), along_y.mean(axis=0)
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def _square_samples(grid: FloatArray, grey: NDArray[np.float32]) -> FloatArray:
    """Return the grey of the squares between corners at four places each, (ny - 1, nx - 1, 4).

    Sampled at 0.3 of a square from the centre along the diagonals: outside any disc, inside any
    square.
    """
    offsets = 0.5 + 0.3 * np.array([[-1.0, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]])
    offsets[:, 2] = 1
    mapped = np.einsum("yxij,nj->yxni", homographies_of_cells(grid), offsets)
    x, y = np.moveaxis(np.rint(mapped[..., :2] / mapped[..., 2:]).astype(int), -1, 0)
    x, y = np.clip(x, 0, grey.shape[1] - 1), np.clip(y, 0, grey.shape[0] - 1)
    return np.asarray(grey[y, x], dtype=np.float64)


def _first_square_sign(samples: FloatArray) -> int:
    """Return 1 if squares like [1, 1] (so like [0, 0]) are white, -1 if black, 0 if neither.

    Neighbours are compared, not levels, so light may change over the board.
    """
    levels = np.median(samples, axis=-1)
    iy, ix = np.indices(levels.shape)
    signed = np.where((ix + iy) % 2 == 0, 1.0, -1.0)
    steps = [
        ((levels[:, :-1] - levels[:, 1:]) * signed[:, :-1]).ravel(),
        ((levels[:-1] - levels[1:]) * signed[:-1]).ravel(),
    ]
    differences = np.concatenate(steps)
    if np.median(np.ptp(samples, axis=-1)) > _UNEVEN * np.median(np.abs(differences)):
        return 0
    for sign in (1, -1):
        if (sign * differences > _MIN_CONTRAST).mean() >= _ALTERNATING:
            return sign
    return 0

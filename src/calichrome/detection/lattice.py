"""Which corner of the board is which: orientation from the colours of the squares."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import homographies_of_cells
from calichrome.target import Target

__all__ = ["OrientedGrid", "orient_grid"]

_MIN_CONTRAST = 5.0  # of 255 levels: below, "black" and "white" squares are noise


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
    contrasts = [_contrast_of_first_square(turn, grey) for turn in fitting]
    if max(map(abs, contrasts)) < _MIN_CONTRAST:
        return "the squares show no contrast between black and white"
    wanted = -1 if target.top_left == "black" else 1
    matching = [
        turn for turn, contrast in zip(fitting, contrasts, strict=True) if contrast * wanted > 0
    ]
    if not matching:
        return (
            f"square [0,0] is {'white' if wanted < 0 else 'black'} in every order of {nx}x{ny} "
            f"corners; if the board is right, it is {ny}x{nx} (its mirror image), and the picture "
            f"may not be mirrored"
        )
    # Of equal orders take the one that stands most upright: it reads like the printed sheet.
    upright = max(matching, key=lambda turn: float((turn[0, -1] - turn[0, 0])[0]))
    return OrientedGrid(np.ascontiguousarray(upright), half_turn_ambiguous=len(matching) > 1)


def _is_right_handed(grid: FloatArray) -> bool:
    along_x = grid[:, -1] - grid[:, 0]
    along_y = grid[-1] - grid[0]
    x, y = along_x.mean(axis=0), along_y.mean(axis=0)
    return bool(x[0] * y[1] - x[1] * y[0] > 0)


def _contrast_of_first_square(grid: FloatArray, grey: NDArray[np.float32]) -> float:
    """Mean grey of the squares coloured like [1, 1] (so like [0, 0]) minus that of the others.

    Sampled at 0.3 of a square from the centre along the diagonals: outside any disc, inside any
    square.
    """
    offsets = 0.5 + 0.3 * np.array([[-1.0, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]])
    offsets[:, 2] = 1
    mapped = np.einsum("yxij,nj->yxni", homographies_of_cells(grid), offsets)
    x, y = np.moveaxis(np.rint(mapped[..., :2] / mapped[..., 2:]).astype(int), -1, 0)
    x, y = np.clip(x, 0, grey.shape[1] - 1), np.clip(y, 0, grey.shape[0] - 1)
    levels = np.median(grey[y, x], axis=-1)
    iy, ix = np.indices(levels.shape)
    even = (ix + iy) % 2 == 0
    return float(np.median(levels[even]) - np.median(levels[~even]))

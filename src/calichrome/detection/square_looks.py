"""What the squares of a lattice look like, in units of the light that falls on them.

The middle of each square is compared with the white and the black squares around it: 0 is the
local black, 1 the local white. Lamps, vignetting, exposure and white balance cancel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pixels import NEARLY_FULL, linear_light, masked_median, nearest_pixels
from calichrome.imaging import Image

__all__ = [
    "MOST_OFF_BLACK",
    "MOST_OFF_WHITE",
    "MOST_UNEVEN",
    "CornerLattice",
    "LatticeToPixels",
    "SquareLooks",
    "look_at_squares",
]

LatticeToPixels = Callable[[FloatArray], FloatArray]
"""Lattice coordinates (..., 2) to pixels (..., 2); good to one square beyond the corners."""

_MIDDLE_OF_DISC = 0.65  # of its radius: leaves a third of it to blur and to errors of the map
_RINGS = ((0.0, 1), (0.5, 6), (1.0, 12))  # share of that radius, number of samples

_CORNER_OFFSETS = ((0.40, 0.40), (0.40, 0.30), (0.30, 0.40))
"""Where the ground around the disc is sampled, squares from the centre: 0.5 or more away from it,
where discs of up to 0.9 of a square do not reach, and a tenth of a square beside the edges."""

_REACH = 0.8
"""Squares over which the levels of white and black are averaged (sigma): the square itself counts
1, its neighbours 0.46 and the next 0.04 to 0.21 each, so it follows gradients and shadows."""

MOST_UNEVEN = 0.2
"""Spread of the ground around a disc, of the step from black to white, above which something lies
on it. A choice by
reasoning, not set on data: noise of 5 of 255 levels is 0.03 of a step of 170, an edge across the
ground up to one half."""

MOST_OFF_BLACK, MOST_OFF_WHITE = 0.12, 0.35
"""Distance of a ground from the level of others nearby, of the same step. A choice by
reasoning, not set on data: skin reflects about a third of the light; shadows and gradients change
white within two squares by more than they change black."""

_FEWEST_SAMPLES = 3  # of the ground: a square cut by the border of the picture shows fewer of them


class CornerLattice(Protocol):
    """Corners of one board; the turn from +i to +j is the turn from the picture's x to its y."""

    @property
    def indices(self) -> IntArray:
        """(i, j) of every corner, (N, 2), from (0, 0)."""

    @property
    def black_parity(self) -> int:
        """The square between (i, j) and (i + 1, j + 1) is black where (i + j) % 2 is this."""


@dataclass(frozen=True, slots=True, eq=False)
class SquareLooks:
    """The middles of the squares that can be judged.

    Parameters
    ----------
    cells : (S, 2) int
        Square [i, j] lies between the lattice's corners (i, j) and (i + 1, j + 1).
    black : (S,) bool
        By the parity of the lattice.
    n_corners : (S,) int
        How many of its four corners the lattice holds.
    levels : (S, C) float
        0 is the local black and 1 the local white; C = 3, or 1 of a grey picture.
    variance : (S, C) float
        Of `levels`, from the scatter of the pixels.
    clipped : (S, C) bool
        At full scale: the true level is at least `levels`.
    white_clipped : (C,) bool
        White is at full scale in this channel, so that 1 is less than white.
    """

    cells: IntArray
    black: BoolArray
    n_corners: IntArray
    levels: FloatArray
    variance: FloatArray
    clipped: BoolArray
    white_clipped: BoolArray

    def __len__(self) -> int:
        return len(self.cells)


def look_at_squares(
    image: Image, lattice: CornerLattice, to_pixels: LatticeToPixels, disc_radius: float
) -> SquareLooks | None:
    """Look at the middle of every square that touches a corner of the lattice.

    Parameters
    ----------
    disc_radius
        Radius of the smallest disc, squares.

    Returns
    -------
    SquareLooks or None
        Squares outside the picture, or with something other than evenly lit black or white around
        their middle, are absent. None if no white or no black square is left.
    """
    cells, n_corners = _cells_of(lattice.indices)
    black = cells.sum(axis=1) % 2 == lattice.black_parity
    middle = _sample(image, to_pixels, cells, _MIDDLE_OF_DISC * disc_radius * _rings())
    ground = _sample(image, to_pixels, cells, _ground_points())
    seen = (middle.n_inside == len(_rings())) & (ground.n_inside >= _FEWEST_SAMPLES)
    if not (seen & black).any() or not (seen & ~black).any():
        return None

    # Two rounds: what lies on a square shows only against the level of the others.
    usable = seen & (n_corners >= 3)
    usable = usable if (usable & black).any() and (usable & ~black).any() else seen
    for _ in range(2):
        usable = seen & _is_bare(cells, black, ground, usable)
        if not (usable & black).any() or not (usable & ~black).any():
            return None
    white = _local_level(cells, ground.median, usable & ~black)
    dark = _local_level(cells, ground.median, usable & black)
    safe_step = np.maximum((white - dark).mean(axis=1), 1e-9)
    per_channel = np.maximum(white - dark, 0.05 * safe_step[:, None])
    levels = (middle.median - dark) / per_channel
    spread = middle.spread / per_channel
    n_white_clipped = (ground.clipped & (usable & ~black)[:, None]).sum(axis=0)
    return SquareLooks(
        cells=cells[usable],
        black=black[usable],
        n_corners=n_corners[usable],
        levels=levels[usable],
        variance=(spread**2 / _INDEPENDENT)[usable],
        clipped=middle.clipped[usable],
        white_clipped=n_white_clipped > 0.1 * (usable & ~black).sum(),
    )


_INDEPENDENT = 4.0
"""Samples of a middle that count as independent, of 19: demosaicing, JPEG and nearest pixels tie
neighbours together. What varies within a disc is doubtful, so few is the safe side."""


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Per square: number of samples in the picture, their median, robust spread, clipping."""

    n_inside: IntArray
    median: FloatArray
    spread: FloatArray
    clipped: BoolArray


def _is_bare(cells: IntArray, black: BoolArray, ground: "_Samples", usable: BoolArray) -> BoolArray:
    """Whether the ground of squares is even, and as black or white as others nearby, (S,)."""
    brightness = ground.median.mean(axis=1, keepdims=True)
    white, dark = (
        _local_level(cells, brightness, usable & (black == kind), of_others=True)[:, 0]
        for kind in (False, True)
    )
    step = white - dark
    lit = step > 0
    share = (brightness[:, 0] - dark) / np.where(lit, step, 1.0)
    proper = np.where(black, np.abs(share) <= MOST_OFF_BLACK, np.abs(share - 1) <= MOST_OFF_WHITE)
    uneven = ground.spread.mean(axis=1) > MOST_UNEVEN * step
    return np.asarray(lit & proper & ~uneven)


def _cells_of(indices: IntArray) -> tuple[IntArray, IntArray]:
    """Return the squares that touch the corners, (S, 2), and how many of their corners are there.

    Square (a, b) has the corners (a, b) to (a + 1, b + 1).
    """
    around = np.array([[0, 0], [-1, 0], [0, -1], [-1, -1]])
    touched = (indices[:, None, :] + around).reshape(-1, 2)
    cells, counts = np.unique(touched, axis=0, return_counts=True)
    return cells, counts


def _rings() -> FloatArray:
    angles = [np.arange(count) * (2 * np.pi / count) for _, count in _RINGS]
    radii = np.repeat([radius for radius, _ in _RINGS], [count for _, count in _RINGS])
    angle = np.concatenate(angles)
    return np.asarray(radii[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _ground_points() -> FloatArray:
    signs = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
    return np.asarray(signs[:, None, :] * np.array(_CORNER_OFFSETS)).reshape(-1, 2)


def _sample(
    image: Image, to_pixels: LatticeToPixels, cells: IntArray, offsets: FloatArray
) -> _Samples:
    points = cells[:, None, :] + 0.5 + offsets
    column, row, inside = nearest_pixels(to_pixels(points), image.size_wh)
    numbers = image.pixels[row, column]
    if numbers.ndim == 2:
        numbers = numbers[..., None]
    light = np.where(inside[..., None], linear_light(image, numbers), np.inf)
    full = (numbers >= NEARLY_FULL * image.full_scale) & inside[..., None]
    n_inside = inside.sum(axis=1)
    median = masked_median(light, n_inside)
    away = np.abs(light - np.where(np.isfinite(median), median, 0.0)[:, None])
    return _Samples(
        n_inside=n_inside,
        median=median,
        spread=1.4826 * masked_median(away, n_inside),  # MAD of a normal distribution
        clipped=full.sum(axis=1) * 2 > n_inside[:, None],
    )


def _local_level(
    cells: IntArray, levels: FloatArray, usable: BoolArray, *, of_others: bool = False
) -> FloatArray:
    """Average the levels of usable squares near each square, (S, C).

    `of_others` leaves out the square itself, unless it is the only one.
    """
    offset = cells[:, None, :] - cells[usable][None]
    squared = (offset**2).sum(axis=2).astype(np.float64)
    if of_others and squared.shape[1] > 1:
        squared[squared == 0] = np.inf
    # Relative to the nearest one, so that a square far from all others gets that one's level.
    squared = squared - squared.min(axis=1, keepdims=True)
    weight = np.exp(-squared / (2 * _REACH**2))
    return np.asarray(weight @ levels[usable] / weight.sum(axis=1, keepdims=True))

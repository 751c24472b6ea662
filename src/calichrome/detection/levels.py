"""One linear channel to measure corners in: the mix in which black and white differ most.

White noise alike in all channels makes weights proportional to the contrast the best mix (matched
filter): under a blue lamp that is mostly blue, and a channel in which white clips is left out.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import EdgeBend
from calichrome.detection.pixels import NEARLY_FULL, linear_light, nearest_pixels
from calichrome.imaging import Image

__all__ = ["Levels", "best_mix", "readings_of"]

Levels = Callable[[IntArray, IntArray], FloatArray]
"""Columns and rows (P,) to levels, 0..1 of full scale."""


_OFF_CORNER = 0.2  # squares along both edges: inside the square, clear of discs of up to 0.7
_MAX_CLIPPED = 0.05  # share of white samples at full scale above which a channel is left out


def best_mix(image: Image, corners_px: FloatArray, edges: EdgeBend, white: BoolArray) -> FloatArray:
    """Return weights (3,) of the channels, summing to 1.

    Parameters
    ----------
    corners_px : (N, 2) float
    edges
        At the corners.
    white : (N,) bool
        Whether the square towards +i, +j is white.
    """
    diagonals = (edges.along_i + edges.along_j, edges.along_i - edges.along_j)
    places = np.stack(
        [corners_px + _OFF_CORNER * sign * step for step in diagonals for sign in (1, -1)]
    )
    column, row, inside = nearest_pixels(places, image.size_wh)
    numbers = image.pixels[row, column]
    light = linear_light(image, numbers)
    is_white = np.stack([white, white, ~white, ~white])
    bright, dark = light[is_white & inside], light[~is_white & inside]
    if not len(bright) or not len(dark):
        return np.full(3, 1 / 3)
    clipped = (numbers[is_white & inside] >= NEARLY_FULL * image.full_scale).mean(axis=0)
    contrast = np.median(bright, axis=0) - np.median(dark, axis=0)
    weights = np.where(clipped <= _MAX_CLIPPED, np.maximum(contrast, 0), 0)
    if weights.sum() <= 0:  # clipped everywhere: the least of all evils
        weights = (clipped == clipped.min()).astype(np.float64)
    return np.asarray(weights / weights.sum())


def readings_of(image: Image, mix: FloatArray) -> tuple[Levels, ...]:
    """Return what the levels of a picture may be, in a mix of its channels: as declared, as stored.

    Few files say how they were encoded, and machine-vision cameras store light as it comes.
    """
    declared = _levels_of(image, mix)
    if image.encoding == "linear":
        return (declared,)
    return declared, _levels_of(replace(image, encoding="linear"), mix)


def _levels_of(image: Image, mix: FloatArray) -> Levels:
    def levels(column: IntArray, row: IntArray) -> FloatArray:
        light = linear_light(image, image.pixels[row, column])
        return light @ mix if image.is_colour else light

    return levels

"""Linear light at scattered points of a picture: only the pixels asked for are looked up."""

from functools import cache

import numpy as np

from calichrome.colorimetry.encoding import EncodingName, linearise
from calichrome.core.arrays import BoolArray, FloatArray, IntArray, frozen
from calichrome.imaging import Image, Pixels

__all__ = ["NEARLY_FULL", "linear_light", "masked_median", "nearest_pixels"]

NEARLY_FULL = 0.995
"""Share of full scale from which a pixel counts as clipped, as `Image.is_clipped`."""


def nearest_pixels(
    points_px: FloatArray, size_wh: tuple[int, int]
) -> tuple[IntArray, IntArray, BoolArray]:
    """Return column, row and whether they lie in the picture, for points (..., 2) in pixels.

    Columns and rows of points outside are moved inside.
    """
    # Points that a map sends to infinity are outside like all others.
    rounded = np.rint(np.nan_to_num(points_px, nan=-1.0, posinf=-1.0, neginf=-1.0))
    last = np.array(size_wh) - 1
    inside = ((rounded >= 0) & (rounded <= last)).all(axis=-1)
    pixels = np.clip(rounded, 0, last).astype(np.int64)
    return pixels[..., 0], pixels[..., 1], np.asarray(inside)


def linear_light(image: Image, numbers: Pixels) -> FloatArray:
    """Return linear light, 0..1 of full scale, of pixel numbers (...) taken from `image`."""
    if numbers.dtype == np.float32:
        return linearise(numbers.astype(np.float64), image.encoding)
    largest = int(image.full_scale)
    table = _linear_table(image.encoding, largest)
    return np.asarray(table[np.minimum(numbers, largest)])


@cache
def _linear_table(encoding: EncodingName, largest: int) -> FloatArray:
    return frozen(linearise(np.arange(largest + 1) / largest, encoding))


def masked_median(values: FloatArray, counts: IntArray) -> FloatArray:
    """Median along axis 1 of the finite values, of which there are `counts`; inf if none."""
    ordered = np.sort(values, axis=1)
    rows = np.arange(len(values))
    low, high = np.maximum(counts - 1, 0) // 2, np.minimum(counts // 2, values.shape[1] - 1)
    return np.asarray((ordered[rows, low] + ordered[rows, high]) / 2)

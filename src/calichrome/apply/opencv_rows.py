"""Rows of frames corrected by OpenCV and numpy: what runs where there is no C extension."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.apply.correction import Colour, Correction
from calichrome.colorimetry.encoding import encode, linearise
from calichrome.core.arrays import FloatArray
from calichrome.imaging import Pixels

__all__ = ["OpenCVRows"]

_BAND = 64  # rows done at a time: numpy's temporaries of a whole frame would take gigabytes


class OpenCVRows:
    """A correction for OpenCV and numpy; see `Correction`.

    Frames are resampled as float32, so that rounding comes last, and the model is evaluated in
    double precision.
    """

    def __init__(self, correction: Correction) -> None:
        self._correction = correction
        self._map = None if correction.map is None else correction.map.field()
        gain = None if correction.colour is None else correction.colour.gain
        self._gain = None if gain is None else gain.field()

    def run(self, frame: Pixels, out: Pixels, first: int, last: int) -> None:
        """Write rows `first` to `last` - 1 of the output."""
        for start in range(first, last, _BAND):
            rows = slice(start, min(start + _BAND, last))
            _store(self._values(self._resampled(frame, rows), rows), out[rows])

    def _resampled(self, frame: Pixels, rows: slice) -> NDArray[np.float32]:
        if self._map is None:
            return frame[rows].astype(np.float32)
        places = self._map[rows]
        y = places[..., 1]
        low, high = (int(np.clip(edge, 0, len(frame) - 1)) for edge in (y.min() - 1, y.max() + 2))
        needed = frame[low : high + 1].astype(np.float32)
        shifted = places - np.array([0, low], dtype=np.float32)
        return np.asarray(
            cv2.remap(needed, shifted, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        )

    def _values(self, stored: NDArray[np.float32], rows: slice) -> FloatArray:
        correction, colour = self._correction, self._correction.colour
        if colour is None:
            return stored.astype(np.float64) * correction.out_scale
        if correction.frames.order == "bgr":
            stored = stored[..., ::-1]
        values = stored.astype(np.float64) / correction.frames.top
        linear = _linear(colour, values, is_float=correction.frames.dtype == "float32")
        if self._gain is not None:
            linear = linear * self._gain[rows]
        values = colour.apply(linear)
        if colour.clips:
            values = np.clip(values, 0, 1)
        if colour.is_encoded:
            values = encode(values, "srgb")
        if correction.frames.order == "bgr":
            values = values[..., ::-1]
        return values * correction.out_scale


def _linear(colour: Colour, values: FloatArray, *, is_float: bool) -> FloatArray:
    """Remove the encoding; beyond full scale is light only in linear floats."""
    if colour.curve == "linear" and is_float:
        return values
    return linearise(np.clip(values, 0, 1), colour.curve)


def _store(values: FloatArray, out: Pixels) -> None:
    if out.dtype != np.float32:
        values = np.clip(np.rint(values), 0, np.iinfo(out.dtype).max)
    out[...] = values

"""A picture that knows what its numbers mean."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.colorimetry.encoding import EncodingName, encode, linearise
from calichrome.core.arrays import FloatArray

__all__ = ["Image", "Pixels"]

Pixels = NDArray[Any]
"""uint8, uint16 or float32; the type of an array cannot say "one of these" usefully."""

_NEARLY_FULL = 0.995  # of full scale: 254 of 255, where 8-bit files begin to clip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Image:
    """Pixels with their encoding and depth.

    Parameters
    ----------
    pixels : (H, W, 3) RGB or (H, W) grey; uint8, uint16 or float32
    encoding
        How light became numbers.
    bits
        Significant bits of integer pixels; full scale is 2^bits - 1. Float pixels: 1.0.
    sha256
        Sum of the file's bytes, "" if it did not come from a file.
    exposure
        What EXIF says of exposure, gain and white balance; empty without EXIF.
    rotation_tag
        EXIF's orientation, 1 = as stored; never applied to the pixels.
    """

    pixels: Pixels
    encoding: EncodingName
    bits: int
    sha256: str = ""
    exposure: Mapping[str, float] = field(default_factory=dict)
    rotation_tag: int = 1

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def is_colour(self) -> bool:
        """Whether there are three channels."""
        return self.pixels.ndim == 3

    @property
    def full_scale(self) -> float:
        """The largest value a pixel can hold."""
        return 1.0 if self.pixels.dtype == np.float32 else float(2**self.bits - 1)

    def linear(self, window: tuple[slice, slice] | None = None) -> FloatArray:
        """Linear light 0..1 of full scale, shape (h, w, 3), of a window or of everything."""
        pixels = self.pixels if window is None else self.pixels[window]
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, axis=2)
        if pixels.dtype == np.float32:
            return linearise(pixels.astype(np.float64), self.encoding)
        table = linearise(np.arange(int(self.full_scale) + 1) / self.full_scale, self.encoding)
        return np.asarray(table[np.minimum(pixels, int(self.full_scale))])

    def is_clipped(self, window: tuple[slice, slice]) -> NDArray[np.bool_]:
        """Where any channel of a window is at full scale, shape (h, w)."""
        clipped = self.pixels[window] >= _NEARLY_FULL * self.full_scale
        return np.asarray(clipped if clipped.ndim == 2 else clipped.any(axis=2))

    def grey(self) -> NDArray[np.float32]:
        """Return a grey picture for finding boards: sRGB-like tones, 0..255, shape (H, W).

        Colours by ITU-R BT.601. Linear pictures are encoded first: in linear tones a dark board
        would hardly show.
        """
        values = cv2.cvtColor(self.pixels, cv2.COLOR_RGB2GRAY) if self.is_colour else self.pixels
        if values.dtype == np.uint8 and self.encoding != "linear":
            return values.astype(np.float32)
        # Highlights may not set the scale: 0.5 % of a sample of the pixels lie above its top.
        stride = max(1, int(np.sqrt(values.size / _SAMPLED_PIXELS)))
        top = max(float(np.quantile(values[::stride, ::stride], 0.995)), 1e-6 * self.full_scale)
        if values.dtype == np.float32:
            return self._tones(values, top)
        table = self._tones(np.arange(np.iinfo(values.dtype).max + 1, dtype=np.float32), top)
        if values.dtype == np.uint8:
            return np.asarray(cv2.LUT(values, table))
        return np.asarray(table[values])

    def _tones(self, values: NDArray[np.float32], top: float) -> NDArray[np.float32]:
        """Scale to 0..255 of `top` in sRGB-like tones."""
        values = np.clip(values / np.float32(top), 0, 1)
        if self.encoding == "linear":
            values = encode(values.astype(np.float64), "srgb").astype(np.float32)
        return np.asarray(values * np.float32(255))


_SAMPLED_PIXELS = 100_000  # a quantile of so many is right to 0.02 %

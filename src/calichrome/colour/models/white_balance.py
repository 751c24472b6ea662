"""White balance alone: what every camera does, and the least one can do."""

from typing import ClassVar

import numpy as np

from calichrome.colorimetry.rgb_spaces import XYZ_FROM_RGB
from calichrome.colour.model import TermModel
from calichrome.core.arrays import FloatArray

__all__ = ["WhiteBalance"]

_XYZ_FROM_RGB = XYZ_FROM_RGB["srgb"] / XYZ_FROM_RGB["srgb"].sum(axis=1, keepdims=True)


class WhiteBalance(TermModel):
    """Balanced channels taken for those of sRGB: three gains, fixed by white."""

    __slots__ = ()
    MODEL: ClassVar[str] = "white-balance"
    MIN_COLOURS: ClassVar[int] = 0

    @property
    def n_free(self) -> int:
        """The gains."""
        return 3

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """None."""
        return balanced[..., :0]

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """None."""
        return np.zeros((*balanced.shape[:-1], 0, 3))

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        return np.asarray((rgb_linear / self.white_rgb) @ _XYZ_FROM_RGB.T * self.white_xyz)

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3)."""
        matrix = self.white_xyz[:, None] * _XYZ_FROM_RGB / self.white_rgb
        return np.broadcast_to(matrix, (*np.shape(rgb_linear), 3))

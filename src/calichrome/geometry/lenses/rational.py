"""Brown's model with a quotient along the radius, for lenses too wide for a polynomial."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses.curves import unit_cubic
from calichrome.geometry.lenses.radial_tangential import RadialTangential

__all__ = ["Rational"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rational(RadialTangential):
    """As `BrownConrady`, the radial factor divided by a second polynomial with k4 k5 k6.

    Notes
    -----
    ``g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)``. There is no image where
    the denominator is not positive.

    References
    ----------
    .. [1] D. Claus and A. W. Fitzgibbon, "A Rational Function Lens Distortion Model for General
       Cameras", CVPR 2005, for quotients as such; this one and its names are those of OpenCV's
       CALIB_RATIONAL_MODEL.
    """

    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    MODEL: ClassVar[str] = "rational"
    NAMES: ClassVar[tuple[str, ...]] = (
        *("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
        *("k4", "k5", "k6"),
    )
    OPTIONAL: ClassVar[tuple[tuple[str, ...], ...]] = (("p1", "p2"), ("k3",), ("k4", "k5", "k6"))

    @classmethod
    def _radial(cls, p: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        numerator, d_numerator = unit_cubic(p[4], p[5], p[8], s)
        denominator, d_denominator = unit_cubic(p[9], p[10], p[11], s)
        inverse = 1 / np.where(denominator > 0, denominator, np.nan)
        factor = numerator * inverse
        return factor, (d_numerator - factor * d_denominator) * inverse

    @classmethod
    def _d_radial(cls, p: FloatArray, s: FloatArray, plane_px: FloatArray, out: FloatArray) -> None:
        numerator, _ = unit_cubic(p[4], p[5], p[8], s)
        denominator, _ = unit_cubic(p[9], p[10], p[11], s)
        inverse = 1 / np.where(denominator > 0, denominator, np.nan)
        np.multiply(plane_px, s * inverse, out=out[4])
        np.multiply(out[4], -numerator * inverse, out=out[9])
        for first in 4, 9:
            np.multiply(out[first], s, out=out[first + 1])
        np.multiply(out[5], s, out=out[8])
        np.multiply(out[10], s, out=out[11])

    @property
    def _fraction(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return (1.0, self.k1, self.k2, self.k3), (1.0, self.k4, self.k5, self.k6)

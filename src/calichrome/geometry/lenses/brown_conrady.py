"""Pinhole with radial and tangential distortion: the paper's nine numbers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses.curves import unit_cubic
from calichrome.geometry.lenses.radial_tangential import RadialTangential

__all__ = ["BrownConrady"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BrownConrady(RadialTangential):
    """Focal lengths and principal point in pixels, distortion k1 k2 p1 p2 k3 as in OpenCV.

    Notes
    -----
    With x = X/Z, y = Y/Z, r^2 = x^2 + y^2 and g = 1 + k1 r^2 + k2 r^4 + k3 r^6::

        u = fx (x g + 2 p1 x y + p2 (r^2 + 2 x^2)) + cx
        v = fy (y g + p1 (r^2 + 2 y^2) + 2 p2 x y) + cy

    References
    ----------
    .. [1] D. C. Brown, "Close-Range Camera Calibration", Photogrammetric Engineering 37 (8), 1971,
       pp. 855-866.
    """

    MODEL: ClassVar[str] = "brown-conrady"
    NAMES: ClassVar[tuple[str, ...]] = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    OPTIONAL: ClassVar[tuple[tuple[str, ...], ...]] = (("k3",), ("p1", "p2"))

    @classmethod
    def _radial(cls, p: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return unit_cubic(p[4], p[5], p[8], s)

    @classmethod
    def _d_radial(
        cls,
        p: FloatArray,  # noqa: ARG003 (the factor is linear in its coefficients)
        s: FloatArray,
        plane_px: FloatArray,
        out: FloatArray,
    ) -> None:
        np.multiply(plane_px, s, out=out[4])
        np.multiply(out[4], s, out=out[5])
        np.multiply(out[5], s, out=out[8])

    @property
    def _fraction(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return (1.0, self.k1, self.k2, self.k3), (1.0,)

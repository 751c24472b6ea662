"""Output colour spaces: linear RGB of a display from XYZ under D65."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.core.arrays import FloatArray, frozen

__all__ = ["RGB_FROM_XYZ", "XYZ_FROM_RGB", "primaries_to_xyz"]


def primaries_to_xyz(primaries_xy: FloatArray, white_xyz: FloatArray) -> FloatArray:
    """Return the matrix to XYZ of an RGB space from its primaries and white.

    Parameters
    ----------
    primaries_xy : (3, 2) float
        Chromaticities of red, green, blue.
    white_xyz : (3,) float
        Tristimulus values of RGB = (1, 1, 1).

    References
    ----------
    .. [1] SMPTE RP 177-1993, section 3.
    """
    x, y = primaries_xy.T
    columns = np.stack([x / y, np.ones(3), (1 - x - y) / y])
    return np.asarray(columns * np.linalg.solve(columns, white_xyz))


# Both spaces share the white D65 and, when stored, the sRGB transfer function.
XYZ_FROM_RGB: Mapping[str, FloatArray] = MappingProxyType(
    {
        # IEC 61966-2-1:1999, the primaries of ITU-R BT.709
        "srgb": frozen(primaries_to_xyz(np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]]), D65)),
        # SMPTE EG 432-1 primaries with the white D65
        "display-p3": frozen(
            primaries_to_xyz(np.array([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]]), D65)
        ),
    }
)
RGB_FROM_XYZ: Mapping[str, FloatArray] = MappingProxyType(
    {name: frozen(np.linalg.inv(matrix)) for name, matrix in XYZ_FROM_RGB.items()}
)

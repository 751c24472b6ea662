"""CIELAB and colour differences (fast numpy; colour-science is the oracle in the tests)."""

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.core.arrays import FloatArray

__all__ = ["delta_e_2000", "delta_e_2000_xyz", "lab_from_xyz", "xyz_from_lab", "xyz_per_lab"]

_EPSILON, _KAPPA = 216 / 24389, 24389 / 27


def lab_from_xyz(xyz: FloatArray, white: FloatArray = D65) -> FloatArray:
    """CIE 1976 L*a*b* of tristimulus values on the same scale as `white`; shape (..., 3).

    References
    ----------
    .. [1] CIE 15:2018, eq. 8.3 to 8.11, with the exact constants (6/29)^3 and (29/3)^3.
    """
    ratio = xyz / white
    f = np.where(ratio > _EPSILON, np.cbrt(ratio), (_KAPPA * ratio + 16) / 116)
    fx, fy, fz = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)], axis=-1)


def xyz_from_lab(lab: FloatArray, white: FloatArray = D65) -> FloatArray:
    """Inverse of `lab_from_xyz`."""
    fy = (lab[..., 0] + 16) / 116
    f = np.stack([fy + lab[..., 1] / 500, fy, fy - lab[..., 2] / 200], axis=-1)
    cubed = f**3
    return np.asarray(np.where(cubed > _EPSILON, cubed, (116 * f - 16) / _KAPPA) * white)


def xyz_per_lab(xyz: FloatArray, white: FloatArray = D65) -> FloatArray:
    """Differentiate XYZ by L*, a* and b*, the last axis; shape (..., 3, 3)."""
    ratio = xyz / white
    slope = white * np.where(ratio > _EPSILON, 3 * np.cbrt(ratio) ** 2, 116 / _KAPPA)
    f_per_lab = np.array([[1 / 116, 1 / 500, 0], [1 / 116, 0, 0], [1 / 116, 0, -1 / 200]])
    return np.asarray(slope[..., None] * f_per_lab)


def delta_e_2000(lab_a: FloatArray, lab_b: FloatArray) -> FloatArray:
    """CIEDE2000 colour difference of two Lab arrays of shape (..., 3).

    References
    ----------
    .. [1] G. Sharma, W. Wu, E. N. Dalal, "The CIEDE2000 Color-Difference Formula: Implementation
       Notes, Supplementary Test Data, and Mathematical Observations", Color Res. Appl. 30 (1),
       2005, eq. 2 to 22.
    """
    l1, a1, b1 = np.moveaxis(np.asarray(lab_a, dtype=np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(lab_b, dtype=np.float64), -1, 0)
    c7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    g = 0.5 * (1 - np.sqrt(c7 / (c7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1 = np.degrees(np.arctan2(b1, a1)) % 360
    h2 = np.degrees(np.arctan2(b2, a2)) % 360

    grey = c1 * c2 == 0  # hue means nothing where either chroma is zero
    turn = h2 - h1
    d_h = np.where(grey, 0.0, turn - 360.0 * np.round(turn / 360.0))
    d_l, d_c = l2 - l1, c2 - c1
    d_big_h = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(d_h / 2))

    l_mean, c_mean = (l1 + l2) / 2, (c1 + c2) / 2
    h_sum = h1 + h2
    h_far = np.where(h_sum < 360, h_sum + 360, h_sum - 360)
    h_mean = np.where(grey, h_sum, np.where(np.abs(turn) <= 180 + 1e-9, h_sum, h_far) / 2)

    def cosine(degrees: FloatArray) -> FloatArray:
        return np.asarray(np.cos(np.radians(degrees)))

    t = (
        1
        - 0.17 * cosine(h_mean - 30)
        + 0.24 * cosine(2 * h_mean)
        + 0.32 * cosine(3 * h_mean + 6)
        - 0.20 * cosine(4 * h_mean - 63)
    )
    theta = 30 * np.exp(-(((h_mean - 275) / 25) ** 2))
    r_c = 2 * np.sqrt(c_mean**7 / (c_mean**7 + 25.0**7))
    s_l = 1 + 0.015 * (l_mean - 50) ** 2 / np.sqrt(20 + (l_mean - 50) ** 2)
    s_c = 1 + 0.045 * c_mean
    s_h = 1 + 0.015 * c_mean * t
    rotation = -np.sin(np.radians(2 * theta)) * r_c
    lightness, chroma, hue = d_l / s_l, d_c / s_c, d_big_h / s_h
    squared = lightness**2 + chroma**2 + hue**2 + rotation * chroma * hue
    return np.asarray(np.sqrt(np.maximum(squared, 0)))


def delta_e_2000_xyz(xyz_a: FloatArray, xyz_b: FloatArray) -> FloatArray:
    """CIEDE2000 of two XYZ arrays under D65, Y = 1 for the perfect diffuser."""
    return delta_e_2000(lab_from_xyz(xyz_a), lab_from_xyz(xyz_b))

"""Whites, and moving a colour from one light to another.

Written out in numpy because corrected pictures pass through it; colour-science is the oracle in
the tests.
"""

import numpy as np

from calichrome.core.arrays import FloatArray, frozen

__all__ = ["D50", "D65", "adapt"]

D65 = frozen([0.95047, 1.0, 1.08883])
"""White of D65, CIE 1931 2 degree, Y = 1 (ASTM E308; the values of DESIGN's colour conventions)."""

D50 = frozen([0.96422, 1.0, 0.82521])
"""White of D50, CIE 1931 2 degree, Y = 1 (ASTM E308)."""

_BRADFORD = frozen(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def adapt(xyz: FloatArray, white_from: FloatArray, white_to: FloatArray) -> FloatArray:
    """Return the corresponding colour under another white (linear Bradford).

    Parameters
    ----------
    xyz : (..., 3) float
        Tristimulus values under `white_from`.
    white_from, white_to : (3,) float
        Tristimulus values of the two whites, on the same scale.

    References
    ----------
    .. [1] K. M. Lam, "Metamerism and Colour Constancy", University of Bradford, 1985; matrix as in
       ICC.1:2022, annex E.
    """
    gains = (_BRADFORD @ white_to) / (_BRADFORD @ white_from)
    matrix = np.linalg.solve(_BRADFORD, gains[:, None] * _BRADFORD)
    return np.asarray(xyz @ matrix.T)

"""Roots of polynomials: as flexible as those, yet a change of exposure stays one.

Written as what a root differs by from the arithmetic mean of the same factors, the terms beyond the
first degree vanish on greys. White is then kept by the matrix part alone, and drawing the
coefficients towards 0 draws the model towards a matrix.

A root has an unbounded slope where a factor is 0: there the factor is lifted to a small share of
the colour's level, smoothly, so that the terms stay homogeneous.
"""

from typing import ClassVar

import numpy as np

from calichrome.colour.model import TermModel
from calichrome.core.arrays import FloatArray

__all__ = [
    "LIFT",
    "RootPolynomial",
    "RootPolynomial2",
    "RootPolynomial2White",
    "RootPolynomial3",
    "RootPolynomial3White",
]

LIFT = 0.15
"""Of the mean of the channels. The smallest balanced channel of 1269 Munsell chips under three
lights, seen by 47 cameras, is 0.19 of it; from 0.005 to 0.2 the error on the chips changes by less
than 0.02 dE, while the largest stretch of a difference in the camera cube falls from 24 to 8."""

_PAIRS = np.array([[1, 1, 0], [0, 1, 1], [1, 0, 1]]) / 2
_THIRDS = (
    np.array(
        [[2, 1, 0], [1, 2, 0], [0, 2, 1], [0, 1, 2], [2, 0, 1], [1, 0, 2], [1, 1, 1]],
    )
    / 3
)


def lifted(balanced: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the channels (..., 3), none below `LIFT` of their mean, and the slopes (..., 3, 3).

    (c + sqrt(c^2 + 4 l^2 m^2)) / 2 with the mean m, over its value at c = m so that greys are kept.
    """
    grey = (1 + np.sqrt(1 + 4 * LIFT**2)) / 2
    # of sizes: noise below black must not bring the level, and with it the floor, to 0
    floor = LIFT * np.abs(balanced).mean(axis=-1, keepdims=True)
    root = np.sqrt(balanced**2 + 4 * floor**2)
    safe = np.maximum(root, np.finfo(np.float64).tiny)
    by_own = (1 + balanced / safe) / 2
    by_floor = 2 * floor / safe
    by_size = LIFT * np.sign(balanced) / 3
    slopes = by_own[..., None] * np.eye(3) + by_floor[..., None] * by_size[..., None, :]
    return (balanced + root) / 2 / grey, slopes / grey


def deviations(balanced: FloatArray, exponents: FloatArray) -> FloatArray:
    """Geometric less arithmetic mean of the channels with weights `exponents` (P, 3), (..., P)."""
    channels, _ = lifted(balanced)
    with np.errstate(divide="ignore"):
        logs = np.log(channels)
    # black: log 0 times weight 0 would be nan, and its mean is 0 anyway
    finite = np.maximum(logs, -700.0)
    return np.asarray(np.exp(finite @ exponents.T) - channels @ exponents.T)


def deviation_slopes(balanced: FloatArray, exponents: FloatArray) -> FloatArray:
    """Return d deviations / d balanced, (..., P, 3)."""
    channels, by_balanced = lifted(balanced)
    safe = np.maximum(channels, np.exp(-700.0))
    geometric = np.exp(np.log(safe) @ exponents.T)
    by_channel = exponents * (geometric[..., None] / safe[..., None, :] - 1)
    return np.asarray(by_channel @ by_balanced)


class RootPolynomial(TermModel):
    """Matrix terms, then deviations of roots.

    References
    ----------
    .. [1] G. D. Finlayson, M. Mackiewicz, A. Hurlbert, "Color Correction Using Root-Polynomial
       Regression", IEEE Trans. Image Processing 24 (5), 2015 (the terms; here in another basis).
    """

    __slots__ = ()
    EXPONENTS: ClassVar[FloatArray]

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """Return R - G, B - G (or R, G, B), then the deviations."""
        first = balanced
        if cls.WHITE_EXACT:
            first = balanced[..., [0, 2]] - balanced[..., 1:2]
        return np.concatenate([first, deviations(balanced, cls.EXPONENTS)], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        first = np.eye(3)
        if cls.WHITE_EXACT:
            first = np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
        first = np.broadcast_to(first, (*balanced.shape[:-1], *first.shape))
        return np.concatenate([first, deviation_slopes(balanced, cls.EXPONENTS)], axis=-2)


class RootPolynomial2(RootPolynomial):
    """Degree 2: 18 numbers."""

    __slots__ = ()
    MODEL: ClassVar[str] = "root-polynomial-2"
    EXPONENTS: ClassVar[FloatArray] = _PAIRS
    MIN_COLOURS: ClassVar[int] = 6
    WHITE_EXACT: ClassVar[bool] = False


class RootPolynomial2White(RootPolynomial):
    """Degree 2, white kept: 15 numbers, nine of them drawn towards a matrix."""

    __slots__ = ()
    MODEL: ClassVar[str] = "root-polynomial-2-white"
    EXPONENTS: ClassVar[FloatArray] = _PAIRS
    MIN_COLOURS: ClassVar[int] = 5
    N_SHRUNK: ClassVar[int] = 3


class RootPolynomial3(RootPolynomial):
    """Degree 3: 39 numbers."""

    __slots__ = ()
    MODEL: ClassVar[str] = "root-polynomial-3"
    EXPONENTS: ClassVar[FloatArray] = np.concatenate([_PAIRS, _THIRDS])
    MIN_COLOURS: ClassVar[int] = 13
    WHITE_EXACT: ClassVar[bool] = False


class RootPolynomial3White(RootPolynomial):
    """Degree 3, white kept: 36 numbers, thirty of them drawn towards a matrix."""

    __slots__ = ()
    MODEL: ClassVar[str] = "root-polynomial-3-white"
    EXPONENTS: ClassVar[FloatArray] = np.concatenate([_PAIRS, _THIRDS])
    MIN_COLOURS: ClassVar[int] = 12
    N_SHRUNK: ClassVar[int] = 10

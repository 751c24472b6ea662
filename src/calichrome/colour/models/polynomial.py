"""Polynomials with the published lists of terms: good near the discs, at their exposure only."""

from typing import ClassVar

import numpy as np

from calichrome.colour.model import TermModel
from calichrome.core.arrays import FloatArray

__all__ = ["Cheung7", "Cheung10", "Cheung11", "Cheung20", "Polynomial"]

_FIRST = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_MIXED = ((1, 1, 0), (1, 0, 1), (0, 1, 1))
_SQUARES = ((2, 0, 0), (0, 2, 0), (0, 0, 2))
_CUBES = ((3, 0, 0), (0, 3, 0), (0, 0, 3))
_MIXED_CUBES = ((2, 1, 0), (0, 2, 1), (1, 0, 2), (2, 0, 1), (1, 2, 0), (0, 1, 2))


class Polynomial(TermModel):
    """Monomials of balanced R, G, B by their exponents, (P, 3).

    References
    ----------
    .. [1] V. Cheung, S. Westland, D. Connah, C. Ripamonti, "A comparative study of the
       characterisation of colour cameras by means of neural networks and polynomial transforms",
       Coloration Technology 120 (1), 2004; terms as in Westland, Ripamonti, Cheung,
       "Computational Colour Science Using MATLAB", table 8.2.
    """

    __slots__ = ()
    EXPONENTS: ClassVar[tuple[tuple[int, int, int], ...]]
    HOMOGENEOUS: ClassVar[bool] = False
    WHITE_EXACT: ClassVar[bool] = False

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """Return the monomials."""
        exponents = np.array(cls.EXPONENTS)
        return np.asarray(np.prod(balanced[..., None, :] ** exponents, axis=-1))

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""
        exponents = np.array(cls.EXPONENTS)
        columns = []
        for axis in range(3):
            lowered = exponents.copy()
            lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
            columns.append(exponents[:, axis] * np.prod(balanced[..., None, :] ** lowered, axis=-1))
        return np.stack(columns, axis=-1)


class Cheung7(Polynomial):
    """R, G, B, RG, RB, GB, 1."""

    __slots__ = ()
    MODEL: ClassVar[str] = "cheung-7"
    EXPONENTS = (*_FIRST, *_MIXED, (0, 0, 0))
    MIN_COLOURS: ClassVar[int] = 7


class Cheung10(Polynomial):
    """Degree 2 in full, RGB in place of nothing: R, G, B, RG, RB, GB, squares, 1."""

    __slots__ = ()
    MODEL: ClassVar[str] = "cheung-10"
    EXPONENTS = (*_FIRST, *_MIXED, *_SQUARES, (0, 0, 0))
    MIN_COLOURS: ClassVar[int] = 10


class Cheung11(Polynomial):
    """Those of Cheung 10, and RGB."""

    __slots__ = ()
    MODEL: ClassVar[str] = "cheung-11"
    EXPONENTS = (*_FIRST, *_MIXED, *_SQUARES, (1, 1, 1), (0, 0, 0))
    MIN_COLOURS: ClassVar[int] = 11


class Cheung20(Polynomial):
    """Degree 3 in full."""

    __slots__ = ()
    MODEL: ClassVar[str] = "cheung-20"
    EXPONENTS = (
        *_FIRST, *_MIXED, *_SQUARES, (1, 1, 1), *_CUBES, *_MIXED_CUBES, (0, 0, 0),
    )  # fmt: skip
    MIN_COLOURS: ClassVar[int] = 20

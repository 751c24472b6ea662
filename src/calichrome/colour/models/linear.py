"""Matrices: exact for a camera whose sensitivities are mixtures of the observer's."""

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from calichrome.colour.model import TermModel, to_floats
from calichrome.core.arrays import FloatArray, checked

__all__ = ["Affine", "Linear", "LinearWhite"]


class Linear(TermModel):
    """``xyz = matrix @ rgb``: nine numbers."""

    __slots__ = ()
    MODEL: ClassVar[str] = "linear"
    MIN_COLOURS: ClassVar[int] = 3
    WHITE_EXACT: ClassVar[bool] = False

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> Self:
        """Build it from ``xyz = matrix @ rgb``, (3, 3)."""
        return cls(np.ones(3), np.ones(3), checked(matrix, (3, 3), "matrix").T)

    @property
    def matrix(self) -> FloatArray:
        """From camera RGB to XYZ, (3, 3)."""
        return np.asarray(self.white_xyz[:, None] * self.coefficients.T / self.white_rgb)

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R, G, B."""
        return balanced

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., 3, 3)."""
        return np.broadcast_to(np.eye(3), (*balanced.shape, 3))

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json: the matrix alone."""
        return {"matrix": self.matrix.tolist()}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        return cls.from_matrix(to_floats(parameters["matrix"]))


class LinearWhite(TermModel):
    """A matrix that keeps white: six numbers.

    References
    ----------
    .. [1] G. D. Finlayson, M. S. Drew, "Constrained least-squares regression in color spaces",
       J. Electronic Imaging 6 (4), 1997.
    """

    __slots__ = ()
    MODEL: ClassVar[str] = "linear-white"
    MIN_COLOURS: ClassVar[int] = 2

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R - G and B - G."""
        return np.asarray(balanced[..., [0, 2]] - balanced[..., 1:2])

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., 2, 3)."""
        return np.broadcast_to(
            np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]]), (*balanced.shape[:-1], 2, 3)
        )


class Affine(TermModel):
    """A matrix and an offset (flare, a wrong black level): twelve numbers."""

    __slots__ = ()
    MODEL: ClassVar[str] = "affine"
    MIN_COLOURS: ClassVar[int] = 4
    HOMOGENEOUS: ClassVar[bool] = False
    WHITE_EXACT: ClassVar[bool] = False

    @classmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """R, G, B, 1."""
        return np.concatenate([balanced, np.ones_like(balanced[..., :1])], axis=-1)

    @classmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., 4, 3)."""
        return np.broadcast_to(np.eye(4, 3), (*balanced.shape[:-1], 4, 3))

"""A 3x3 matrix: exact for a camera whose sensitivities are mixtures of the observer's."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["Linear"]


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """``xyz = matrix @ rgb``.

    Parameters
    ----------
    matrix : (3, 3) float
    """

    matrix: FloatArray

    MODEL: ClassVar[str] = "linear"
    MIN_COLOURS: ClassVar[int] = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen(checked(self.matrix, (3, 3), "matrix")))

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        return 9

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        return np.asarray(rgb_linear @ self.matrix.T)

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        return {"matrix": self.matrix.tolist()}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        return cls(np.asarray(parameters["matrix"], dtype=np.float64))

    @classmethod
    def fit(cls, rgb_linear: FloatArray, xyz: FloatArray) -> Self:
        """Least squares in XYZ.

        Parameters
        ----------
        rgb_linear : (N, 3) float, 0..1 of full scale
        xyz : (N, 3) float, Y = 1 for the perfect diffuser
        """
        solution, *_ = np.linalg.lstsq(rgb_linear, xyz, rcond=None)
        return cls(np.asarray(solution.T, dtype=np.float64))

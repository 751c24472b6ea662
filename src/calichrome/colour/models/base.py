"""What every colour model can do."""

from collections.abc import Mapping
from typing import ClassVar, Protocol, Self

from calichrome.core.arrays import FloatArray

__all__ = ["ColourModel"]


class ColourModel(Protocol):
    """A map from linear camera RGB to XYZ under D65, Y = 1 for the perfect diffuser."""

    MODEL: ClassVar[str]
    MIN_COLOURS: ClassVar[int]

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        ...

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        ...

    @classmethod
    def fit(cls, rgb_linear: FloatArray, xyz: FloatArray) -> Self:
        """Fit to matching colours (N, 3), N >= `MIN_COLOURS`."""
        ...

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        ...

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        ...

"""What every colour model can do."""

from typing import ClassVar, Protocol

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

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        ...

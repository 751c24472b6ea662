"""What every lens model can do."""

from collections.abc import Mapping
from typing import ClassVar, Protocol, Self

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["Lens"]


class Lens(Protocol):
    """A map from rays to pixels with named parameters.

    Pixel (0, 0) is the centre of the top-left pixel; camera x right, y down, z forward.
    """

    MODEL: ClassVar[str]
    NAMES: ClassVar[tuple[str, ...]]

    @property
    def parameters(self) -> FloatArray:
        """Values in the order of `NAMES`."""
        ...

    @classmethod
    def from_parameters(cls, parameters: FloatArray) -> Self:
        """Build from values in the order of `NAMES`."""
        ...

    def as_dict(self) -> Mapping[str, float]:
        """Values by name."""
        ...

    def project(self, points_cam: FloatArray) -> FloatArray:
        """Project points (N, 3), metres, to pixels (N, 2); nan behind the camera."""
        ...

    def project_with_jacobians(
        self, points_cam: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pixels (N, 2), d_pixels_d_parameters (N, 2, P), d_pixels_d_points (N, 2, 3)."""
        ...

    def sees(self, points_cam: FloatArray) -> BoolArray:
        """Tell which points (N, 3) have a pixel of their own, shape (N,)."""
        ...

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Return rays (N, 3) with z = 1; nan where no ray reaches the pixel."""
        ...

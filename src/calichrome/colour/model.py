"""What every colour model can do, and what those share that are linear in their parameters."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

import numpy as np

from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["ColourModel", "TermModel", "central_differences", "to_floats"]

_STEP = 1e-5  # of white: half the digits are left for the difference


class ColourModel(Protocol):
    """A map from linear camera RGB to XYZ under D65, Y = 1 for the perfect diffuser.

    Class attributes
    ----------------
    MODEL
        Name in rig.json.
    MIN_COLOURS
        Fewest different colours that fix the parameters.
    HOMOGENEOUS
        Whether f(k c) = k f(c): a change of exposure stays one.
    WHITE_EXACT
        Whether the white is mapped exactly, whatever the discs say.
    """

    MODEL: ClassVar[str]
    MIN_COLOURS: ClassVar[int]
    HOMOGENEOUS: ClassVar[bool]
    WHITE_EXACT: ClassVar[bool]

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        ...

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        ...

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3)."""
        ...

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        ...

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        ...


def to_floats(value: object) -> FloatArray:
    """Return the numbers of a JSON list."""
    return np.asarray(value, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class TermModel(ABC):
    """``xyz = white_xyz * (base + terms(rgb / white_rgb) @ coefficients)``.

    The base is the balanced green of models that keep white: their terms vanish on greys, so greys
    stay grey whatever the coefficients are. It is 0 for the others.

    Parameters
    ----------
    white_rgb : (3,) float
        What the camera makes of the perfect diffuser in the reference light.
    white_xyz : (3,) float
        What the perfect diffuser is to become.
    coefficients : (P, 3) float
    """

    white_rgb: FloatArray
    white_xyz: FloatArray
    coefficients: FloatArray

    MODEL: ClassVar[str]
    MIN_COLOURS: ClassVar[int]
    HOMOGENEOUS: ClassVar[bool] = True
    WHITE_EXACT: ClassVar[bool] = True
    N_SHRUNK: ClassVar[int] = 0
    """How many of the last terms are drawn towards 0, with a strength found by leave-one-out."""

    def __post_init__(self) -> None:
        for name, shape in (("white_rgb", (3,)), ("white_xyz", (3,)), ("coefficients", (None, 3))):
            object.__setattr__(self, name, frozen(checked(getattr(self, name), shape, name)))
        if len(self.coefficients) != self.MIN_COLOURS:
            raise ValueError(
                f"coefficients: {self.MODEL} has {self.MIN_COLOURS} terms, got "
                f"{len(self.coefficients)}"
            )
        if not (self.white_rgb > 0).all():
            raise ValueError("white_rgb: every channel must be positive")

    @classmethod
    @abstractmethod
    def terms(cls, balanced: FloatArray) -> FloatArray:
        """Return the terms (..., P) of balanced colours (..., 3); white is 1, 1, 1."""

    @classmethod
    @abstractmethod
    def slopes(cls, balanced: FloatArray) -> FloatArray:
        """Return d terms / d balanced, (..., P, 3)."""

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        return int(self.coefficients.size)

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        balanced = rgb_linear / self.white_rgb
        relative = self.terms(balanced) @ self.coefficients
        if self.WHITE_EXACT:
            relative = relative + balanced[..., 1:2]
        return np.asarray(relative * self.white_xyz)

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3)."""
        slopes = np.swapaxes(self.slopes(rgb_linear / self.white_rgb), -1, -2)
        relative = np.swapaxes(slopes @ self.coefficients, -1, -2)
        if self.WHITE_EXACT:
            relative = relative + np.array([0.0, 1.0, 0.0])
        return np.asarray(relative * self.white_xyz[:, None] / self.white_rgb)

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        return {
            "white_rgb": self.white_rgb.tolist(),
            "white_xyz": self.white_xyz.tolist(),
            "coefficients": self.coefficients.tolist(),
        }

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        white_rgb, white_xyz = (to_floats(parameters[name]) for name in ("white_rgb", "white_xyz"))
        return cls(white_rgb, white_xyz, to_floats(parameters["coefficients"]).reshape(-1, 3))


def central_differences(
    apply: Callable[[FloatArray], FloatArray], rgb_linear: FloatArray, white_rgb: FloatArray
) -> FloatArray:
    """Return d xyz / d rgb, (..., 3, 3), of a map without a simple derivative."""
    steps = _STEP * np.diag(white_rgb)
    columns = [
        (apply(rgb_linear + step) - apply(rgb_linear - step)) / (2 * step.sum()) for step in steps
    ]
    return np.stack(columns, axis=-1)

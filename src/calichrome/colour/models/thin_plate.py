"""Splines through, or near, the discs.

A sum of kernels about the training colours and a matrix (or an affine map), the smoothest map that
meets the colours as closely as their noise allows. In camera space it is the classical 3-D
thin-plate spline; in chromaticity, times the level, it keeps white and exposure.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calichrome.colour.model import central_differences, to_floats
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["ChromaticitySpline", "ThinPlate", "ThinPlateExact"]

_STRENGTHS = (0.0, *10.0 ** np.arange(-4, 3.01, 0.5))
"""Noise of the colours over what the spline may bend: from interpolation to a matrix."""
_FIELDS = ("white_rgb", "white_xyz", "centres", "weights", "affine")


@dataclass(frozen=True, slots=True, eq=False)
class ThinPlate:
    """``xyz = white_xyz * (trend(c) @ affine + sum_i weights_i |c - c_i|)`` with balanced c.

    Parameters
    ----------
    white_rgb, white_xyz : (3,) float
        As in `TermModel`.
    centres : (N, 3) float
        Balanced training colours.
    weights : (N, 3) float
    affine : (4, 3) float
        Of 1, R, G, B.

    References
    ----------
    .. [1] J. Duchon, "Splines minimizing rotation-invariant semi-norms in Sobolev spaces", 1977
       (in three dimensions the kernel is the distance itself).
    .. [2] G. Wahba, "Spline Models for Observational Data", SIAM, 1990, section 2.4 (smoothing).
    """

    white_rgb: FloatArray
    white_xyz: FloatArray
    centres: FloatArray
    weights: FloatArray
    affine: FloatArray

    MODEL: ClassVar[str] = "thin-plate"
    MIN_COLOURS: ClassVar[int] = 5
    HOMOGENEOUS: ClassVar[bool] = False
    WHITE_EXACT: ClassVar[bool] = False
    STRENGTHS: ClassVar[tuple[float, ...]] = _STRENGTHS

    def __post_init__(self) -> None:
        for name, shape in (
            ("white_rgb", (3,)), ("white_xyz", (3,)), ("centres", (None, 3)),
            ("weights", (len(self.centres), 3)), ("affine", (None, 3)),
        ):  # fmt: skip
            object.__setattr__(self, name, frozen(checked(getattr(self, name), shape, name)))

    @classmethod
    def fit(cls, pairs: ColourPairs) -> Self:
        """Fit with the strength of the smallest leave-one-out error."""
        centres, wanted, noise = cls._points(pairs)
        scale = cls._level(pairs.balanced)
        inputs, n_fixed = cls._coordinates(centres), len(centres) - len(pairs)
        kernel, trend = cls._kernel(inputs, inputs), cls._trend(inputs)
        n_trend = trend.shape[1]
        best: tuple[float, FloatArray] | None = None
        for strength in cls.STRENGTHS:
            system = np.block(
                [
                    [kernel + np.diag(strength * noise), trend],
                    [trend.T, np.zeros((n_trend, n_trend))],
                ]
            )
            inverse = np.linalg.pinv(system)
            solution = inverse[:, : len(wanted)] @ wanted
            # what a point is missed by without itself: O. Dubrule, Math. Geology 15 (6), 1983
            own = np.diag(inverse)[: len(pairs)]
            missed = solution[: len(pairs)] / np.where(own == 0, np.inf, own)[:, None]
            predicted = (wanted[: len(pairs)] - missed) * scale * pairs.white_xyz
            error = pairs.difference(predicted)
            score = float(error @ pairs.weights)
            if best is None or score < best[0]:
                best = score, solution
        assert best is not None  # noqa: S101 (there is a strength)
        n_points = len(pairs) + n_fixed
        return cls(
            pairs.white_rgb, pairs.white_xyz, centres, best[1][:n_points], best[1][n_points:]
        )

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        return int(self.weights.size + self.affine.size)

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        balanced = rgb_linear / self.white_rgb
        inputs = self._coordinates(balanced)
        value = self._kernel(inputs, self._coordinates(self.centres)) @ self.weights
        value = value + self._trend(inputs) @ self.affine
        return np.asarray(value * self._level(balanced) * self.white_xyz)

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3), by central differences."""
        return central_differences(self.apply, rgb_linear, self.white_rgb)

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        return {name: getattr(self, name).tolist() for name in _FIELDS}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        return cls(*(to_floats(parameters[name]) for name in _FIELDS))

    @classmethod
    def _points(cls, pairs: ColourPairs) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return centres, values and noise variances over their mean."""
        noise = np.trace(np.linalg.inv(pairs.whitening), axis1=1, axis2=2)
        level = cls._level(pairs.balanced)
        noise = noise / level[:, 0] ** 2
        return pairs.balanced, pairs.relative / level, noise / noise.mean()

    @classmethod
    def _coordinates(cls, balanced: FloatArray) -> FloatArray:
        return balanced

    @classmethod
    def _level(cls, balanced: FloatArray) -> FloatArray:
        return np.ones_like(balanced[..., :1])

    @classmethod
    def _trend(cls, inputs: FloatArray) -> FloatArray:
        return np.concatenate([np.ones_like(inputs[..., :1]), inputs], axis=-1)

    @classmethod
    def _kernel(cls, inputs: FloatArray, centres: FloatArray) -> FloatArray:
        away = np.linalg.norm(inputs[..., None, :] - centres, axis=-1)
        # conditionally positive definite with this sign
        return np.asarray(-away)


class ThinPlateExact(ThinPlate):
    """The spline through every disc: exact there, noise and all."""

    __slots__ = ()
    MODEL: ClassVar[str] = "thin-plate-exact"
    STRENGTHS: ClassVar[tuple[float, ...]] = (0.0,)


class ChromaticitySpline(ThinPlate):
    """Level times a 2-D spline of chromaticity: exposure and white are kept.

    The white is one more point of the spline, without noise. `affine` then has three rows: of 1 and
    of the shares of red and blue.
    """

    __slots__ = ()
    MODEL: ClassVar[str] = "chromaticity-spline"
    MIN_COLOURS: ClassVar[int] = 5
    HOMOGENEOUS: ClassVar[bool] = True
    WHITE_EXACT: ClassVar[bool] = True

    @classmethod
    def _points(cls, pairs: ColourPairs) -> tuple[FloatArray, FloatArray, FloatArray]:
        centres, values, noise = super()._points(pairs)
        one = np.ones((1, 3))
        return (
            np.concatenate([centres, one]),
            np.concatenate([values, one]),
            np.concatenate([noise, [0.0]]),
        )

    @classmethod
    def _coordinates(cls, balanced: FloatArray) -> FloatArray:
        """Shares of red and blue; those of white where there is no light."""
        level = balanced.mean(axis=-1, keepdims=True)
        safe = np.where(level > 0, level, 1.0)
        shares = np.where(level > 0, balanced[..., [0, 2]] / safe, 1.0) / 3
        # beyond the triangle of what light can do, the spline goes on as at its border
        return np.asarray(np.clip(shares, 0.0, 1.0))

    @classmethod
    def _level(cls, balanced: FloatArray) -> FloatArray:
        return np.asarray(balanced.mean(axis=-1, keepdims=True))

    @classmethod
    def _kernel(cls, inputs: FloatArray, centres: FloatArray) -> FloatArray:
        squared = ((inputs[..., None, :] - centres) ** 2).sum(axis=-1)
        return np.asarray(0.5 * squared * np.log(np.maximum(squared, 1e-30)))

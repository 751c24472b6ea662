"""A matrix for every colour, fitted to the discs of like chromaticity."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calichrome.colour.model import central_differences, to_floats
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray, IntArray, checked, frozen

__all__ = ["LocalRegression"]

_WIDTHS = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0)
"""Of the neighbourhood, in channels over their sum: from the nearest discs to all of them."""
_PULL = 0.02
"""Weight of the matrix of all discs beside the neighbours', so that a colour without neighbours
gets that one. On the Munsell chips 0.01 to 0.05 differ by 0.04 dE, 0.2 is worse by 0.1."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalRegression:
    """Weighted least squares at every colour; white and exposure are kept.

    Parameters
    ----------
    white_rgb, white_xyz : (3,) float
        As in `TermModel`.
    balanced, relative : (N, 3) float
        The discs.
    weights : (N,) float
        What each counts.
    width
        Of the Gaussian neighbourhood in chromaticity.

    References
    ----------
    .. [1] W. S. Cleveland, S. J. Devlin, "Locally Weighted Regression", JASA 83 (403), 1988.
    """

    white_rgb: FloatArray
    white_xyz: FloatArray
    balanced: FloatArray
    relative: FloatArray
    weights: FloatArray
    width: float

    MODEL: ClassVar[str] = "local-regression"
    MIN_COLOURS: ClassVar[int] = 4
    HOMOGENEOUS: ClassVar[bool] = True
    WHITE_EXACT: ClassVar[bool] = True

    def __post_init__(self) -> None:
        n = len(self.balanced)
        for name, shape in (
            ("white_rgb", (3,)), ("white_xyz", (3,)), ("balanced", (None, 3)),
            ("relative", (n, 3)), ("weights", (n,)),
        ):  # fmt: skip
            object.__setattr__(self, name, frozen(checked(getattr(self, name), shape, name)))

    @classmethod
    def fit(cls, pairs: ColourPairs) -> Self:
        """Fit with the width of the smallest leave-one-out error."""
        weights = 1 / np.trace(np.linalg.inv(pairs.whitening), axis1=1, axis2=2)
        rows = np.arange(len(pairs))
        best: tuple[float, Self] | None = None
        for width in _WIDTHS:
            model = cls(
                pairs.white_rgb, pairs.white_xyz, pairs.balanced, pairs.relative,
                weights / weights.mean(), width,
            )  # fmt: skip
            predicted = model._map(pairs.balanced, without=rows) * pairs.white_xyz
            error = pairs.difference(predicted)
            score = float(error @ pairs.weights)
            if best is None or score < best[0]:
                best = score, model
        assert best is not None  # noqa: S101 (there is a width)
        return best[1]

    @property
    def n_free(self) -> int:
        """Number of fitted parameters: the discs themselves."""
        return int(self.relative.size)

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        balanced = np.asarray(rgb_linear / self.white_rgb).reshape(-1, 3)
        return np.asarray((self._map(balanced) * self.white_xyz).reshape(np.shape(rgb_linear)))

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3), by central differences."""
        return central_differences(self.apply, rgb_linear, self.white_rgb)

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        names = ("white_rgb", "white_xyz", "balanced", "relative", "weights")
        return {name: getattr(self, name).tolist() for name in names} | {"width": self.width}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        names = ("white_rgb", "white_xyz", "balanced", "relative", "weights")
        white_rgb, white_xyz, balanced, relative, weights = (
            to_floats(parameters[name]) for name in names
        )
        width = float(to_floats(parameters["width"]))
        return cls(white_rgb, white_xyz, balanced, relative, weights, width)

    def _map(self, balanced: FloatArray, without: IntArray | None = None) -> FloatArray:
        """Map balanced colours (M, 3); `without` names the disc that each must not use."""
        away = _chromaticity(balanced)[:, None] - _chromaticity(self.balanced)
        near = np.exp(-0.5 * (away**2).sum(axis=-1) / self.width**2)
        counted = (near + _PULL) * self.weights
        if without is not None:
            counted[np.arange(len(balanced)), without] = 0.0
        chroma, wanted = _chroma(self.balanced), self.relative - self.balanced[:, 1:2]
        normal = np.einsum("mn,ni,nj->mij", counted, chroma, chroma)
        side = np.einsum("mn,ni,nj->mij", counted, chroma, wanted)
        matrices = np.linalg.solve(normal, side)
        return np.asarray(np.einsum("mi,mij->mj", _chroma(balanced), matrices) + balanced[:, 1:2])


def _chroma(balanced: FloatArray) -> FloatArray:
    return np.asarray(balanced[:, [0, 2]] - balanced[:, 1:2])


def _chromaticity(balanced: FloatArray) -> FloatArray:
    """Shares of red and blue, (N, 2); those of white where there is no light."""
    total = balanced.sum(axis=-1, keepdims=True)
    safe = np.where(total > 0, total, 1.0)
    return np.asarray(np.where(total > 0, balanced[:, [0, 2]] / safe, 1 / 3))

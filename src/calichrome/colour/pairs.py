"""What a colour model is fitted to: camera colours, what they should become, and how sure."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.description import DescriptionSpace, difference, metric
from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.target import Target

__all__ = ["ColourPairs", "print_tolerance"]

_PRINTED_SD = 3.0
"""Of L, a and b of a disc about its table, if the print was not measured: what DESIGN takes as the
error of an uncalibrated printer."""
_MEASURED_SD = 0.5  # the same if it was measured: repeatability of hand-held instruments

_LIGHT = 0.02
"""Relative error of a camera colour beyond its stated covariance: light that the white beside a
disc does not show, gloss, an exposure that is not quite linear. With it, fits to 24 colours predict
the 1269 Munsell chips (9 pairs of camera and light) about as well at 1 % of unstated noise as with
that noise stated; 0.01 is 0.005 dE better without noise and 0.02 worse with it."""
_MISFIT = 1.0
"""dE by which even an exact fit misses colours it has not seen: sensors are no observers. On the
Munsell chips 0.5 to 1.5; factors of 2 change the errors there by less than 0.03."""


def print_tolerance(target: Target) -> float:
    """Return the standard deviation of L, a and b of a disc about its table."""
    return _MEASURED_SD if target.colours_measured else _PRINTED_SD


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourPairs:
    """Matching colours of one camera.

    Parameters
    ----------
    rgb : (N, 3) float
        Linear camera values in one light, 0..1 of full scale.
    xyz : (N, 3) float
        What they are to become, Y = 1 for the perfect diffuser.
    white_rgb : (3,) float
        What the camera makes of white: the paper, or what the greys tell of the perfect diffuser.
    white_xyz : (3,) float
        What that is to become.
    adopted_white : (3,) float
        XYZ of the perfect diffuser in the light that `xyz` is under: the white of Lab.
    rgb_cov : (N, 3, 3) float
        Covariance of `rgb`; zeros if it was not measured.
    xyz_cov : (N, 3, 3) float
        Covariance of `xyz`: tolerance of the print, or of its measurement.
    weights : (N,) float
        Priorities of the user; 1 where nothing was said.
    space
        Where errors are judged.
    whitening : (N, 3, 3) float
        Inverse covariance of `relative` about a model, times the priorities.
    """

    rgb: FloatArray
    xyz: FloatArray
    white_rgb: FloatArray
    white_xyz: FloatArray
    adopted_white: FloatArray
    rgb_cov: FloatArray
    xyz_cov: FloatArray
    weights: FloatArray
    space: DescriptionSpace
    whitening: FloatArray

    def __post_init__(self) -> None:
        n = len(self.rgb)
        for name, shape in (
            ("rgb", (n, 3)), ("xyz", (n, 3)), ("white_rgb", (3,)), ("white_xyz", (3,)),
            ("adopted_white", (3,)), ("rgb_cov", (n, 3, 3)), ("xyz_cov", (n, 3, 3)),
            ("weights", (n,)), ("whitening", (n, 3, 3)),
        ):  # fmt: skip
            values = getattr(self, name)
            if values.shape != shape:
                raise ValueError(f"{name}: expected shape {shape}, got {values.shape}")
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: holds a value that is not finite")

    @classmethod
    def of(
        cls,
        rgb: FloatArray,
        xyz: FloatArray,
        *,
        white_rgb: FloatArray | None = None,
        white_xyz: FloatArray | None = None,
        adopted_white: FloatArray = D65,
        rgb_cov: FloatArray | None = None,
        xyz_cov: FloatArray | None = None,
        weights: FloatArray | None = None,
        space: DescriptionSpace = "lab2000",
    ) -> Self:
        """Build pairs; what is not given is taken as exact, and white from the greys."""
        rgb, xyz = np.asarray(rgb, dtype=np.float64), np.asarray(xyz, dtype=np.float64)
        n = len(rgb)
        if white_xyz is None:
            white_xyz = adopted_white
        if white_rgb is None:
            white_rgb = _white_of_greys(rgb, xyz, white_xyz)
        rgb_cov = np.zeros((n, 3, 3)) if rgb_cov is None else rgb_cov
        xyz_cov = np.zeros((n, 3, 3)) if xyz_cov is None else xyz_cov
        weights = np.ones(n) if weights is None else weights
        misfit = np.linalg.inv(metric(xyz, space, adopted_white)) * _MISFIT**2
        covariance = _covariance(rgb, xyz, white_rgb, white_xyz, rgb_cov, xyz_cov + misfit)
        return cls(
            rgb=rgb, xyz=xyz, white_rgb=white_rgb, white_xyz=white_xyz,
            adopted_white=adopted_white, rgb_cov=rgb_cov, xyz_cov=xyz_cov,
            weights=weights, space=space,
            whitening=np.linalg.inv(covariance) * weights[:, None, None],
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.rgb)

    def __getitem__(self, chosen: BoolArray) -> "ColourPairs":
        """Return some of them."""
        rows = {
            name: getattr(self, name)[chosen]
            for name in ("rgb", "xyz", "rgb_cov", "xyz_cov", "weights", "whitening")
        }
        return replace(self, **rows)

    @property
    def balanced(self) -> FloatArray:
        """Camera colours over white, (N, 3)."""
        return np.asarray(self.rgb / self.white_rgb)

    @property
    def relative(self) -> FloatArray:
        """Targets over white, (N, 3)."""
        return np.asarray(self.xyz / self.white_xyz)

    @property
    def errors_of_fit(self) -> FloatArray:
        """Covariance of a target about the model, in XYZ, (N, 3, 3)."""
        scale = np.outer(self.white_xyz, self.white_xyz)
        return np.asarray(np.linalg.inv(self.whitening / self.weights[:, None, None]) * scale)

    def difference(self, xyz: FloatArray) -> FloatArray:
        """How far (..., N, 3) XYZ are from the targets in the description space, (..., N)."""
        return difference(xyz, self.xyz, self.space, self.adopted_white)

    def with_targets(self, xyz: FloatArray, xyz_cov: FloatArray) -> "ColourPairs":
        """Return the same camera colours with other targets."""
        return ColourPairs.of(
            self.rgb, xyz, white_rgb=self.white_rgb, white_xyz=self.white_xyz,
            adopted_white=self.adopted_white, rgb_cov=self.rgb_cov, xyz_cov=xyz_cov,
            weights=self.weights, space=self.space,
        )  # fmt: skip


def _covariance(
    rgb: FloatArray,
    xyz: FloatArray,
    white_rgb: FloatArray,
    white_xyz: FloatArray,
    rgb_cov: FloatArray,
    xyz_cov: FloatArray,
) -> FloatArray:
    """By how much targets over white may miss a model, (N, 3, 3).

    The sum of the tolerance of the targets (with what no model can help) and the noise of the
    camera colours, carried through a matrix.
    """
    balanced, relative = rgb / white_rgb, xyz / white_xyz
    # a matrix is good to some per cent, and only carries covariances here
    matrix, *_ = np.linalg.lstsq(balanced, relative, rcond=None)
    seen = rgb_cov / np.outer(white_rgb, white_rgb)
    seen = seen + (_LIGHT * balanced[:, :, None] * np.eye(3)) ** 2
    scale = np.outer(white_xyz, white_xyz)
    return np.asarray(matrix.T @ seen @ matrix + xyz_cov / scale)


def _white_of_greys(rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> FloatArray:
    """Camera value of the perfect diffuser from the greyest colours, all where none is grey."""
    relative = xyz / white_xyz
    spread = np.ptp(relative, axis=1) / np.maximum(relative.mean(axis=1), 1e-9)
    greys = spread <= max(2 * float(np.sort(spread)[min(2, len(spread) - 1)]), 0.1)
    return np.asarray(np.median(rgb[greys] / relative[greys, 1:2], axis=0))

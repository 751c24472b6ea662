"""A picture at several scales, and its noise."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["Plane", "Pyramid", "build_pyramid", "estimate_noise"]

Plane = NDArray[np.float32]

_SEARCH_PIXELS = 4_000_000
"""Larger pictures are searched at 1/2, 1/3, ... of their size: 12 MP at 3 MP. Squares of the
smallest size that is found with certainty, 10 px, are then 20 px."""

_N_LEVELS = 4
"""The coarsest level blurs by 10 px: boards out of focus by a PSF of 5 px sigma are found."""

_BLUR_PX = 1.0
_KERNEL = (5, 5)
_SMALLEST_SIDE_PX = 40

_LAPLACIANS_PER_SIGMA = 6.0
_USED_SHARE = 0.3
_NORMAL_QUANTILE = 0.3853
"""30 % of a normal distribution lies within 0.3853 sigma. A low share keeps edges and texture out:
they raise the large values."""

_REMAP_ROWS = 30_000  # cv2.remap takes at most 32767


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Blurred planes of falling size.

    Parameters
    ----------
    planes
        Level 0 is the picture, reduced and blurred; each further level is half as large. Pixel
        (x, y) of level n lies at (2^n x, 2^n y) of level 0.
    reduction
        Pixels of the picture per pixel of level 0, a whole number.
    noise
        Standard deviation of the noise of the reduced picture, DN, before it was blurred.
    size_hw
        Of the picture.
    """

    planes: tuple[Plane, ...]
    reduction: int
    noise: float
    size_hw: tuple[int, int]

    def pitch(self, level: IntArray) -> FloatArray:
        """Return the size of a pixel of each level (N,) in pixels of the picture."""
        return np.asarray(2.0**level * self.reduction)

    def holds(self, points_px: FloatArray) -> NDArray[np.bool_]:
        """Tell which points (N, 2) lie in the picture, clear of its border."""
        height, width = self.size_hw
        inside = (points_px > 2) & (points_px < np.array([width - 3, height - 3]))
        return np.asarray(inside.all(axis=1))

    def sample(self, points_px: FloatArray, level: IntArray) -> Plane:
        """Sample points (N, ..., 2) of the picture, each row on its own level (N,)."""
        out = np.empty(points_px.shape[:-1], np.float32)
        for one in np.unique(level).tolist():
            chosen = level == one
            out[chosen] = self.sample_level(points_px[chosen], one)
        return out

    def sample_level(self, points_px: FloatArray, level: int) -> Plane:
        """Sample points (..., 2) of the picture on one level."""
        at = ((points_px + 0.5) / self.reduction - 0.5) / 2**level
        rows = at.astype(np.float32).reshape(-1, 1, 2)
        out = np.empty(len(rows), np.float32)
        for start in range(0, len(rows), _REMAP_ROWS):
            part = slice(start, start + _REMAP_ROWS)
            out[part] = cv2.remap(
                self.planes[level],
                rows[part],
                None,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )[:, 0]
        return out.reshape(points_px.shape[:-1])

    def from_level(self, points: FloatArray, level: int) -> FloatArray:
        """Convert points (N, 2) of a level to pixels of the picture."""
        return np.asarray((points * 2**level + 0.5) * self.reduction - 0.5)


def build_pyramid(grey: Plane) -> Pyramid:
    """Reduce and blur a grey picture (H, W)."""
    height, width = grey.shape
    reduction = int(np.ceil(np.sqrt(height * width / _SEARCH_PIXELS)))
    reduction = min(reduction, height, width)
    reduced = grey
    if reduction > 1:
        size_wh = width // reduction, height // reduction
        whole = grey[: size_wh[1] * reduction, : size_wh[0] * reduction]
        reduced = cv2.resize(whole, size_wh, interpolation=cv2.INTER_AREA)
    planes = [cv2.GaussianBlur(reduced, _KERNEL, _BLUR_PX)]
    while len(planes) < _N_LEVELS and min(planes[-1].shape) >= 2 * _SMALLEST_SIDE_PX:
        half = np.ascontiguousarray(planes[-1][::2, ::2])
        planes.append(cv2.GaussianBlur(half, _KERNEL, _BLUR_PX))
    return Pyramid(tuple(planes), reduction, estimate_noise(reduced), (height, width))


def estimate_noise(grey: Plane) -> float:
    """Return the standard deviation of the noise of a picture (H, W); 0 under 3x3 pixels.

    References
    ----------
    .. [1] J. Immerkaer, "Fast Noise Variance Estimation", Computer Vision and Image Understanding
       64 (2), 1996 (the kernel; a quantile here, the mean there).
    """
    if min(grey.shape) < 3:
        return 0.0
    rows = grey[: grey.shape[0] // 3 * 3].reshape(-1, 3, grey.shape[1])[::5]
    across = rows[:, :, :-2] - 2 * rows[:, :, 1:-1] + rows[:, :, 2:]
    laplacian = np.abs(across[:, 0] - 2 * across[:, 1] + across[:, 2])[:, ::3]
    return float(np.quantile(laplacian, _USED_SHARE)) / (_LAPLACIANS_PER_SIGMA * _NORMAL_QUANTILE)

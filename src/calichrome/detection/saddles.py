"""Points where four squares may meet: saddles of brightness, found over scales."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["Pyramid", "Saddles", "build_pyramid", "estimate_noise", "find_saddles"]

Plane = NDArray[np.float32]

_SEARCH_PIXELS = 4_000_000
"""Larger pictures are searched at 1/2, 1/3, ... of their size."""

_N_LEVELS = 4
_BLUR_PX = 1.0

_MAXIMA_OF_NOISE = (1.9, 0.75, 0.36, 0.20)
"""Strength that one in a thousand maxima of noise of 1 DN exceeds, by level."""

_LEAST_STRENGTH = 1.2
_MOST_PER_LEVEL = 3000

_RING_PX = 3.0
_N_RAYS = 16
_MOST_ODD = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Saddles:
    points_px: FloatArray
    angles_rad: FloatArray
    contrast: FloatArray
    level: IntArray
    noise: float

    def __len__(self) -> int:
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    planes: tuple[Plane, ...]
    reduction: int
    noise: float
    size_hw: tuple[int, int]

    def sample(self, points_px: FloatArray, level: IntArray | int) -> Plane:
        """Sample points (N, ..., 2), each row on its own level (N,)."""
        if isinstance(level, int):
            return self.sample_level(points_px, level)
        out = np.empty(points_px.shape[:-1], np.float32)
        for one in np.unique(level).tolist():
            chosen = level == one
            out[chosen] = self.sample_level(points_px[chosen], one)
        return out

    def sample_level(self, points_px: FloatArray, level: int) -> Plane:
        flat = self.to_level(points_px, level).astype(np.float32).reshape(-1, 1, 2)
        out = np.empty(len(flat), np.float32)
        # remap takes at most 32767 rows
        for start in range(0, len(flat), 30000):
            part = flat[start : start + 30000]
            out[start : start + 30000] = cv2.remap(
                self.planes[level], part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[:, 0]
        return out.reshape(points_px.shape[:-1])

    def to_level(self, points_px: FloatArray, level: int) -> FloatArray:
        return ((points_px + 0.5) / self.reduction - 0.5) / 2**level

    def from_level(self, points: FloatArray, level: int) -> FloatArray:
        return (points * 2**level + 0.5) * self.reduction - 0.5


def build_pyramid(grey: Plane) -> Pyramid:
    height, width = grey.shape
    reduction = int(np.ceil(np.sqrt(height * width / _SEARCH_PIXELS)))
    reduced = grey
    if reduction > 1:
        whole = grey[: height // reduction * reduction, : width // reduction * reduction]
        size_wh = width // reduction, height // reduction
        reduced = cv2.resize(whole, size_wh, interpolation=cv2.INTER_AREA)
    planes = [cv2.GaussianBlur(reduced, (5, 5), _BLUR_PX)]
    while len(planes) < _N_LEVELS and min(planes[-1].shape) > 40:
        planes.append(
            cv2.GaussianBlur(np.ascontiguousarray(planes[-1][::2, ::2]), (5, 5), _BLUR_PX)
        )
    return Pyramid(tuple(planes), reduction, estimate_noise(reduced), (height, width))


def estimate_noise(grey: Plane) -> float:
    rows = grey[: grey.shape[0] // 3 * 3].reshape(-1, 3, grey.shape[1])[::5]
    a = rows[:, :, :-2] - 2 * rows[:, :, 1:-1] + rows[:, :, 2:]
    second = np.abs(a[:, 0] - 2 * a[:, 1] + a[:, 2])[:, ::3]
    return float(np.quantile(second, 0.3)) / (6 * 0.3853)


def find_saddles(grey: Plane, pyramid: Pyramid | None = None) -> Saddles:
    pyramid = pyramid or build_pyramid(grey)
    found = [_saddles_of_level(pyramid, level) for level in range(len(pyramid.planes))]
    points, angles, contrast, level = (np.concatenate(part) for part in zip(*found, strict=True))
    keep = _one_per_place(points, angles, contrast, level, pyramid)
    return Saddles(points[keep], angles[keep], contrast[keep], level[keep], pyramid.noise)


def _saddles_of_level(pyramid, level):
    plane = pyramid.planes[level]
    least = max(_LEAST_STRENGTH, pyramid.noise * _MAXIMA_OF_NOISE[level]) ** 2
    x, y, measure, curvature = _maxima(plane, least)
    if len(x) > _MOST_PER_LEVEL:
        best = np.argpartition(-measure, _MOST_PER_LEVEL)[:_MOST_PER_LEVEL]
        x, y, measure, curvature = x[best], y[best], measure[best], curvature[:, best]
    # Newton step to the stationary point
    gx = (plane[y, x + 1] - plane[y, x - 1]) / 2
    gy = (plane[y + 1, x] - plane[y - 1, x]) / 2
    (xx, xy, yy), det = curvature / _SOBEL, -measure / _SOBEL**2
    step = np.stack([(xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det], axis=1)
    ok = np.abs(step).max(axis=1, initial=0) < 1.5
    centre = np.stack([x, y], axis=1)[ok] + step[ok].astype(np.float64)
    points = pyramid.from_level(centre, level)
    angles, contrast, ok = _ring_test(pyramid, points, level)
    return points[ok], angles[ok], contrast[ok], np.full(ok.sum(), level)


def _maxima(plane, least):
    """Find maxima of xy^2 - xx yy above `least`, in strips that stay in the processor's cache."""
    height, width = plane.shape
    found = []
    for top in range(_EDGE, height - _EDGE, _STRIP):
        rows = min(_STRIP, height - _EDGE - top)
        strip = plane[top - _EDGE : top + rows + _EDGE]
        xx, xy, yy = (
            cv2.Sobel(strip, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (1, 1), (0, 2))
        )
        measure = xy * xy
        measure -= xx * yy
        peaks = measure == cv2.dilate(measure, _AROUND)
        peaks &= measure > least
        peaks[:_EDGE] = peaks[-_EDGE:] = False
        peaks[:, :_EDGE] = peaks[:, -_EDGE:] = False
        at = np.unravel_index(np.flatnonzero(peaks), peaks.shape)  # 8 times as fast as nonzero
        curvature = np.stack([xx[at], xy[at], yy[at]])
        found.append((at[1], at[0] + (top - _EDGE), measure[at], curvature))
    return [np.concatenate(part, axis=-1) for part in zip(*found, strict=True)]


_SOBEL = 4.0  # its kernels give 4 times the second derivatives
_EDGE = 4
_STRIP = 128
_AROUND = np.ones((5, 5), np.uint8)

_RAYS = np.arange(2 * _N_RAYS) * (np.pi / _N_RAYS)
_RING = np.stack([np.cos(_RAYS), np.sin(_RAYS)], axis=1)


def _ring_test(pyramid, points, level):
    radius = _RING_PX * 2**level * pyramid.reduction
    values = pyramid.sample_level(points[:, None] + radius * _RING, level)
    centre = pyramid.sample_level(points, level)
    first, second = values[:, :_N_RAYS], values[:, _N_RAYS:]
    even = (first + second) / 2 - centre[:, None]
    odd = (first - second) / 2
    following = np.concatenate([even[:, 1:], even[:, :1]], axis=1)
    rises = (even <= 0) & (following > 0)
    falls = (even > 0) & (following <= 0)
    ok = (rises.sum(axis=1) == 1) & (falls.sum(axis=1) == 1)
    high, low = even.max(axis=1), -even.min(axis=1)
    contrast = np.minimum(high, low)
    # noise after the blur of a level: 0.29 0.13 0.064 0.032
    floor = np.maximum(0.6, 3 * pyramid.noise * 0.29 / 2.1**level / np.sqrt(2))
    ok &= (contrast > floor) & (contrast > 0.15 * np.maximum(high, low))
    ok &= (odd**2).sum(axis=1) < _MOST_ODD**2 * (even**2).sum(axis=1)
    angles = np.stack(
        [_crossing(even, following, rises), _crossing(even, following, falls)], axis=1
    )
    angles[:, 1] = angles[:, 0] + np.mod(angles[:, 1] - angles[:, 0], np.pi)
    opening = angles[:, 1] - angles[:, 0]
    ok &= (opening > 0.3) & (opening < np.pi - 0.3)
    return angles, (high + low) / 2, ok


def _crossing(even, following, where):
    ray = where.argmax(axis=1)
    row = np.arange(len(even))
    here, there = even[row, ray], following[row, ray]
    share = here / np.where(here == there, 1, here - there)
    return (ray + share) * (np.pi / _N_RAYS)


def _one_per_place(points, angles, contrast, level, pyramid):
    """Of saddles at one place keep the finest that has half of the contrast of the others."""
    from scipy.spatial import cKDTree

    keep = np.ones(len(points), bool)
    if len(points) == 0:
        return keep
    tree = cKDTree(points)
    for coarse in range(len(pyramid.planes) - 1, 0, -1):
        those = np.flatnonzero((level == coarse) & keep)
        reach = 2.5 * 2**coarse * pyramid.reduction
        finer = np.flatnonzero(level < coarse)
        if len(those) == 0 or len(finer) == 0:
            continue
        pairs = cKDTree(points[finer]).sparse_distance_matrix(
            cKDTree(points[those]), reach, output_type="ndarray"
        )
        fine, big = finer[pairs["i"]], those[pairs["j"]]
        turn = angles[fine] - angles[big]
        same = (np.abs(np.sin(turn)) < 0.5).all(axis=1)
        same &= np.cos(turn[:, 0]) * np.cos(turn[:, 1]) > 0
        weaker = contrast[fine] < 0.5 * contrast[big]
        keep[fine[weaker]] = False
        keep[big[same & ~weaker]] = False
    return keep

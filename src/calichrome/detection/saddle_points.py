"""Points where four squares may meet: saddles of brightness, found over scales."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pyramid import Plane, Pyramid

__all__ = ["Saddles", "find_saddles"]

_MAXIMA_OF_NOISE = (1.9, 0.75, 0.36, 0.20)
"""What one in a thousand maxima of the saddle measure's root exceeds in white noise of 1 DN, by
level (measured: 1.86, 0.71, 0.32, 0.16 on 4 MP). A sharp right-angled corner whose squares differ
by 2 DN measures 1.75."""
_LEAST_STRENGTH = 1.2  # where there is no noise
_MOST_PER_LEVEL = 3000  # the strongest; bounds the time that textures take
_LARGEST_STEP_PX = 1.5  # of the level, from the strongest pixel to the saddle
_SOBEL = 4.0  # its kernels give 4 times the second derivatives
_EDGE = 4  # px of a plane that the ring needs
_STRIP = 96
"""Rows at a time: 18 ms per MP for whole pictures, 11 in strips of 64 to 160, which stay in the
processor's cache."""
_AROUND = np.ones((5, 5), np.uint8)

_RING_PX = 3.0
"""Radius of the ring in pixels of the level: 2 sigma of its blur, clear of the neighbours of
squares of 6 px."""
_N_RAYS = 16  # on half of the ring
_RAYS = np.arange(2 * _N_RAYS) * (np.pi / _N_RAYS)
_RING = np.stack([np.cos(_RAYS), np.sin(_RAYS)], axis=1)
_MOST_ODD = 0.6
"""What differs between opposite points over what they share, RMS; on corners it is the gradient of
the light, on ends of lines and in textures most."""
_LEAST_CONTRAST = 0.6  # DN
_NOISE_ON_RING = (0.29, 0.13, 0.064, 0.032)  # of white noise of 1 DN after the blur of a level
_SIGMAS = 3 / np.sqrt(2)  # of the mean of two opposite points
_LEAST_BALANCE = 0.15
"""Of the stronger of bright and dark: acute sectors are blurred, at 30 degrees to a fifth."""
_LEAST_OPENING = 0.3  # rad
_SAME_PLACE = 2.5  # px of the coarser level
_SAME_TURN = 0.5  # sine of the angle between edges of the same corner on two levels
_FINER_SHARE = 0.5  # of the contrast, for a finer level to be preferred


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Saddles:
    """Candidates for corners.

    Parameters
    ----------
    points_px : (N, 2) float
        0.06 px off in the median for squares of 11 px in noise of 5 DN.
    angles_rad : (N, 2) float
        Directions of the two edges; the sectors from the first on to the second, and opposite, are
        bright. Blur draws them apart where they are acute: 44 degrees look like 80.
    contrast : (N,) float
        Half a step from black to white, 0..255.
    level : (N,) int
        Of the pyramid.
    """

    points_px: FloatArray
    angles_rad: FloatArray
    contrast: FloatArray
    level: IntArray

    def __len__(self) -> int:
        return len(self.points_px)

    def only(self, chosen: BoolArray) -> "Saddles":
        """Return the chosen ones."""
        return Saddles(
            points_px=self.points_px[chosen],
            angles_rad=self.angles_rad[chosen],
            contrast=self.contrast[chosen],
            level=self.level[chosen],
        )


def find_saddles(pyramid: Pyramid) -> Saddles:
    """Find points around which brightness rises twice and falls twice.

    Maxima of the negative determinant of second derivatives, moved to where the first derivatives
    vanish, and kept if a ring of 3 px around them has two bright and two dark sectors.
    """
    found = [_saddles_of_level(pyramid, level) for level in range(len(pyramid.planes))]
    saddles = Saddles(
        points_px=np.concatenate([part.points_px for part in found]),
        angles_rad=np.concatenate([part.angles_rad for part in found]),
        contrast=np.concatenate([part.contrast for part in found]),
        level=np.concatenate([part.level for part in found]),
    )
    return saddles.only(_one_per_place(saddles, pyramid))


def _saddles_of_level(pyramid: Pyramid, level: int) -> Saddles:
    plane = pyramid.planes[level]
    least = max(_LEAST_STRENGTH, pyramid.noise * _MAXIMA_OF_NOISE[level]) ** 2
    x, y, strength, second = _maxima(plane, least)
    if len(x) > _MOST_PER_LEVEL:
        best = np.argpartition(-strength, _MOST_PER_LEVEL)[:_MOST_PER_LEVEL]
        x, y, strength, second = x[best], y[best], strength[best], second[:, best]
    slope_x = (plane[y, x + 1] - plane[y, x - 1]) / 2
    slope_y = (plane[y + 1, x] - plane[y - 1, x]) / 2
    (xx, xy, yy), determinant = second / _SOBEL, -strength / _SOBEL**2
    newton = np.stack([xy * slope_y - yy * slope_x, xy * slope_x - xx * slope_y], axis=1)
    newton = newton.astype(np.float64) / determinant[:, None]
    near = (np.abs(newton) < _LARGEST_STEP_PX).all(axis=1)
    points = pyramid.from_level(np.stack([x, y], axis=1)[near] + newton[near], level)
    return _with_four_sectors(points, pyramid, level)


def _maxima(plane: Plane, least: float) -> tuple[IntArray, IntArray, Plane, Plane]:
    """Find maxima of xy^2 - xx yy above `least`.

    Returns columns, rows, values (M,), and xx, xy, yy (3, M) there.
    """
    height = len(plane)
    columns, rows, values, seconds = [], [], [], []
    for top in range(_EDGE, height - _EDGE, _STRIP):
        strip = plane[top - _EDGE : min(top + _STRIP, height - _EDGE) + _EDGE]
        xx, xy, yy = (
            cv2.Sobel(strip, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (1, 1), (0, 2))
        )
        strength = xy * xy
        strength -= xx * yy
        peaks = strength == cv2.dilate(strength, _AROUND)
        peaks &= strength > least
        peaks[:_EDGE] = peaks[-_EDGE:] = False
        peaks[:, :_EDGE] = peaks[:, -_EDGE:] = False
        at = np.unravel_index(np.flatnonzero(peaks), peaks.shape)  # 8 times as fast as nonzero
        columns.append(at[1])
        rows.append(at[0] + (top - _EDGE))
        values.append(strength[at])
        seconds.append(np.stack([xx[at], xy[at], yy[at]]))
    if not values:
        empty = np.empty(0, dtype=np.int64)
        return empty, empty, np.empty(0, np.float32), np.empty((3, 0), np.float32)
    return (
        np.concatenate(columns),
        np.concatenate(rows),
        np.concatenate(values),
        np.concatenate(seconds, axis=1),
    )


def _with_four_sectors(points: FloatArray, pyramid: Pyramid, level: int) -> Saddles:
    """Keep points around which the even part of a ring rises once and falls once in half a turn."""
    radius = _RING_PX * 2**level * pyramid.reduction
    values = pyramid.sample(points[:, None] + radius * _RING, level).astype(np.float64)
    centre = pyramid.sample(points, level).astype(np.float64)
    first, second = values[:, :_N_RAYS], values[:, _N_RAYS:]
    even, odd = (first + second) / 2 - centre[:, None], (first - second) / 2
    following = np.concatenate([even[:, 1:], even[:, :1]], axis=1)
    rises, falls = (even <= 0) & (following > 0), (even > 0) & (following <= 0)
    high, low = even.max(axis=1), -even.min(axis=1)
    floor = max(_LEAST_CONTRAST, _SIGMAS * pyramid.noise * _NOISE_ON_RING[level])
    keep = (rises.sum(axis=1) == 1) & (falls.sum(axis=1) == 1)
    keep &= np.minimum(high, low) > np.maximum(floor, _LEAST_BALANCE * np.maximum(high, low))
    keep &= (odd**2).sum(axis=1) < _MOST_ODD**2 * (even**2).sum(axis=1)
    opens, closes = _crossing(even, following, rises), _crossing(even, following, falls)
    opening = np.mod(closes - opens, np.pi)
    keep &= (opening > _LEAST_OPENING) & (opening < np.pi - _LEAST_OPENING)
    return Saddles(
        points_px=points,
        angles_rad=np.stack([opens, opens + opening], axis=1),
        contrast=(high + low) / 2,
        level=np.full(len(points), level),
    ).only(keep)


def _crossing(even: FloatArray, following: FloatArray, where: BoolArray) -> FloatArray:
    """Return the angle (N,) at which the ring crosses its centre's value."""
    ray, row = where.argmax(axis=1), np.arange(len(even))
    here, there = even[row, ray], following[row, ray]
    share = here / np.where(here == there, 1, here - there)
    return np.asarray((ray + share) * (np.pi / _N_RAYS))


def _one_per_place(saddles: Saddles, pyramid: Pyramid) -> BoolArray:
    """Of saddles at one place keep the finest that has its share of the contrast."""
    points, angles, contrast, level = (
        saddles.points_px,
        saddles.angles_rad,
        saddles.contrast,
        saddles.level,
    )
    keep = np.ones(len(points), dtype=bool)
    for coarse in range(len(pyramid.planes) - 1, 0, -1):
        those = np.flatnonzero((level == coarse) & keep)
        finer = np.flatnonzero(level < coarse)
        if not len(those) or not len(finer):
            continue
        pairs = cKDTree(points[finer]).sparse_distance_matrix(
            cKDTree(points[those]),
            _SAME_PLACE * 2**coarse * pyramid.reduction,
            output_type="ndarray",
        )
        fine, big = finer[pairs["i"]], those[pairs["j"]]
        turn = angles[fine] - angles[big]
        same = (np.abs(np.sin(turn)) < _SAME_TURN).all(axis=1)
        same &= np.cos(turn[:, 0]) * np.cos(turn[:, 1]) > 0
        weaker = contrast[fine] < _FINER_SHARE * contrast[big]
        keep[fine[weaker]] = False
        keep[big[same & ~weaker]] = False
    return keep

"""Points where four squares may meet: saddles of brightness, found over scales."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pyramid import Plane, Pyramid, build_pyramid

__all__ = ["Saddles", "find_saddles", "go_to_saddles"]

_MAXIMA_OF_NOISE = (1.9, 0.75, 0.36, 0.20)
"""What one in a thousand maxima of the saddle measure's root exceeds in white noise of 1 DN, by
level (48,000 maxima on level 0). A sharp right-angled corner whose squares differ by 2 DN measures
1.75."""

_LEAST_STRENGTH = 1.2  # DN, where there is no noise
_MOST_PER_LEVEL = 3000  # bounds the time that textures take

_SOBEL = 4.0  # its kernels give 4 times the second derivatives
_STRIP = 96
"""Rows at a time: 18 ms per MP for whole pictures, 11 in strips of 64 to 160, which stay in the
processor's cache."""
_NEIGHBOURHOOD = np.ones((5, 5), np.uint8)

_RING_PX = 3.0
"""Radius of the ring in pixels of the level: 2 sigma of its blur, clear of the neighbours of
squares of 6 px."""
_EDGE = 4  # px: the ring lies in the picture
_N_RAYS = 16  # of half a turn
_LEAST_EVEN = 0.6  # DN
_NOISE_ON_RING = (0.29, 0.13, 0.064, 0.032)  # of white noise of 1 DN after the blur of a level
_SIGMAS = 3 / np.sqrt(2)  # of the mean of two opposite points
_LEAST_BALANCE = 0.15
"""Of the stronger of bright and dark: acute sectors are blurred, at 30 deg to a fifth."""
_MOST_ODD = 0.6
"""RMS of what differs between opposite points over what they share; on corners it is the gradient
of the light, on ends of lines and in textures most."""
_LEAST_OPENING_RAD = 0.3
_LONGEST_STEP = 1.5  # px of the level, from the strongest pixel to the saddle

_FINAL_STEPS = 2
_STENCIL = np.stack(np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1]), axis=-1).reshape(-1, 2)
_TWIN = 0.7  # px of the level: pixels of one strength lead to one saddle

_SAME_PLACE = 2.5  # px of the coarser level
_SAME_TURN = 0.5  # sine of the angle between edges of the same corner on two levels
_FINER_SHARE = 0.5  # of the contrast, for a finer level to be preferred


@dataclass(frozen=True, slots=True, eq=False)
class Saddles:
    """Candidate corners.

    Parameters
    ----------
    points_px : (N, 2) float
        0.06 px off in the median for squares of 11 px in noise of 5 DN.
    angles_rad : (N, 2) float
        Directions of the two edges, growing from x to y; the sector from the first to the second is
        bright, and they are less than half a turn apart. Blur draws them apart where they are
        acute: 44 deg look like 80.
    contrast : (N,) float
        Half the step from dark to bright on the ring, DN: of a sharp corner 0.84 of it.
    level : (N,) int
        Of the pyramid, where the saddle was found.
    pyramid
        Of the picture.
    """

    points_px: FloatArray
    angles_rad: FloatArray
    contrast: FloatArray
    level: IntArray
    pyramid: Pyramid

    def __len__(self) -> int:
        return len(self.points_px)

    def where(self, chosen: BoolArray) -> "Saddles":
        """Return those that are chosen (N,)."""
        return Saddles(
            self.points_px[chosen],
            self.angles_rad[chosen],
            self.contrast[chosen],
            self.level[chosen],
            self.pyramid,
        )


def find_saddles(grey: Plane) -> Saddles:
    """Find saddle points whose surroundings look like four squares.

    Parameters
    ----------
    grey : (H, W) float32, 0..255
        Tones as the eye sees them: in linear ones dark boards would hardly show.

    Notes
    -----
    The measure is xy^2 - xx yy of the second derivatives, the negative of Beaudet's DET [1]_. A
    ring around each maximum must be bright and dark twice in turn, and equal at opposite points.

    References
    ----------
    .. [1] P. R. Beaudet, "Rotationally Invariant Image Operators", Proc. 4th Int. Joint Conf. on
       Pattern Recognition, 1978.
    """
    pyramid = build_pyramid(grey)
    levels = [_saddles_of_level(pyramid, level) for level in range(len(pyramid.planes))]
    every = Saddles(
        np.concatenate([part.points_px for part in levels]),
        np.concatenate([part.angles_rad for part in levels]),
        np.concatenate([part.contrast for part in levels]),
        np.concatenate([part.level for part in levels]),
        pyramid,
    )
    apart = every.where(_one_per_place(every))
    better = go_to_saddles(pyramid, apart.points_px, apart.level, _FINAL_STEPS)
    moved = replace(apart, points_px=better)
    return moved.where(_first_at_place(moved))


def _saddles_of_level(pyramid: Pyramid, level: int) -> Saddles:
    plane = pyramid.planes[level]
    least = max(_LEAST_STRENGTH, pyramid.noise * _MAXIMA_OF_NOISE[level]) ** 2
    x, y, measure, curvature = _maxima(plane, least)
    if len(x) > _MOST_PER_LEVEL:
        best = np.argpartition(-measure, _MOST_PER_LEVEL)[:_MOST_PER_LEVEL]
        x, y, measure, curvature = x[best], y[best], measure[best], curvature[:, best]
    # Newton's step to the stationary point
    gx = (plane[y, x + 1] - plane[y, x - 1]) / 2
    gy = (plane[y + 1, x] - plane[y - 1, x]) / 2
    (xx, xy, yy), det = curvature / _SOBEL, -measure / _SOBEL**2
    step = np.stack([(xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det], axis=1)
    near = np.abs(step).max(axis=1) < _LONGEST_STEP
    centre = np.stack([x, y], axis=1)[near] + step[near].astype(np.float64)
    return _with_four_sectors(pyramid, pyramid.from_level(centre, level), level)


def _maxima(plane: Plane, least: float) -> tuple[IntArray, IntArray, Plane, Plane]:
    """Return x, y (N,), the measure (N,) and xx, xy, yy (3, N) where it peaks above `least`."""
    height, width = plane.shape
    nothing = np.empty(0, np.int64)
    found = [(nothing, nothing, np.empty(0, np.float32), np.empty((3, 0), np.float32))]
    for top in range(0, height - 2 * _EDGE, _STRIP):
        strip = plane[top : top + _STRIP + 2 * _EDGE]
        xx, xy, yy = (
            cv2.Sobel(strip, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (1, 1), (0, 2))
        )
        measure = xy * xy
        measure -= xx * yy
        peaks = measure == cv2.dilate(measure, _NEIGHBOURHOOD)
        peaks &= measure > least
        peaks[:_EDGE] = peaks[-_EDGE:] = False
        peaks[:, :_EDGE] = peaks[:, -_EDGE:] = False
        # On two axes, np.nonzero takes 8 times as long
        y, x = np.divmod(np.flatnonzero(peaks), width)
        found.append((x, y + top, measure[y, x], np.stack([xx[y, x], xy[y, x], yy[y, x]])))
    x, y, strength, curvature = (np.concatenate(part, axis=-1) for part in zip(*found, strict=True))
    return x, y, strength, curvature


def _with_four_sectors(pyramid: Pyramid, points: FloatArray, level: int) -> Saddles:
    """Keep points whose ring has four sectors, bright and dark in turn, and opposite ones alike."""
    turn = np.arange(2 * _N_RAYS) * (np.pi / _N_RAYS)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    radius = _RING_PX * 2**level * pyramid.reduction
    values = pyramid.sample_level(points[:, None] + radius * ring, level)
    first, second = values[:, :_N_RAYS], values[:, _N_RAYS:]
    even = (first + second) / 2 - pyramid.sample_level(points, level)[:, None]
    odd = (first - second) / 2
    following = np.concatenate([even[:, 1:], even[:, :1]], axis=1)
    rises, falls = (even <= 0) & (following > 0), (even > 0) & (following <= 0)
    good = (rises.sum(axis=1) == 1) & (falls.sum(axis=1) == 1)
    high, low = even.max(axis=1), -even.min(axis=1)
    least = max(_LEAST_EVEN, _SIGMAS * pyramid.noise * _NOISE_ON_RING[level])
    good &= np.minimum(high, low) > np.maximum(least, _LEAST_BALANCE * np.maximum(high, low))
    good &= (odd**2).sum(axis=1) < _MOST_ODD**2 * (even**2).sum(axis=1)
    angles = np.stack([_crossing(even, following, at) for at in (rises, falls)], axis=1)
    opening = np.mod(angles[:, 1] - angles[:, 0], np.pi)
    angles[:, 1] = angles[:, 0] + opening
    good &= np.minimum(opening, np.pi - opening) > _LEAST_OPENING_RAD
    contrast = ((high + low) / 2).astype(np.float64)
    found = Saddles(points, angles, contrast, np.full(len(points), level), pyramid)
    return found.where(good)


def _crossing(
    even: NDArray[np.floating], following: NDArray[np.floating], where: BoolArray
) -> FloatArray:
    """Return the angle (N,) at which rings (N, rays) change sign."""
    ray = where.argmax(axis=1)
    row = np.arange(len(even))
    here, there = even[row, ray], following[row, ray]
    share = here / np.where(here == there, 1, here - there)
    return np.asarray((ray + share) * (np.pi / _N_RAYS))


def _one_per_place(saddles: Saddles) -> BoolArray:
    """Of saddles at one place keep the finest with half the contrast of the coarser ones."""
    points, angles, contrast = saddles.points_px, saddles.angles_rad, saddles.contrast
    keep = np.ones(len(saddles), dtype=bool)
    for coarse in range(len(saddles.pyramid.planes) - 1, 0, -1):
        those = np.flatnonzero((saddles.level == coarse) & keep)
        finer = np.flatnonzero((saddles.level < coarse) & keep)
        if len(those) == 0 or len(finer) == 0:
            continue
        reach = _SAME_PLACE * 2**coarse * saddles.pyramid.reduction
        pairs = cKDTree(points[finer]).sparse_distance_matrix(
            cKDTree(points[those]), reach, output_type="ndarray"
        )
        fine, wide = finer[pairs["i"]], those[pairs["j"]]
        turn = angles[fine] - angles[wide]
        same = (np.abs(np.sin(turn)) < _SAME_TURN).all(axis=1)
        same &= np.cos(turn[:, 0]) * np.cos(turn[:, 1]) > 0
        weaker = contrast[fine] < _FINER_SHARE * contrast[wide]
        keep[fine[weaker]] = False
        keep[wide[same & ~weaker]] = False
    return keep


def _first_at_place(saddles: Saddles) -> BoolArray:
    """Tell which saddles are not where an earlier one of the level is."""
    keep = np.ones(len(saddles), dtype=bool)
    for level in np.unique(saddles.level).tolist():
        members = np.flatnonzero(saddles.level == level)
        reach = _TWIN * 2**level * saddles.pyramid.reduction
        pairs = cKDTree(saddles.points_px[members]).query_pairs(reach, output_type="ndarray")
        keep[members[pairs.max(axis=1, initial=0)[: len(pairs)]]] = False
    return keep


def go_to_saddles(
    pyramid: Pyramid, points_px: FloatArray, level: IntArray, n_steps: int
) -> FloatArray:
    """Go from points (N, 2) to the saddles next to them, by Newton's method on planes (N,)."""
    x, y = _STENCIL.T
    design = np.stack([x, y, x * x / 2, x * y, y * y / 2, np.ones_like(x)], axis=1)
    derivatives = np.linalg.pinv(design)[:5].T
    pitch = pyramid.pitch(level)[:, None]
    points = points_px.copy()
    for _ in range(n_steps):
        values = pyramid.sample(points[:, None] + pitch[:, None] * _STENCIL, level)
        gx, gy, xx, xy, yy = (values @ derivatives).T
        det = np.minimum(xx * yy - xy * xy, -1e-6)  # a saddle's is negative
        step = np.stack([(xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det], axis=1)
        points += np.clip(step, -1, 1) * pitch
    return points

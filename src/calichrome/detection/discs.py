"""Colours of the discs and of the squares around them.

The paper's way: disc centre from the square's corners, a 3x3 median as seed, region growing; then
only the core of the region counts, away from the blurred rim and without highlights.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pixels import NEARLY_FULL, linear_light
from calichrome.detection.square_levels import (
    SquareLevels,
    levels_at_discs,
    measure_squares,
    sample_points,
)
from calichrome.imaging import Image, Pixels
from calichrome.observations import DiscSamples
from calichrome.target import Target

__all__ = ["BoardToPixels", "measure_discs"]

BoardToPixels = Callable[[FloatArray], FloatArray]
"""Board points (N, 3) in metres to pixels (N, 2)."""

_EDGE_PX = 3.0
"""Pixels beside an edge whose colour the edge changes: 2 px that 5x5 demosaicing reaches (Malvar
et al., 2004) and 1 px of blur. On simulated boards with mosaic (seed 0 of the demo) the colour
error of a 3x3 fell from 2.46 dE2000 at 1.5 px to 1.11 at 3 px (discs of less than 4 px radius left
out there), without mosaic it stayed at 2.3."""
_EDGE_OF_DISC = (
    0.5  # at most this share of a disc's radius is given to its edge, so that some stays
)

_MIN_REGION_PX = 9  # the seed itself: fewer pixels are no region
_LEAST_FILLED = 0.4
"""Share of a disc's core that its region must fill: less is what a hand or a highlight leaves, and
then it is open which of the two the middle shows."""

_NOISE_SAMPLES = 80  # pixels of a disc that tell its noise, to a tenth
_TOLERANCE_SIGMAS = 5.0  # of noise, by which pixels of a region differ from the seed
_SHADING = 0.05  # of the seed's brightest channel, by which light may change across a disc
_OUTLIER = 4.0  # robust sigmas of a pixel from the median of its region: a highlight, dust
_CHUNK = 8  # discs of like size that are handled together: patches are padded to the largest

_RIM = np.arange(8) * (np.pi / 4)
_COMPASS = np.stack([np.cos(_RIM), np.sin(_RIM), np.zeros(8)], axis=1)

_BLOCK_PX = 4
"""Side of the blocks whose means tell how far neighbouring pixels repeat each other: twice the
period of a Bayer mosaic, and half of JPEG's blocks."""
_FEWEST_BLOCKS = 30  # their variance is then known to a quarter
_UNKNOWN_REPETITION = 4.0
"""Pixels that repeat one measurement where it cannot be told: a mosaic measures red and blue once
in four pixels."""


def measure_discs(
    image: Image,
    target: Target,
    to_pixels: BoardToPixels,
    corner_ids: IntArray | None = None,
) -> DiscSamples:
    """Measure every disc that the picture shows.

    Parameters
    ----------
    image
        A colour picture.
    target
        The board.
    to_pixels
        Where board points are in the picture: by a `BoardMap`, or by pose and lens once known.
    corner_ids : (N,) int, optional
        Inner corners that were found; without them the whole board is taken to be in view. Squares
        that lack corners although these should be in the picture are taken to be hidden.

    Returns
    -------
    DiscSamples
        Discs outside the picture, hidden, or too small for a region are absent.

    Notes
    -----
    ``cov_rgb / n_px`` is the covariance of the mean. Demosaicing and compression make neighbouring
    pixels repeat each other, so `cov_rgb` is the covariance of single pixels about a plane through
    the region (which takes up shading), times the number of pixels that repeat one measurement.
    That number is told by the means of blocks of 4x4 pixels of all discs of the picture, whose
    variance would be 1/16 of a pixel's if pixels were independent.
    """
    n_squares = target.squares[0] * target.squares[1]
    samples = sample_points(target)
    rims = target.marker_centres_board[:, None] + _radii(target)[:, None, None] * _COMPASS
    points = [samples.reshape(-1, 2), rims[..., :2].reshape(-1, 2)]
    points.append(target.marker_centres_board[:, :2])
    flat = np.concatenate(points)
    if corner_ids is not None:
        flat = np.concatenate([flat, target.corners_board[:, :2]])
    mapped = to_pixels(np.concatenate([flat, np.zeros((len(flat), 1))], axis=1))
    ends = np.cumsum([samples.size // 2, rims.size // 3, len(target.markers)])
    samples_px, rims_px, centres_px, corners_px = np.split(mapped, ends)

    visible = np.ones(n_squares, dtype=bool)
    if corner_ids is not None:
        visible = _visible_squares(target, corners_px, image.size_wh, corner_ids)
    levels = measure_squares(image, target, samples_px.reshape(n_squares, -1, 2), visible, _EDGE_PX)
    at = target.marker_squares @ np.array([1, target.squares[0]], dtype=np.int64)
    usable = visible[at] & ~levels.covered.ravel()[at]
    ellipses = _Ellipses.through(rims_px.reshape(-1, 8, 2))
    usable &= ellipses.inside(image.size_wh)
    pixels = _Cores.concatenated(
        [
            _grow_regions(image, ellipses, markers)
            for markers in _chunks(np.flatnonzero(usable), ellipses)
        ]
    )
    return _statistics(target, centres_px, pixels, levels)


def _radii(target: Target) -> FloatArray:
    return np.array([0.5 * marker.diameter_m for marker in target.markers])


def _visible_squares(
    target: Target, corners_px: FloatArray, size_wh: tuple[int, int], corner_ids: IntArray
) -> BoolArray:
    """Find the squares (n_squares,) that hold most of the corners that the picture should show."""
    nx, ny = target.corners_xy
    found = np.zeros(nx * ny, dtype=bool)
    found[corner_ids] = True
    expected = ((corners_px >= 0) & (corners_px <= np.array(size_wh) - 1)).all(axis=1)

    def per_square(corners: BoolArray) -> IntArray:
        padded = np.pad(corners.reshape(ny, nx).astype(np.int64), 1)
        return padded[1:, 1:] + padded[1:, :-1] + padded[:-1, 1:] + padded[:-1, :-1]

    n_found, n_missing = per_square(found), per_square(expected & ~found)
    return np.asarray((n_found > n_missing) & (n_missing <= 1)).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class _Ellipses:
    """Outlines of the discs: centre (M, 2) and two conjugate half axes as columns (M, 2, 2)."""

    centres: FloatArray
    axes: FloatArray

    @classmethod
    def through(cls, rims_px: FloatArray) -> "_Ellipses":
        """Fit outlines to 8 points (M, 8, 2) at equal angles around each disc."""
        waves = np.stack([np.cos(_RIM), np.sin(_RIM)], axis=1) / 4  # least squares
        return cls(rims_px.mean(axis=1), np.swapaxes(rims_px, 1, 2) @ waves)

    @property
    def reach(self) -> IntArray:
        """Half width and height of the box around each, whole pixels, (M, 2)."""
        size = np.sqrt((self.axes**2).sum(axis=2))
        return np.asarray(np.ceil(np.nan_to_num(size)).astype(np.int64) + 1)

    def inside(self, size_wh: tuple[int, int]) -> BoolArray:
        """Whether they lie in the picture with a pixel to spare, (M,)."""
        low, high = self.centres - self.reach, self.centres + self.reach
        within = (low >= 0) & (high <= np.array(size_wh) - 1)
        # A map gone wrong makes discs as large as the picture, or none.
        width = np.linalg.norm(self.axes, axis=1)
        return np.asarray(within.all(axis=1) & np.isfinite(width).all(axis=1))


def _chunks(markers: IntArray, ellipses: _Ellipses) -> Iterator[IntArray]:
    by_size = markers[np.argsort(ellipses.reach[markers].max(axis=1), kind="stable")]
    for start in range(0, len(by_size), _CHUNK):
        yield by_size[start : start + _CHUNK]


@dataclass(frozen=True, slots=True, eq=False)
class _Cores:
    """Pixels of the regions of discs, one row each, disc after disc.

    `marker` (K,), `xy` (K, 2) int, `light` (K, 3) linear, `clipped` (K,).
    """

    marker: IntArray
    xy: IntArray
    light: FloatArray
    clipped: BoolArray

    @classmethod
    def concatenated(cls, parts: list["_Cores"]) -> "_Cores":
        if not parts:
            nothing = np.empty(0, dtype=np.int64)
            return cls(nothing, nothing.reshape(0, 2), np.empty((0, 3)), nothing.astype(bool))
        columns = [[part.marker, part.xy, part.light, part.clipped] for part in parts]
        return cls(*(np.concatenate(column) for column in zip(*columns, strict=True)))

    def where(self, kept: BoolArray | IntArray) -> "_Cores":
        return _Cores(self.marker[kept], self.xy[kept], self.light[kept], self.clipped[kept])


def _grow_regions(image: Image, ellipses: _Ellipses, markers: IntArray) -> _Cores:
    """Grow the region of some discs from their seeds over neighbouring pixels of like colour.

    Regions end before the blurred rim of their ellipse.
    """
    reach = ellipses.reach[markers].max(axis=0)
    middle = np.rint(ellipses.centres[markers]).astype(np.int64)
    columns = middle[:, :1] + np.arange(-reach[0], reach[0] + 1)  # (n, W)
    rows = middle[:, 1:] + np.arange(-reach[1], reach[1] + 1)  # (n, H)
    core = _core_masks(ellipses, markers, columns, rows)
    core &= (core.sum(axis=(1, 2)) >= _MIN_REGION_PX)[:, None, None]
    disc, y, x = np.nonzero(core)
    xy = np.stack([columns[disc, x], rows[disc, y]], axis=1)
    numbers = _numbers(image, xy)
    light = linear_light(image, numbers)

    around = np.array([[dx, dy] for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    seeds = np.median(linear_light(image, _numbers(image, middle[:, None] + around)), axis=1)
    n_core = np.bincount(disc, minlength=len(markers))
    tolerance = _TOLERANCE_SIGMAS * _spread(light, n_core)
    tolerance += _SHADING * seeds.max(axis=1, keepdims=True)
    alike = (np.abs(light - seeds[disc]) <= tolerance[disc]).all(axis=1)

    patches = np.zeros(core.shape, dtype=bool)
    patches[disc, y, x] = alike
    labels, _ = ndimage.label(patches, structure=_WITHIN_PATCH)
    seed_labels = labels[:, reach[1], reach[0]]
    kept = (labels[disc, y, x] == seed_labels[disc]) & alike
    n_kept = np.bincount(disc[kept], minlength=len(markers))
    enough = (n_kept >= _MIN_REGION_PX) & (n_kept >= _LEAST_FILLED * n_core)
    clipped = np.asarray((numbers >= NEARLY_FULL * image.full_scale).any(axis=1))
    return _Cores(markers[disc], xy, light, clipped).where(kept & enough[disc])


_WITHIN_PATCH = np.zeros((3, 3, 3), dtype=bool)
_WITHIN_PATCH[1] = [[False, True, False], [True, True, True], [False, True, False]]


def _numbers(image: Image, xy: IntArray) -> Pixels:
    numbers = image.pixels[xy[..., 1], xy[..., 0]]
    return numbers if image.is_colour else np.repeat(numbers[..., None], 3, axis=-1)


def _core_masks(
    ellipses: _Ellipses, markers: IntArray, columns: IntArray, rows: IntArray
) -> BoolArray:
    """Find the pixels (n, H, W) of discs that the edge does not change."""
    axes = ellipses.axes[markers]
    radius_px = np.linalg.svd(axes, compute_uv=False)[:, -1]
    inverse = np.linalg.pinv(axes)
    away_x = columns - ellipses.centres[markers, :1]
    away_y = rows - ellipses.centres[markers, 1:]
    u = inverse[:, 0, 0, None] * away_x, inverse[:, 0, 1, None] * away_y
    v = inverse[:, 1, 0, None] * away_x, inverse[:, 1, 1, None] * away_y
    squared = (u[0][:, None] + u[1][..., None]) ** 2 + (v[0][:, None] + v[1][..., None]) ** 2
    edge = np.minimum(_EDGE_PX / np.maximum(radius_px, 1e-9), _EDGE_OF_DISC)
    return np.asarray(squared <= ((1 - edge) ** 2)[:, None, None])


def _spread(values: FloatArray, counts: IntArray) -> FloatArray:
    """Return the robust sigma of each group, (n, C), of rows (K, C) in groups of `counts`."""
    ends = np.cumsum(counts)
    share = np.linspace(0, 1, _NOISE_SAMPLES, endpoint=False)
    # Groups without rows look at others, or at a row of zeros if there is none.
    at = np.minimum((ends - counts)[:, None] + (share * counts[:, None]).astype(int), len(values))
    some = np.concatenate([values, np.zeros((1, values.shape[1]))])[at]
    away = np.abs(some - np.median(some, axis=1, keepdims=True))
    # 1.4826 turns the median of absolute deviations into the sigma of a normal distribution
    return np.asarray(1.4826 * np.median(away, axis=1))


def _medians(values: FloatArray, counts: IntArray) -> FloatArray:
    """Return the median of each group, (n, C), of rows (K, C) in groups of `counts` >= 1."""
    medians = np.empty((len(counts), values.shape[1]))
    columns = np.ascontiguousarray(values.T)
    for at, (end, count) in enumerate(zip(np.cumsum(counts), counts, strict=True)):
        middle = [(count - 1) // 2, count // 2]
        medians[at] = np.partition(columns[:, end - count : end], middle)[:, middle].mean(axis=1)
    return medians


def _statistics(
    target: Target, centres_px: FloatArray, pixels: _Cores, levels: SquareLevels
) -> DiscSamples:
    pixels = pixels.where(np.argsort(pixels.marker, kind="stable"))
    markers, index, counts = np.unique(pixels.marker, return_inverse=True, return_counts=True)
    median = _medians(pixels.light, counts)
    # Light may change across a disc; what noise and shading leave is a highlight or dust.
    allowed = _OUTLIER * _spread(pixels.light, counts)
    allowed += _SHADING * median.max(axis=1, keepdims=True)
    typical = np.asarray((np.abs(pixels.light - median[index]) <= allowed[index]).all(axis=1))
    kept, index = pixels.where(typical), index[typical]
    n_px = np.bincount(index, minlength=len(markers))
    n_clipped = np.bincount(index, weights=kept.clipped, minlength=len(markers))
    mean = _sums(kept.light, index, len(markers)) / n_px[:, None]
    residuals = _without_shading(kept, index, mean, centres_px[markers])
    free = np.maximum(n_px - 3, 1)  # a plane takes three
    products = (residuals[:, :, None] * residuals[:, None, :]).reshape(-1, 9)
    cov = (_sums(products, index, len(markers)) / free[:, None]).reshape(-1, 3, 3)
    repetition = np.sqrt(_repetition(kept.xy, residuals, index, n_px))
    return DiscSamples(
        marker_ids=markers.astype(np.int64),
        centres_px=centres_px[markers],
        mean_rgb=mean,
        median_rgb=median,
        cov_rgb=cov * repetition[:, None] * repetition,
        n_px=n_px,
        clipped=n_clipped / n_px,
        white_rgb=levels_at_discs(target, levels, "white")[markers],
        black_rgb=levels_at_discs(target, levels, "black")[markers],
    )


def _sums(values: FloatArray, index: IntArray, count: int) -> FloatArray:
    """Add rows (K, C) by group, (count, C)."""
    columns = [np.bincount(index, weights=column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1)


def _without_shading(
    pixels: _Cores, index: IntArray, mean: FloatArray, centres_px: FloatArray
) -> FloatArray:
    """Subtract from each region the plane through its colours, (K, 3)."""
    place = pixels.xy - centres_px[index]
    count = np.bincount(index, minlength=len(mean))[:, None]
    place = place - (_sums(place, index, len(mean)) / count)[index]
    off = pixels.light - mean[index]
    moments = _sums((place[:, :, None] * place[:, None, :]).reshape(-1, 4), index, len(mean))
    slopes_right = _sums((place[:, :, None] * off[:, None, :]).reshape(-1, 6), index, len(mean))
    slopes = np.linalg.pinv(moments.reshape(-1, 2, 2)) @ slopes_right.reshape(-1, 2, 3)
    return np.asarray(off - (place[:, :, None] * slopes[index]).sum(axis=1))


def _repetition(xy: IntArray, residuals: FloatArray, index: IntArray, n_px: IntArray) -> FloatArray:
    """Return per channel how many pixels repeat one measurement, (3,), at least 1."""
    block = xy // _BLOCK_PX
    width = int(block[:, 0].max(initial=0)) + 1
    height = int(block[:, 1].max(initial=0)) + 1
    keys, of_block, size = np.unique(
        (index * height + block[:, 1]) * width + block[:, 0],
        return_inverse=True,
        return_counts=True,
    )
    full = size == _BLOCK_PX**2
    if full.sum() < _FEWEST_BLOCKS:
        return np.full(3, _UNKNOWN_REPETITION)
    disc = keys[full] // (width * height)
    squared = _sums(residuals, of_block, len(keys))[full] ** 2 / _BLOCK_PX**2
    # Per disc in units of its own variance; a plane has taken 3 of its degrees of freedom.
    variance = _sums(residuals**2, index, len(n_px)) / np.maximum(n_px - 3, 1)[:, None]
    left = np.maximum(1 - 3 * _BLOCK_PX**2 / n_px[disc], 0.1)
    noisy = (variance[disc] > 0).all(axis=1)
    if not noisy.any():
        return np.ones(3)
    ratio = squared[noisy] / variance[disc][noisy]
    return np.asarray(np.maximum(ratio.sum(axis=0) / left[noisy].sum(), 1.0))

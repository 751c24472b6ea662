"""Colours of the discs and of the squares around them.

The paper's way: disc centre from the square's corners, a 3x3 median as seed, region growing.
"""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.homography import homographies_of_cells
from calichrome.imaging import Image
from calichrome.observations import DiscSamples
from calichrome.target import Target

__all__ = ["BoardToPixels", "local_homographies", "measure_discs"]

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
_EDGE_OF_SQUARE = 0.15  # at most this share of a square, so that its corners stay beside a disc

_MIN_REGION_PX = 9  # the seed itself: fewer pixels are no region
_GRID = np.linspace(0.06, 0.94, 12)  # where a square is sampled, along each side
_MAX_CLIPPED = 0.1  # share of clipped samples above which a square gives no level
_NEIGHBOUR_SQUARES = 2.3  # squares within this distance give the level at a disc: 8 to 12 of a kind


def local_homographies(grid_px: FloatArray, square_m: tuple[float, float]) -> BoardToPixels:
    """Return the map board -> pixels that follows each square's own four corners.

    Parameters
    ----------
    grid_px : (ny, nx, 2) float
        All inner corners, pixels.
    square_m
        Size of a square, metres.

    Notes
    -----
    Squares of the outer ring continue their inner neighbour. A local plane-to-plane map takes up
    lens distortion to second order over one square, without knowing the lens.
    """
    homographies = homographies_of_cells(grid_px)
    limit_y, limit_x = homographies.shape[0] - 1, homographies.shape[1] - 1

    def to_pixels(points_board: FloatArray) -> FloatArray:
        squares = points_board[:, :2] / square_m
        cell_x = np.clip(np.floor(squares[:, 0]).astype(int), 0, limit_x)
        cell_y = np.clip(np.floor(squares[:, 1]).astype(int), 0, limit_y)
        inside = squares - np.stack([cell_x, cell_y], axis=1)
        homogeneous = np.concatenate([inside, np.ones((len(inside), 1))], axis=1)
        mapped = np.einsum("nij,nj->ni", homographies[cell_y, cell_x], homogeneous)
        return np.asarray(mapped[:, :2] / mapped[:, 2:])

    return to_pixels


def measure_discs(image: Image, target: Target, to_pixels: BoardToPixels) -> DiscSamples:
    """Measure every disc that the picture shows.

    Parameters
    ----------
    image
        A colour picture.
    target
        The board.
    to_pixels
        Where board points are in the picture: `local_homographies`, or pose and lens once known.

    Returns
    -------
    DiscSamples
        Discs outside the picture or too small for a region are absent.
    """
    levels, known = _square_levels(image, target, to_pixels)
    rows: list[tuple[FloatArray, ...]] = []
    for marker_id, marker in enumerate(target.markers):
        centre_board = target.marker_centres_board[marker_id]
        around = centre_board + 0.5 * marker.diameter_m * _COMPASS
        west, east, north, south, centre = to_pixels(np.concatenate([around, centre_board[None]]))
        axes = np.stack([(east - west) / 2, (south - north) / 2], axis=1)
        region = _grow_region(image, centre, axes)
        if region is None:
            continue
        values, clipped = region
        scatter = np.cov(values.T) if len(values) > 1 else np.full((3, 3), np.nan)
        light = [
            _level_at(marker.square, levels, known & (target.black_squares == black))
            for black in (False, True)
        ]
        count, share = np.array(len(values)), np.array(clipped)
        mean, median = values.mean(axis=0), np.median(values, axis=0)
        rows.append((np.array(marker_id), centre, mean, median, scatter, count, share, *light))
    columns = [np.array(column) for column in zip(*rows, strict=True)] if rows else _NO_COLUMNS
    return DiscSamples(
        marker_ids=columns[0].astype(np.int64),
        centres_px=columns[1],
        mean_rgb=columns[2],
        median_rgb=columns[3],
        cov_rgb=columns[4],
        n_px=columns[5].astype(np.int64),
        clipped=columns[6],
        white_rgb=columns[7],
        black_rgb=columns[8],
    )


_COMPASS = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]])
_NO_COLUMNS = [
    np.empty(shape)
    for shape in ((0,), (0, 2), (0, 3), (0, 3), (0, 3, 3), (0,), (0,), (0, 3), (0, 3))
]


def _grow_region(
    image: Image, centre: FloatArray, axes: FloatArray
) -> tuple[FloatArray, float] | None:
    """Return the linear values (n, 3) of a disc's region and the share of clipped pixels.

    The region grows from the seed over neighbouring pixels of like colour and ends before the
    blurred rim of the ellipse that `axes` (2, 2) span.
    """
    reach = np.ceil(np.abs(axes).sum(axis=1)).astype(int) + 1
    column, row = np.rint(centre).astype(int)
    width, height = image.size_wh
    if not (reach[0] <= column < width - reach[0] and reach[1] <= row < height - reach[1]):
        return None
    window = (
        slice(row - reach[1], row + reach[1] + 1),
        slice(column - reach[0], column + reach[0] + 1),
    )
    radius_px = np.linalg.svd(axes, compute_uv=False)[-1]
    y, x = np.mgrid[window]
    offsets = np.stack([x - centre[0], y - centre[1]], axis=-1) @ np.linalg.inv(axes).T
    edge = min(_EDGE_PX / radius_px, _EDGE_OF_DISC)
    core = np.hypot(offsets[..., 0], offsets[..., 1]) <= 1 - edge
    if core.sum() < _MIN_REGION_PX:
        return None

    values = image.linear(window)
    at_y, at_x = reach[1], reach[0]
    seed_pixels = values[at_y - 1 : at_y + 2, at_x - 1 : at_x + 2].reshape(-1, 3)
    seed = np.median(seed_pixels, axis=0)
    noise = 1.4826 * np.median(np.abs(values[core] - np.median(values[core], axis=0)), axis=0)
    tolerance = 5 * noise + 0.05 * seed.max()  # noise, and shading across the disc
    alike = core & (np.abs(values - seed) <= tolerance).all(axis=-1)
    labels, _ = ndimage.label(alike)
    if labels[at_y, at_x] == 0:
        return None
    region = labels == labels[at_y, at_x]
    if region.sum() < _MIN_REGION_PX:
        return None
    return values[region], float(image.is_clipped(window)[region].mean())


def _square_levels(
    image: Image, target: Target, to_pixels: BoardToPixels
) -> tuple[FloatArray, BoolArray]:
    """Return the level of every square, (ny, nx, 3), and which are known (ny, nx).

    A level is the median over samples that keep clear of the blurred rims of square and disc.
    """
    squares_x, squares_y = target.squares
    ix, iy = (axis.ravel() for axis in np.meshgrid(np.arange(squares_x), np.arange(squares_y)))
    u, v = (axis.ravel() for axis in np.meshgrid(_GRID, _GRID))
    side = np.array(target.square_m)
    corner = (np.stack([ix, iy], axis=1) - 1)[:, None, :]
    points = (corner + np.stack([u, v], axis=1)) * side
    flat = np.concatenate([points.reshape(-1, 2), np.zeros((points[..., 0].size, 1))], axis=1)
    pixels = to_pixels(flat).reshape(*points.shape)

    # pixels per square along its shorter foreshortened side, from the sampled grid itself
    step = (_GRID[1] - _GRID[0]) * (len(_GRID) - 1)
    last = len(_GRID) - 1
    width_px = np.linalg.norm(pixels[:, last] - pixels[:, 0], axis=1) / step
    height_px = np.linalg.norm(pixels[:, -1] - pixels[:, last], axis=1) / step
    rim = np.minimum(_EDGE_PX / np.minimum(width_px, height_px), _EDGE_OF_SQUARE)
    clear = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) >= rim[:, None]

    radius = np.zeros(len(ix))
    for marker in target.markers:
        radius[marker.square[1] * squares_x + marker.square[0]] = 0.5 * marker.diameter_m
    distance = np.hypot((u - 0.5) * side[0], (v - 0.5) * side[1])
    reach = np.where(radius > 0, radius + rim * side.min(), 0)
    clear &= distance[None] >= reach[:, None]

    width, height = image.size_wh
    column, row = np.moveaxis(np.rint(np.nan_to_num(pixels, nan=-1)).astype(int), -1, 0)
    clear &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
    top, left = row.min(), column.min()
    window = (slice(top, row.max() + 1), slice(left, column.max() + 1))
    values = image.linear(window)[row - top, column - left]
    clipped = image.is_clipped(window)[row - top, column - left] & clear

    n_clear = clear.sum(axis=1)
    known = (n_clear >= _MIN_REGION_PX) & (clipped.sum(axis=1) <= _MAX_CLIPPED * n_clear)
    levels = np.full((len(ix), 3), np.nan)
    for index in np.flatnonzero(known):
        levels[index] = np.median(values[index][clear[index]], axis=0)
    shape = squares_y, squares_x
    return levels.reshape(*shape, 3), known.reshape(shape)


def _level_at(square: tuple[int, int], levels: FloatArray, usable: BoolArray) -> FloatArray:
    """Level that squares of one colour would have at a disc: a plane through those around it."""
    iy, ix = np.nonzero(usable)
    offset = np.stack([ix - square[0], iy - square[1]], axis=1)
    near = np.hypot(offset[:, 0], offset[:, 1]) <= _NEIGHBOUR_SQUARES
    if near.sum() < 3:
        return np.full(3, np.nan)
    design = np.concatenate([np.ones((near.sum(), 1)), offset[near]], axis=1)
    plane, *_ = np.linalg.lstsq(design, levels[iy[near], ix[near]], rcond=None)
    return np.asarray(plane[0])

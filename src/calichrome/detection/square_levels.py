"""Level of every square beside its disc, and of white and black at any place of the board."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pixels import (
    NEARLY_FULL,
    linear_light,
    masked_median,
    nearest_pixels,
)
from calichrome.detection.square_looks import MOST_OFF_BLACK, MOST_OFF_WHITE, MOST_UNEVEN
from calichrome.imaging import Image
from calichrome.target import SquareColour, Target

__all__ = ["SquareLevels", "levels_at_discs", "measure_squares", "sample_points"]

_GRID = np.linspace(0.06, 0.94, 12)  # where a square is sampled, along each side
_EDGE_OF_SQUARE = 0.15  # at most this share of a square, so that its corners stay beside a disc
_FEWEST_SAMPLES = 9
_MAX_CLIPPED = 0.1  # share of clipped samples above which a square gives no level
_NEIGHBOUR_SQUARES = 2.3  # squares within this distance give the level at a disc: 8 to 12 of a kind
_FEWEST_NEIGHBOURS = 3
_OUTLIER = 4.0  # robust sigmas of a sample from the median of its square: dirt, a scratch


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SquareLevels:
    """What the squares show beside their discs, indexed [iy, ix].

    Parameters
    ----------
    rgb : (ny, nx, 3) float
        Median, linear, 0..1 of full scale; nan if there are too few samples.
    cov_rgb : (ny, nx, 3, 3) float
        Covariance of one sample, outliers left out.
    n_samples : (ny, nx) int
        Samples in the picture and clear of edges.
    clipped : (ny, nx) float
        Share of them with a channel at full scale.
    covered : (ny, nx) bool
        Uneven, or off from what its neighbours tell: something lies on it.
    """

    rgb: FloatArray
    cov_rgb: FloatArray
    n_samples: IntArray
    clipped: FloatArray
    covered: BoolArray

    @property
    def known(self) -> BoolArray:
        """Squares that give a level, (ny, nx)."""
        enough = self.n_samples >= _FEWEST_SAMPLES
        return np.asarray(enough & (self.clipped <= _MAX_CLIPPED) & ~self.covered)


def sample_points(target: Target) -> FloatArray:
    """Return where squares are sampled, (n_squares, G, 2), metres on the board, row-major."""
    x, y = np.meshgrid(np.arange(target.squares[0]), np.arange(target.squares[1]))
    upper_left = np.stack([x.ravel(), y.ravel()], axis=1)[:, None] - 1
    return np.asarray((upper_left + _grid()) * np.array(target.square_m))


def measure_squares(
    image: Image, target: Target, samples_px: FloatArray, visible: BoolArray, edge_px: float
) -> SquareLevels:
    """Measure all squares beside their discs.

    Parameters
    ----------
    samples_px : (n_squares, G, 2) float
        Where `sample_points` are in the picture.
    visible : (n_squares,) bool
        Squares to look at.
    edge_px
        Pixels beside an edge whose colour the edge changes.
    """
    column, row, inside = nearest_pixels(samples_px, image.size_wh)
    clear = _clear_of_edges(target, samples_px, edge_px) & inside & visible[:, None]
    numbers = image.pixels[row, column]
    if numbers.ndim == 2:
        numbers = np.repeat(numbers[..., None], 3, axis=2)
    light = linear_light(image, numbers)
    full = (numbers >= NEARLY_FULL * image.full_scale).any(axis=2) & clear

    count = clear.sum(axis=1)
    enough = count >= _FEWEST_SAMPLES
    rgb, spread = np.full((2, len(count), 3), np.nan)
    rgb[enough] = masked_median(np.where(clear[..., None], light, np.inf)[enough], count[enough])
    off = light - rgb[:, None]
    away = np.where(clear[..., None], np.abs(off), np.inf)
    # 1.4826 turns the median of absolute deviations into the sigma of a normal distribution
    spread[enough] = 1.4826 * masked_median(away[enough], count[enough])
    typical = clear & (away <= _OUTLIER * spread[:, None]).all(axis=2)
    # the median of 8-bit numbers is one of them: off by up to half a code, 0.3 % of white and 3 %
    # of black; the mean of what is typical is not
    shift = np.where(typical[..., None], off, 0.0).sum(axis=1)
    rgb = rgb + shift / np.maximum(typical.sum(axis=1), 1)[:, None]
    off = np.where(typical[..., None], light - rgb[:, None], 0.0)
    scatter = np.swapaxes(off, 1, 2) @ off / np.maximum(typical.sum(axis=1) - 1, 1)[:, None, None]
    nx, ny = target.squares
    return SquareLevels(
        rgb=rgb.reshape(ny, nx, 3),
        cov_rgb=scatter.reshape(ny, nx, 3, 3),
        n_samples=count.reshape(ny, nx),
        clipped=(full.sum(axis=1) / np.maximum(count, 1)).reshape(ny, nx),
        covered=_covered(rgb, spread, target.black_squares.ravel(), nx).reshape(ny, nx),
    )


def levels_at_discs(target: Target, levels: SquareLevels, kind: SquareColour) -> FloatArray:
    """Return the level that squares of one kind would have at each disc, (n_markers, 3).

    A plane through the known squares of that kind around the disc; nan where they are fewer than 3.
    """
    iy, ix = np.nonzero(levels.known & (target.black_squares == (kind == "black")))
    offset = np.stack([ix, iy], axis=1) - target.marker_squares[:, None]
    near = np.hypot(offset[..., 0], offset[..., 1]) <= _NEIGHBOUR_SQUARES
    design = np.concatenate([np.ones((*near.shape, 1)), offset], axis=2) * near[..., None]
    # Squares on one line leave the slope across it open; the pseudoinverse takes none.
    normal = np.swapaxes(design, 1, 2) @ design
    planes = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ (
        np.swapaxes(design, 1, 2) @ levels.rgb[iy, ix]
    )
    enough = near.sum(axis=1) >= _FEWEST_NEIGHBOURS
    return np.where(enough[:, None], planes[:, 0], np.nan)


def _grid() -> FloatArray:
    u, v = np.meshgrid(_GRID, _GRID)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _clear_of_edges(target: Target, samples_px: FloatArray, edge_px: float) -> BoolArray:
    """Tell which samples keep clear of the blurred rims of square and disc, (n_squares, G)."""
    side = np.array(target.square_m)
    u, v = _grid().T
    last = len(_GRID) - 1
    # pixels per square along its shorter foreshortened side, from the sampled grid itself
    width_px = np.linalg.norm(samples_px[:, last] - samples_px[:, 0], axis=1)
    height_px = np.linalg.norm(samples_px[:, -1] - samples_px[:, last], axis=1)
    square_px = np.maximum(np.minimum(width_px, height_px) / (_GRID[-1] - _GRID[0]), 1e-9)
    rim = np.minimum(edge_px / square_px, _EDGE_OF_SQUARE)
    clear = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) >= rim[:, None]
    radius = np.zeros(len(samples_px))
    for marker in target.markers:
        radius[marker.square[1] * target.squares[0] + marker.square[0]] = 0.5 * marker.diameter_m
    distance = np.hypot((u - 0.5) * side[0], (v - 0.5) * side[1])
    reach = np.where(radius > 0, radius + rim * side.min(), 0)
    return np.asarray(clear & (distance >= reach[:, None]))


def _covered(rgb: FloatArray, spread: FloatArray, black: BoolArray, nx: int) -> BoolArray:
    """Find squares, (n_squares,), that are uneven or unlike their neighbours of the same kind."""
    index = np.arange(len(rgb))
    x, y = index % nx, index // nx
    near = np.hypot(x - x[:, None], y - y[:, None]) <= _NEIGHBOUR_SQUARES
    brightness = rgb.mean(axis=1)
    known = np.isfinite(brightness)
    local = np.stack(
        [
            masked_median(np.where(usable, brightness, np.inf)[..., None], usable.sum(axis=1))[:, 0]
            for usable in (near & known & ~black, near & known & black)
        ]
    )
    with np.errstate(invalid="ignore"):  # infinite where no neighbour is known
        step = local[0] - local[1]
        own = np.where(black, local[1], local[0])
        uneven = spread.mean(axis=1) > MOST_UNEVEN * step
        most_off = np.where(black, MOST_OFF_BLACK, MOST_OFF_WHITE)
        off = np.abs(brightness - own) > most_off * step
    return np.asarray(known & np.isfinite(step) & (uneven | off))

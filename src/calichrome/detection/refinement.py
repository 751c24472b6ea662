"""Corners to the limit of the pixels: a maximum-likelihood fit of blurred saddles, with covariance.

Mirrored at the corner, the saddle keeps its value: its levels, blur and edge directions are even
functions and cannot pull the position; nor can clipping or a wrong encoding, which act on each
pixel alone. Only what is odd can: the curvature of the edges and the
gradient of the light. Both are smooth over the board, so a first pass fits every corner alone in a
small window, the board tells curvature and light from all of them, and a second pass fits the
whole cell of each corner with these as priors of known spread.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.blurred_saddle import (
    N_PARAMETERS,
    SaddleParameters,
)
from calichrome.detection.board_map import BoardMap, EdgeBend
from calichrome.detection.corner_equations import (
    MIN_PIXELS,
    N_ALONE,
    NoiseOfLevels,
    inverse,
    normal_equations,
    solved,
)
from calichrome.detection.corner_pixels import (
    CornerPixels,
    Discs,
    clear_of_discs,
    pixels_along_edges,
)
from calichrome.detection.levels import Levels
from calichrome.detection.light_field import light_gradients

__all__ = ["RefinedCorners", "refine_corners"]

_FIRST_BLUR_PX = 1.1  # where the fit of the blur starts
_FIRST_STEPS = (2, 1)  # with each choice of pixels
_FIRST_REACH = 0.22  # of a square: clear of discs of up to 0.7
_FIRST_REACH_PX = (3.0, 10.0)  # at least, to hold enough pixels; at most, where light may change
_BAND_SIGMAS = 2.5
"""Half-width of the strip along an edge that is fitted: 98.8 % of the edge's change lie within. On
40 random scenes 3.0 gave the same errors from a fifth more pixels."""
_STEP_LIMITS = np.array([1.5, 1.5, 0.2, 0.2, 0.4, np.inf, np.inf])  # px, px, rad, rad, log px
_FARTHEST_MOVE_PX = 2.5
_LARGEST_SIGMA_PX = 0.5  # beyond, a corner was found better than it can be fitted
_START_SIGMA_PX = 0.1  # of a corner that was found and not fitted, at least
_MAP_GATE = 12.0  # mean squared misfit to the map, in units of the board's own
_LEAST_DISAGREEMENT = 0.1
"""Rounding and rendered pictures without noise leave less; the least on noisy ones was 0.15
(rendered mosaics). Below, one clean view would outweigh all others."""
_MODEL_SIGMA_PX = 3e-4
"""A floor. Without noise the fit was off by 4 to 5e-4 px RMS per coordinate on boards sampled 16
times per pixel (four phases), an unknown part of which is the sampling's."""
_FEWEST_TO_JUDGE = 20  # degrees of freedom that a statement about the whole board needs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefinedCorners:
    """Corners with their covariance.

    Parameters
    ----------
    corners_px : (N, 2) float
    cov_px : (N, 2, 2) float
    fitted : (N,) bool
        False where the fit was doubtful: the corner is then where it was found, with a covariance
        that covers its distance from the map of the others.
    blur_px
        Median sigma of the blur, including the pixel's own.
    noise
        Standard deviation of the pixels, 0..1 of full scale: mean of black, edges and white.
    disagreement
        Mean squared misfit of the corners to a smooth map, in units of what white noise lets
        expect; `cov_px` is widened by it. nan if too few corners tell; then it is not.
    reading
        Which reading of the picture was used.
    """

    corners_px: FloatArray
    cov_px: FloatArray
    fitted: BoolArray
    blur_px: float
    noise: float
    disagreement: float
    reading: int


@dataclass(frozen=True, slots=True, eq=False)
class _Alone:
    """What corners say each for itself; `cov_px` (N, 2, 2) is nan where they say nothing."""

    parameters: SaddleParameters
    cov_px: FloatArray
    noise: NoiseOfLevels

    @property
    def edge_misfit(self) -> float:
        """Residuals half way between black and white, as a share of the contrast.

        In light, a blurred edge is as steep below as above its middle; an encoding bends it.
        """
        return float(self.noise.sigma[1] / np.median(np.abs(self.parameters.values[:, 6])))


def refine_corners(
    readings: Sequence[Levels],
    start_px: FloatArray,
    indices: IntArray,
    white: BoolArray,
    discs: Discs,
    board_map: BoardMap,
) -> RefinedCorners:
    """Fit every corner.

    Parameters
    ----------
    readings
        The picture in linear light; where its encoding is not certain, as it would be for each
        that is possible. The one in which the edges look most like blurred edges is used.
    start_px : (N, 2) float
        Corners to about half a pixel.
    indices : (N, 2) int
        Their places (ix, iy) on the board.
    white : (N,) bool
        Whether the square to the lower right of a corner is white.
    discs
        What lies inside the squares and must not be fitted.
    board_map
        The board in the picture, from the corners as they were found.
    """
    size_wh = board_map.size_wh
    lattice = indices.astype(np.float64)
    start_px = _pulled_in(start_px, board_map(lattice))
    edges = board_map.edges(lattice)
    alone = [
        _fit_alone(levels, _start(levels, start_px, edges, white, size_wh), edges, size_wh)
        for levels in readings
    ]
    reading = int(np.argmin([one.edge_misfit for one in alone]))
    levels, parameters = readings[reading], alone[reading].parameters
    alone_cov, noise = alone[reading].cov_px, alone[reading].noise

    good = _are_covariances(alone_cov)
    good &= np.linalg.norm(parameters.positions_px - start_px, axis=1) < _FARTHEST_MOVE_PX
    if not _span_a_plane(lattice[good]):
        return _nothing_fitted(start_px, board_map(lattice))
    board_map = BoardMap.fit(lattice[good], parameters.positions_px[good], size_wh, alone_cov[good])
    edges = board_map.edges(lattice)
    parameters, precision = _with_board_knowledge(parameters, edges, lattice, good)
    blur = float(np.exp(np.median(parameters.values[good, 4])))
    reach = np.full(len(lattice), 0.5)
    pixels = pixels_along_edges(parameters.positions_px, edges, reach, _BAND_SIGMAS * blur, size_wh)
    pixels = clear_of_discs(
        pixels, parameters.positions_px, edges, indices, discs.on(board_map), blur
    )
    parameters, cov_px, n_pixels = _fit_cells(levels, parameters, pixels, precision, noise)
    fitted = good & (n_pixels >= MIN_PIXELS)
    fitted &= _are_covariances(cov_px)
    fitted &= np.linalg.norm(parameters.positions_px - start_px, axis=1) < _FARTHEST_MOVE_PX
    if not _span_a_plane(lattice[fitted]):
        return _nothing_fitted(start_px, board_map(lattice))
    fine = RefinedCorners(
        corners_px=parameters.positions_px,
        cov_px=cov_px,
        fitted=fitted,
        blur_px=blur,
        noise=float(noise.sigma.mean()),
        disagreement=float("nan"),
        reading=reading,
    )
    return _judged(fine, start_px, lattice, size_wh)


def _pulled_in(start_px: FloatArray, mapped_px: FloatArray) -> FloatArray:
    """Put corners that were found far off the map of the others onto it."""
    off = np.linalg.norm(start_px - mapped_px, axis=1)
    limit = max(1.0, 6 * float(np.median(off)))
    return np.where((off > limit)[:, None], mapped_px, start_px)


def _start(
    levels: Levels,
    start_px: FloatArray,
    edges: EdgeBend,
    white: BoolArray,
    size_wh: tuple[int, int],
) -> SaddleParameters:
    """Angles from the map, levels from four pixels a fifth of a square off the corner."""
    values = np.zeros((len(start_px), N_PARAMETERS))
    values[:, 0:2] = start_px
    for column, run, other in (
        (2, edges.along_j, edges.along_i),
        (3, edges.along_i, edges.along_j),
    ):
        normal = np.stack([run[:, 1], -run[:, 0]], axis=1)
        normal *= np.sign((normal * other).sum(axis=1))[:, None]
        values[:, column] = np.arctan2(normal[:, 1], normal[:, 0])
    values[:, 4] = np.log(_FIRST_BLUR_PX)
    diagonals = (edges.along_i + edges.along_j, edges.along_i - edges.along_j)
    places = [start_px + 0.2 * sign * step for step in diagonals for sign in (1, -1)]
    at = np.clip(np.rint(places), 0, np.array(size_wh) - 1).astype(np.int64)
    same = levels(at[:2, :, 0].ravel(), at[:2, :, 1].ravel())
    opposite = levels(at[2:, :, 0].ravel(), at[2:, :, 1].ravel())
    same, opposite = same.reshape(2, -1).mean(axis=0), opposite.reshape(2, -1).mean(axis=0)
    values[:, 5] = (same + opposite) / 2
    contrast = np.abs(same - opposite) / 2
    values[:, 6] = np.where(white, 1, -1) * np.maximum(contrast, 1e-4)
    values[:, 11:13] = edges.curvature
    return SaddleParameters(values)


def _fit_alone(
    levels: Levels, parameters: SaddleParameters, edges: EdgeBend, size_wh: tuple[int, int]
) -> _Alone:
    """Fit the seven own parameters of every corner in a small window."""
    square = np.minimum(
        np.linalg.norm(edges.along_i, axis=1), np.linalg.norm(edges.along_j, axis=1)
    )
    reach_px = np.clip(_FIRST_REACH * square, *_FIRST_REACH_PX)
    reach = np.minimum(reach_px / square, 0.5)
    moves = np.zeros((len(parameters), N_PARAMETERS))
    for n_steps in _FIRST_STEPS:  # pixels are chosen again when position and blur are known better
        blur = float(np.exp(np.median(parameters.values[:, 4])))
        pixels = pixels_along_edges(
            parameters.positions_px, edges, reach, _BAND_SIGMAS * blur, size_wh
        )
        seen = levels(pixels.column, pixels.row)
        for _ in range(n_steps):
            equations = normal_equations(parameters, pixels, seen, N_ALONE)
            steps = solved(equations.normal, equations.right)
            steps = np.clip(steps, -_STEP_LIMITS, _STEP_LIMITS)
            moves[:, :N_ALONE] = steps
            parameters = parameters.moved(moves)
    variance = equations.variance(equations.squares_after(steps))
    cov_px = inverse(equations.normal)[:, :2, :2] * variance
    cov_px[equations.n_pixels < MIN_PIXELS] = np.nan
    noise = NoiseOfLevels.of(equations.residuals, equations.brightness)
    return _Alone(parameters, cov_px, noise)


def _with_board_knowledge(
    parameters: SaddleParameters, edges: EdgeBend, lattice: FloatArray, good: BoolArray
) -> tuple[SaddleParameters, FloatArray]:
    """Set gradients and curvatures from the whole board; return their prior precision (N, 13, 13).

    The gradient of the contrast is that of |b|, whose sign is the corner's.
    """
    values = parameters.values.copy()
    precision = np.zeros((len(values), N_PARAMETERS, N_PARAMETERS))
    to_lattice = np.linalg.inv(np.stack([edges.along_i, edges.along_j], axis=2))
    sign = np.sign(values[:, 6])
    for level, columns, signs in ((5, slice(7, 9), 1.0), (6, slice(9, 11), sign)):
        per_square, cov = light_gradients(lattice[good], (values[:, level] * signs)[good])
        gradient, spread = np.zeros((len(values), 2)), np.zeros((len(values), 2, 2))
        gradient[good], spread[good] = per_square, cov
        gradient[~good], spread[~good] = per_square.mean(axis=0), 4 * cov.mean(axis=0)
        gradient_px = np.einsum("nji,nj->ni", to_lattice, gradient)
        spread_px = np.einsum("nki,nkl,nlj->nij", to_lattice, spread, to_lattice)
        values[:, columns] = gradient_px * np.reshape(signs, (-1, 1))
        floor = (1e-6 * np.abs(values[:, 6]))[:, None, None] ** 2 * np.eye(2)
        precision[:, columns, columns] = np.linalg.inv(spread_px + floor)
    values[:, 11:13] = edges.curvature
    precision[:, 11, 11] = 1 / np.maximum(edges.variance[:, 0], 1e-18)
    precision[:, 12, 12] = 1 / np.maximum(edges.variance[:, 1], 1e-18)
    return SaddleParameters(values), precision


def _fit_cells(
    levels: Levels,
    parameters: SaddleParameters,
    pixels: CornerPixels,
    precision: FloatArray,
    noise: NoiseOfLevels,
) -> tuple[SaddleParameters, FloatArray, IntArray]:
    """Fit all parameters of every corner in its whole cell, one step from the first pass."""
    seen = levels(pixels.column, pixels.row)
    equations = normal_equations(parameters, pixels, seen, N_PARAMETERS, noise)
    variance = 1.0
    for _ in range(2):  # the second time with the residuals of the first
        information = equations.normal / variance + precision
        steps = solved(information, equations.right / variance)
        variance = equations.variance(equations.squares_after(steps))
    steps[:, :N_ALONE] = np.clip(steps[:, :N_ALONE], -_STEP_LIMITS, _STEP_LIMITS)
    cov_px = inverse(equations.normal / variance + precision)[:, :2, :2]
    cov_px = cov_px + _MODEL_SIGMA_PX**2 * np.eye(2)
    return parameters.moved(steps), cov_px, equations.n_pixels


def _span_a_plane(lattice: FloatArray) -> bool:
    """Tell whether corners (N, 2) determine a map: four or more, not on one line."""
    return len(lattice) >= 4 and int(np.linalg.matrix_rank(lattice - lattice.mean(axis=0))) == 2


def _are_covariances(cov_px: FloatArray) -> BoolArray:
    """Tell which matrices (N, 2, 2) are positive and small enough to say something."""
    finite = np.asarray(np.isfinite(cov_px).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], cov_px, 0))
    return np.asarray((values[:, 0] > 0) & (values[:, 1] < _LARGEST_SIGMA_PX**2))


def _judged(
    fine: RefinedCorners, start_px: FloatArray, lattice: FloatArray, size_wh: tuple[int, int]
) -> RefinedCorners:
    """Compare corners with the map of all, scale the covariance, set doubtful corners apart."""
    fitted, cov_px = fine.fitted, fine.cov_px
    board_map = BoardMap.fit(lattice[fitted], fine.corners_px[fitted], size_wh, cov_px[fitted])
    mapped = board_map(lattice)
    if board_map.n_free < _FEWEST_TO_JUDGE:
        return _with_doubtful(fine, fitted, start_px, mapped)
    disagreement = max(board_map.misfit, _LEAST_DISAGREEMENT)
    misfit = (fine.corners_px - mapped)[..., None]
    weighted = np.linalg.solve(np.where(fitted[:, None, None], cov_px, np.eye(2)), misfit)
    size = (misfit * weighted).sum(axis=(1, 2)) / 2
    fitted = fitted & (size <= _MAP_GATE * max(disagreement, 1.0))
    widened = _widened(cov_px, misfit[..., 0], fitted, disagreement)
    fine = replace(fine, cov_px=widened, disagreement=disagreement)
    return _with_doubtful(fine, fitted, start_px, mapped)


def _widened(
    cov_px: FloatArray, misfit_px: FloatArray, fitted: BoolArray, disagreement: float
) -> FloatArray:
    """Let the covariances explain the misfit: by a floor common to all corners of the view.

    What moves corners of a printed board off a smooth map (a print that is not even, paper that is
    not flat) moves sharp and blurred ones alike, so a variance s^2 is added to each, such that the
    mean of m' (C + s^2)^-1 m is what it should be. Where corners agree better than their noise
    says, all are scaled down.
    """
    if disagreement <= 1 or not fitted.any():
        return cov_px * disagreement
    values, axes = np.linalg.eigh(cov_px[fitted])
    along = np.einsum("nij,ni->nj", axes, misfit_px[fitted]) ** 2
    now = float((along / values).sum())

    def excess(log_variance: float) -> float:
        return float((along / (values + np.exp(log_variance))).sum()) * disagreement / now - 1

    low, high = np.log(values.min() * 1e-6), np.log(along.sum() * disagreement / now + values.max())
    if excess(low) <= 0 or excess(high) >= 0:
        return cov_px * disagreement
    return np.asarray(cov_px + np.exp(brentq(excess, low, high, xtol=1e-6)) * np.eye(2))


def _with_doubtful(
    fine: RefinedCorners, fitted: BoolArray, start_px: FloatArray, mapped: FloatArray
) -> RefinedCorners:
    """Put corners that are not `fitted` back to where they were found."""
    distance = np.maximum(np.linalg.norm(start_px - mapped, axis=1), _START_SIGMA_PX)
    covering = (distance**2)[:, None, None] * np.eye(2)
    return replace(
        fine,
        corners_px=np.where(fitted[:, None], fine.corners_px, start_px),
        cov_px=np.where(fitted[:, None, None], fine.cov_px, covering),
        fitted=fitted,
    )


def _nothing_fitted(start_px: FloatArray, mapped: FloatArray) -> RefinedCorners:
    unknown = RefinedCorners(
        corners_px=start_px,
        cov_px=np.zeros((len(start_px), 2, 2)),
        fitted=np.zeros(len(start_px), dtype=bool),
        blur_px=float("nan"),
        noise=float("nan"),
        disagreement=float("nan"),
        reading=0,
    )
    return _with_doubtful(unknown, unknown.fitted, start_px, mapped)

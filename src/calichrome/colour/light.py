"""How bright each place of a view was, read from the white squares beside the discs."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.target import SquareColour, Target

__all__ = ["READING_REACH_SQUARES", "Neighbourhoods", "fit_light", "light_at"]

READING_REACH_SQUARES = 2.3
"""Squares of one kind within this distance of a disc give the level beside it: what
`detection.square_levels` does, which a test compares."""

_ROUNDS = 3  # of reweighting: it only has to sort out single squares, not to converge
_HUBER = 2.0  # robust sigmas beyond which a white reading loses weight (a shadow, a misread square)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Neighbourhoods:
    """Which squares the level beside each disc was read from.

    A level is that of a plane through the squares of one kind around the disc. Where light or lens
    are curved, it is off the level at the disc itself by up to one per cent, the same in every
    view; who knows the squares can allow for it.

    Parameters
    ----------
    weights : (n_markers, n_squares) float
        Of each square in the level of each disc; rows sum to 1, or are 0 for a disc with too few
        squares.
    squares_board : (n_squares, 2) float
        Centres of the squares of that kind, metres.
    discs_board : (n_markers, 2) float
    """

    weights: FloatArray
    squares_board: FloatArray
    discs_board: FloatArray

    @classmethod
    def around_discs(cls, target: Target, kind: SquareColour = "white") -> "Neighbourhoods":
        """Find them for a target whose squares are all seen."""
        iy, ix = np.nonzero(target.black_squares == (kind == "black"))
        squares = np.stack([ix, iy], axis=1)
        offset = squares - target.marker_squares[:, None]
        near = np.hypot(offset[..., 0], offset[..., 1]) <= READING_REACH_SQUARES
        design = np.concatenate([np.ones((*near.shape, 1)), offset], axis=2) * near[..., None]
        # the first row of the pseudoinverse: the plane's level at the disc
        weights = np.linalg.pinv(design)[:, 0] * near
        return cls(
            weights=np.where((near.sum(axis=1) >= 3)[:, None], weights, 0.0),
            squares_board=(squares - 0.5) * np.array(target.square_m),
            discs_board=target.marker_centres_board[:, :2],
        )

    def squares_px(self, marker_ids: IntArray, centres_px: FloatArray) -> FloatArray | None:
        """Return where the squares are in a picture, seen from each disc, (M, n_squares, 2).

        The plane-to-plane map through the disc centres moves from each disc to the squares, so
        that distortion common to both drops out. None with fewer than four discs.
        """
        discs = self.discs_board[marker_ids]
        if len(discs) < 4 or np.linalg.matrix_rank(discs - discs.mean(axis=0), tol=1e-9) < 2:
            return None
        to_px = fit_homography(discs, centres_px)
        steps = (
            apply_homography(to_px, self.squares_board) - (apply_homography(to_px, discs)[:, None])
        )
        return np.asarray(centres_px[:, None] + steps)


def light_at(positions: FloatArray, white_rgb: FloatArray) -> FloatArray:
    """Smooth the levels of the white squares of one view and return them at the same places.

    Parameters
    ----------
    positions : (M, 2) float
        Where the levels were read; any unit.
    white_rgb : (M, 3) float
        Linear levels; nan where unknown.

    Returns
    -------
    (M, 3) float
        A quadratic surface through the known levels, per channel (a plane for fewer than 12, their
        median for fewer than 6); nan everywhere if there are none.

    Notes
    -----
    Light of a lamp and the fall-off of a lens are smooth over a board; a quadratic takes both up:
    docs/decisions/0003-light-before-colour.md has the measurement.
    """
    return fit_light(positions, white_rgb)[0]


def fit_light(
    positions: FloatArray,
    white_rgb: FloatArray,
    *,
    squares: FloatArray | None = None,
    weights: FloatArray | None = None,
    gain: FloatArray | None = None,
    square_gain: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fit a smooth light to levels that were read from squares around discs.

    Parameters
    ----------
    positions : (M, 2) float
        Of the discs; any unit.
    white_rgb : (M, 3) float
        Linear levels read there; nan where unknown.
    squares : (Q, 2) float, optional
        Of the white squares, in the unit of `positions`. Default: each level is one at its disc.
    weights : (M, Q) float
        Of each square in each level; with `squares`.
    gain, square_gain : (M, 3), (M, Q, 3) float, optional
        What the lens lets through at discs and at squares; the light is smooth without it.

    Returns
    -------
    level : (M, 3) float
        Of a white square at each disc, behind the lens.
    variance : (M, 3) float
        Of `level`, from the scatter of the readings about the surface; readings that share squares
        share their noise. nan where nothing can be said.
    """
    n_discs = len(positions)
    known = np.asarray(np.isfinite(white_rgb).all(axis=1))
    if weights is not None:
        known = known & (weights != 0).any(axis=1)
    n_known = int(known.sum())
    unknown = np.full((n_discs, 3), np.nan)
    if n_known == 0:
        return unknown, unknown
    if squares is None or weights is None:
        squares, weights = positions, np.eye(n_discs)
    n_terms = 6 if n_known >= 12 else 3 if n_known >= 6 else 1
    if n_terms == 1 and gain is None:
        level = np.median(white_rgb[known], axis=0)
        return np.broadcast_to(level, white_rgb.shape).copy(), unknown
    centre = positions[known].mean(axis=0)
    scale = max(float(np.ptp(positions[known], axis=0).max()), 1e-12)
    at_discs = _terms((positions - centre) / scale, n_terms)
    at_squares = _terms((squares - centre) / scale, n_terms)
    at_discs = np.repeat(at_discs[None], 3, axis=0)
    averages = np.repeat((weights @ at_squares)[None], 3, axis=0)
    if gain is not None and square_gain is not None:
        at_discs = at_discs * gain.T[:, :, None]
        averages = np.stack([(weights * square_gain[..., k]) @ at_squares for k in range(3)])
    return _robust_surface(averages, at_discs, white_rgb, known, weights)


def _terms(places: FloatArray, count: int) -> FloatArray:
    x, y = places.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y][:count], axis=1)


def _robust_surface(
    averages: FloatArray,
    at_discs: FloatArray,
    white_rgb: FloatArray,
    known: BoolArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Solve each channel, (3, M, n_terms) to (M, 3), with one weight of a reading for all."""
    read, white = averages[:, known], white_rgb[known].T
    trust = np.ones(read.shape[1])
    for _ in range(_ROUNDS):
        solvers = np.linalg.pinv(read * trust[:, None]) * trust  # (3, n_terms, K)
        solution = solvers @ white[..., None]
        fitted = (read @ solution)[..., 0]
        # one weight for all channels: a shadow darkens all three
        error = np.abs(white / np.maximum(fitted, 1e-9) - 1).max(axis=0)
        sigma = max(1.4826 * float(np.median(error)), 1e-9)
        trust = np.sqrt(np.minimum(1, _HUBER * sigma / np.maximum(error, 1e-12)))
    level = (at_discs @ solution)[..., 0].T
    # each square has its own noise: readings are correlated as they share squares
    shared = weights[known] @ weights[known].T
    left = np.eye(len(trust)) - read @ solvers
    expected = np.einsum("kij,jl,kil->k", left * trust[:, None], shared, left * trust[:, None])
    noise = ((trust * (white - fitted)) ** 2).sum(axis=1) / np.maximum(expected, 1e-12)
    reach = at_discs @ solvers
    variance = np.einsum("kij,jl,kil->ki", reach, shared, reach) * noise[:, None]
    if read.shape[1] <= read.shape[2]:
        variance = np.full_like(variance, np.nan)
    return np.asarray(level), np.asarray(variance.T)

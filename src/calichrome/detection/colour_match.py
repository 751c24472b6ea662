"""How well the colours of the board explain what squares look like, wherever they may lie.

The model, for a square whose nominal linear colour is x (0 black, 1 white of the board):

    level = M x + offset + error,

with M unknown: what the spectra of light and sensor make of the colours once white and black are
taken out. An empty square is a disc of the board's own white or black, so that the presence of
discs is judged together with their colours. Channels are taken as brightness and two differences
of colour, whose errors are about independent. With probability epsilon a square shows something
else (a finger, a reflection), of any colour.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.square_looks import SquareLooks
from calichrome.target import Target

__all__ = ["BoardColours", "Match", "board_colours", "chance_likelihood", "match_colours"]

_WHITE_Y, _BLACK_Y = 0.85, 0.04
"""Luminance factors of paper and ink that were not measured, as in `target.layout`."""

_OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3.0], [2.0], [6.0]])
"""Orthonormal: brightness, red against blue, green against both."""

_MEAN_RESPONSE = np.array([[0.80, 0.15, 0.05], [0.12, 0.81, 0.07], [0.07, 0.19, 0.74]])
"""Half-way between pictures in sRGB (the identity) and raw ones: the mean of the Nikon 5100 and the
Sigma SD Merill under A, D50, D65, D75, FL2, FL11 and five LED lights is
[[.61 .30 .10], [.24 .62 .15], [.14 .39 .50]]."""

_RESPONSE_SIGMA = 0.25
"""Of each element of M about that mean, rows summing to 1: of those 22 cameras and lights half lie
within 0.15 and the farthest 0.54 away (blue of the Sigma under A); the identity up to 0.26."""

_WHITE_SIGMA, _BLACK_SIGMA = 0.05, 0.03
"""Of what white and black come out at: uneven light, stray light and blur between squares."""

_CLIPPED_WHITE_GAIN, _CLIPPED_GAIN_SIGMA = 1.2, 0.3
"""Where white is at full scale its true level is higher: by up to 2 in pictures of any use."""

_EMPTY_SIGMA = (0.07, 0.025)
"""Errors (brightness, colour difference) of squares without a disc, of the step from black to
white, in the units of `_OPPONENT`: brightness counts root 3."""

_DISC_SIGMA, _DISC_RELATIVE_SIGMA = (0.05, 0.025), (0.25, 0.10)
"""Errors of a disc: fixed, and relative to its brightness. A print off by 3 per Lab axis is off by
14 % in luminance at L* = 50 (0.25 with root 3) and by 5 % in differences of channels; what no
matrix explains of ColorChecker colours with the sensors and lights above is 0.01 to 0.02."""

_OUTLIER_SHARE = np.array([0.2, 0.2, 0.2, 0.06, 0.03])
"""Probability that a square shows something else, by how many of its corners were found."""

_OUTLIER_RANGE = 1.4  # levels of such a square are anywhere from -0.1 to 1.3
_ITERATIONS = 5
_BLOCK = 200_000  # placements x squares that are computed at a time


@dataclass(frozen=True, slots=True, eq=False)
class BoardColours:
    """Nominal colours of all squares, row-major.

    Parameters
    ----------
    rgb : (n_squares, 3) float
        Linear, 0 the board's black and 1 its white.
    sigma : (n_squares, 2) float
        Error of brightness and of colour differences.
    """

    rgb: FloatArray
    sigma: FloatArray

    def looser(self, factor: float) -> "BoardColours":
        """Return the same colours with larger errors, as of a poor print."""
        return BoardColours(self.rgb, factor * self.sigma)


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """What the colours say of every placement.

    Parameters
    ----------
    log_likelihood : (P,) float
        With M integrated out.
    inlier : (P, S) float
        Probability that the square shows what the placement says.
    """

    log_likelihood: FloatArray
    inlier: FloatArray


def board_colours(target: Target) -> BoardColours:
    """Return what every square of a board should look like."""
    to_rgb = RGB_FROM_XYZ["srgb"].T
    white = np.array(target.paper.white_xyz_d65 or _WHITE_Y * D65) @ to_rgb
    black = np.array(target.paper.black_xyz_d65 or _BLACK_Y * D65) @ to_rgb
    rgb = np.where(target.black_squares.reshape(-1, 1), 0.0, np.ones(3))
    sigma = np.tile(_EMPTY_SIGMA, (len(rgb), 1))
    if target.markers:
        at = target.marker_squares @ [1, target.squares[0]]
        discs = (target.marker_xyz_d65 @ to_rgb - black) / (white - black)
        brightness = np.maximum(discs.mean(axis=1), 0.0)
        rgb[at] = discs
        sigma[at] = np.hypot(_DISC_SIGMA, brightness[:, None] * np.array(_DISC_RELATIVE_SIGMA))
    return BoardColours(rgb, sigma)


def match_colours(looks: SquareLooks, board: BoardColours, squares: IntArray) -> Match:
    """Judge placements by their colours.

    Parameters
    ----------
    looks
        S squares as seen.
    squares : (P, S) int
        Square of the board, row-major, that each would be.

    Notes
    -----
    For each placement M and the offset are fitted by expectation maximisation with a Gaussian
    prior; the likelihood is integrated over them by Laplace's method. Levels at full scale are
    replaced by what the fit expects where that is higher.
    """
    certain = np.zeros((len(looks), 1))
    size = max(_BLOCK // max(len(looks), 1), 1)
    blocks = [squares[start : start + size, :, None] for start in range(0, len(squares), size)]
    parts = [_fit(looks, board.rgb[at], board.sigma[at], certain) for at in blocks]
    if not parts:
        return Match(np.empty(0), np.empty((0, len(looks))))
    return Match(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def chance_likelihood(looks: SquareLooks, board: BoardColours, black_squares: BoolArray) -> float:
    """Return the log likelihood of the same colours in any other arrangement.

    Each square then shows what a random square of its kind shows on this board, independently.
    Comparing with it tells whether the arrangement fits, not only the palette.

    Parameters
    ----------
    black_squares : (n_squares,) bool
        Kind of every square of the board, row-major.
    """
    contents = np.concatenate([board.rgb, board.sigma], axis=1)
    distinct, which = np.unique(contents, axis=0, return_inverse=True)
    share = np.stack(
        [np.bincount(which[black_squares == kind], minlength=len(distinct)) for kind in (0, 1)]
    )
    # The contents that occur on each kind of square, most frequent first.
    by_share = np.argsort(-share, axis=1)[:, : int((share > 0).sum(axis=1).max())]
    share = np.take_along_axis(share, by_share, axis=1)
    with np.errstate(divide="ignore"):  # one kind has fewer contents than the other
        log_share = np.log(share / share.sum(axis=1, keepdims=True))
    kind = looks.black.astype(int)
    possible = distinct[by_share[kind]][None]
    log_likelihood, _ = _fit(looks, possible[..., :3], possible[..., 3:], log_share[kind])
    return float(log_likelihood[0])


def _fit(
    looks: SquareLooks, rgb: FloatArray, sigma: FloatArray, log_share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit the response for P hypotheses, each of which gives every square Q possible contents.

    Parameters
    ----------
    rgb, sigma : (P, S, Q, 3), (P, S, Q, 2) float
        Nominal colours and their errors.
    log_share : (S, Q) float
        Log probability of each content.

    Returns
    -------
    log_likelihood (P,) and the probability that a square shows any of its contents (P, S).
    """
    basis, kinds = _basis(looks.levels.shape[1])
    n_hypotheses, n_seen, n_contents = rgb.shape[:3]
    flat = (n_hypotheses, n_seen * n_contents)
    design = np.concatenate([rgb, np.ones((*rgb.shape[:3], 1))], axis=3).reshape(*flat, 4)
    noise = np.repeat(looks.variance @ (basis**2).T, n_contents, axis=0)
    variance = sigma[..., kinds].reshape(*flat, len(kinds)) ** 2 + noise
    mean, precision = _prior(looks.white_clipped, basis)
    outlier = _OUTLIER_SHARE[looks.n_corners]
    log_outlier = np.log(outlier) + _log_anything(len(kinds))
    log_inlier = np.log1p(-outlier)[:, None] + log_share

    def judge(coefficients: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the probability of each content (P, S, Q) and the log density (P, S)."""
        residual = _residuals(looks, basis, design @ np.swapaxes(coefficients, 1, 2))
        terms = (residual**2 / spread + np.log(2 * np.pi * spread)).sum(axis=2)
        density = log_inlier - 0.5 * terms.reshape(n_hypotheses, n_seen, n_contents)
        highest = np.maximum(density.max(axis=2), log_outlier)
        total = np.exp(density - highest[..., None]).sum(axis=2) + np.exp(log_outlier - highest)
        log_total = highest + np.log(total)
        return np.exp(density - log_total[..., None]), log_total

    coefficients = np.broadcast_to(mean, (n_hypotheses, *mean.shape))
    # At first M may be anything the prior allows.
    prior_spread = np.einsum("psi,kij,psj->psk", design, np.linalg.inv(precision), design)
    inlier, log_total = judge(coefficients, variance + prior_spread)
    rows = np.swapaxes(design, 1, 2)[:, None]
    normal = precision
    for _ in range(_ITERATIONS):
        expected = design @ np.swapaxes(coefficients, 1, 2)
        seen = expected + _residuals(looks, basis, expected)
        weights = np.swapaxes(inlier.reshape(*flat, 1) / variance, 1, 2)
        weighted = weights[:, :, None, :] * rows
        normal = weighted @ design[:, None] + precision
        right = (weighted @ np.swapaxes(seen, 1, 2)[..., None])[..., 0]
        right += np.einsum("kij,kj->ki", precision, mean)
        coefficients = np.linalg.solve(normal, right[..., None])[..., 0]
        inlier, log_total = judge(coefficients, variance)
    off = coefficients - mean
    log_prior = -0.5 * np.einsum("pki,kij,pkj->p", off, precision, off)
    volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(normal)[1]
    return log_total.sum(axis=1) + log_prior + 0.5 * volume.sum(axis=1), inlier.sum(axis=2)


def _log_anything(n_combinations: int) -> float:
    """Log density of a square that shows something else."""
    per_channel = -n_combinations * np.log(_OUTLIER_RANGE)
    return float(per_channel - (0.5 * np.log(3.0) if n_combinations == 1 else 0.0))


def _basis(n_channels: int) -> tuple[FloatArray, IntArray]:
    """Return the combinations of channels (K, C) and the kind of error that each has (K,)."""
    if n_channels == 1:
        return np.array([[np.sqrt(3.0)]]), np.array([0])
    return _OPPONENT, np.array([0, 1, 1])


def _prior(white_clipped: BoolArray, basis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (K, 4) and inverse covariance (K, 4, 4) of the rows [M, offset]."""
    n_channels = len(white_clipped)
    response = _MEAN_RESPONSE if n_channels == 3 else _MEAN_RESPONSE.mean(axis=0, keepdims=True)
    rows = np.zeros((n_channels, 4))
    rows[:, :3] = response * np.where(white_clipped, _CLIPPED_WHITE_GAIN, 1.0)[:, None]
    covariance = np.zeros((n_channels, 4, 4))
    ones = np.full((3, 3), 1 / 3)
    covariance[:, :3, :3] = _RESPONSE_SIGMA**2 * (np.eye(3) - ones) + _WHITE_SIGMA**2 / 3 * ones
    covariance[:, 3, 3] = _BLACK_SIGMA**2
    gain_sigma = np.where(white_clipped, _CLIPPED_GAIN_SIGMA, 0.0)[:, None, None]
    covariance += gain_sigma**2 * rows[:, :, None] * rows[:, None, :]
    mixed = np.einsum("kc,cij->kij", basis**2, covariance)
    return basis @ rows, np.linalg.inv(mixed)


def _residuals(looks: SquareLooks, basis: FloatArray, expected: FloatArray) -> FloatArray:
    """Seen minus expected, (P, S * Q, K); none where a channel at full scale expects more."""
    n_contents = expected.shape[1] // len(looks)
    seen = np.repeat(looks.levels, n_contents, axis=0)
    if not looks.clipped.any():
        return np.asarray(seen @ basis.T - expected)
    clipped = np.repeat(looks.clipped, n_contents, axis=0)
    difference = seen - expected @ np.linalg.inv(basis).T
    difference = np.where(clipped & (difference < 0), 0.0, difference)
    return np.asarray(difference @ basis.T)

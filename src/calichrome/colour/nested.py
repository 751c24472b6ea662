"""Nested linear hypotheses: whether colours need the wider one.

The one that matters most here: a matrix that keeps white. Colours over the white beside them are
free of exposure, white balance and the level of the light, so it is what a change of the light's
spectrum or of a camera's processing can still do to them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from calichrome.core.arrays import FloatArray

__all__ = ["WiderFit", "compare_nested", "white_keeping_matrix", "white_keeping_terms"]

_ROUNDS = 8  # of reweighting: weights settle to 1 %
_REDESCEND = 5.0  # robust sigmas beyond which a group counts no more
_MEDIAN_NORM = {1: 0.6745, 2: 1.1774, 3: 1.5382}
"""Median length of a vector of n standard normal numbers."""
_OFF_DIAGONAL = tuple((k, j) for k in range(3) for j in range(3) if j != k)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WiderFit:
    """What the wider hypothesis adds.

    Parameters
    ----------
    narrow : (Q,) float
        Coefficients of what both hypotheses hold.
    extra, extra_cov : (P,), (P, P) float
        Coefficients of what only the wider one holds, and their covariance by the scatter of the
        data about it.
    chance
        How often data of the narrow hypothesis look as much like the wider one; 1 with too few
        data.
    weights : (N,) float
        Of the groups: 1, or 0 for those that follow neither.
    """

    narrow: FloatArray
    extra: FloatArray
    extra_cov: FloatArray
    chance: float
    weights: FloatArray


def compare_nested(values: FloatArray, narrow: FloatArray, extra: FloatArray) -> WiderFit:
    """Fit groups of values by two hypotheses, and compare them by an F test.

    Parameters
    ----------
    values : (N, k) float
        In units in which all scatter alike; the scatter itself is told by the data. The k values of
        a group share one weight.
    narrow : (N, k, Q) float
        Terms of the narrow hypothesis.
    extra : (N, k, P) float
        Terms that the wider one adds.

    Notes
    -----
    Groups that follow neither hypothesis (a finger, gloss) are taken out by their distance from the
    wider one, so that they favour none.
    """
    n, k = values.shape
    n_narrow, n_extra = narrow.shape[2], extra.shape[2]
    both = np.concatenate([narrow, extra], axis=2)
    weights = np.ones(n)
    freedom = float(n * k - n_narrow - n_extra)
    if freedom < 1:
        nothing = np.zeros(n_extra)
        cov = np.full((n_extra, n_extra), np.inf)
        return WiderFit(
            narrow=np.zeros(n_narrow), extra=nothing, extra_cov=cov, chance=1.0, weights=weights
        )
    share = np.sqrt(n * k / freedom)  # the fit has taken its share of the scatter
    for _ in range(_ROUNDS):
        _, misfit = _solve(values, both, weights)
        norm = np.linalg.norm(misfit, axis=1)
        sigma = max(float(np.median(norm)) / _MEDIAN_NORM[k] * share, 1e-12)
        weights = np.maximum(1 - (norm / (_REDESCEND * sigma)) ** 2, 0) ** 2  # Tukey's biweight
    weights = np.where(weights > 0, 1.0, 0.0)  # or the F test would not hold
    solution, misfit = _solve(values, both, weights)
    _, misfit_narrow = _solve(values, narrow, weights)
    wide = float(weights @ (misfit**2).sum(axis=1))
    gained = float(weights @ (misfit_narrow**2).sum(axis=1)) - wide
    freedom = max(k * float(weights.sum()) - n_narrow - n_extra, 1.0)
    variance = max(wide / freedom, 1e-24)
    rows = (both * np.sqrt(weights)[:, None, None]).reshape(n * k, -1)
    cov = np.linalg.pinv(rows.T @ rows) * variance
    return WiderFit(
        narrow=solution[:n_narrow],
        extra=solution[n_narrow:],
        extra_cov=cov[n_narrow:, n_narrow:],
        chance=float(fdtrc(n_extra, freedom, max(gained, 0.0) / n_extra / variance)),
        weights=weights,
    )


def _solve(
    values: FloatArray, terms: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    root = np.sqrt(weights)[:, None]
    rows = (terms * root[..., None]).reshape(values.size, -1)
    solution = np.linalg.lstsq(rows, (values * root).ravel(), rcond=None)[0]
    return np.asarray(solution), np.asarray(values - terms @ solution)


def white_keeping_terms(balanced: FloatArray) -> FloatArray:
    """Return what the six directions of matrices that keep white do to balanced colours.

    Parameters
    ----------
    balanced : (n, 3) float
        White is 1, 1, 1.

    Returns
    -------
    (n, 3, 6) float
        Channel k changes by the difference between another channel and itself, for both others.
    """
    terms = np.zeros((len(balanced), 3, 6))
    for column, (channel, other) in enumerate(_OFF_DIAGONAL):
        terms[:, channel, column] = balanced[:, other] - balanced[:, channel]
    return terms


def white_keeping_matrix(coefficients: FloatArray) -> FloatArray:
    """Identity plus the directions of `white_keeping_terms` times (6,) coefficients, (3, 3)."""
    matrix = np.eye(3)
    for value, (channel, other) in zip(coefficients, _OFF_DIAGONAL, strict=True):
        matrix[channel, other] += value
        matrix[channel, channel] -= value
    return matrix

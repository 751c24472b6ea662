"""How likely each kind of tone curve is, and the best of its kind."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calichrome.colour.tone_problem import (
    CurveAt,
    ToneData,
    ToneEquations,
    ToneProblem,
    ToneScales,
)
from calichrome.colour.tone_spline import N_PARAMETERS
from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import levenberg_marquardt

__all__ = ["ToneFit", "fit_tones"]

_MISMATCH, _MISMATCH_WEIGHT = 0.006, 50.0
"""Prior of the relative mismatch of a grey with its nominal colour, and how many values it weighs
as. Set with the spectra of the ColorChecker on 8 cameras (of colour-science and rawtoaces) x D65,
A, FL2, D50: greys 0.005 to 0.0075."""

_DRIFT, _DRIFT_WEIGHT = 0.003, 10.0
"""Prior of the drift, and how many values it weighs as. Simulated boards with a known curve have
0.002 and less; the weight matters only where the light hardly changes."""

_BEND = 0.3  # start of the bends' scale: sRGB bends by less, film-like curves by more
_HUBER = 3.0  # sigmas
_LEAST_NOISE = 1e-4  # relative: no light is known better
_START_NOISE = 0.02  # relative, until the curve has found its place
_SETTLED = 0.01  # relative change of every scale that ends the search
_MAX_ROUNDS = 30
_STEPS = 4  # of Levenberg-Marquardt between two estimates of the scales
_MEDIAN_OF_CHI2 = 0.4549  # of one degree of freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToneFit:
    """The adjustment of one kind of curve.

    Parameters
    ----------
    curves : (3, P) float
        Parameters of the curve of each channel; P = 0 for a known one.
    covariance : (n_curves * P, n_curves * P) float
        Of the distinct curves.
    flare : (3,) float
        Light on everything, of the white's.
    drift
        Relative, of (1) of `tone_problem`, per e-fold of light.
    drift_noise : (3, K) float
        Standard deviations of the drifts as (1) alone tells them; infinite where it does not.
    mismatch
        Relative, of (2), for greys.
    evidence
        Logarithm of the probability of the data, up to a constant of the data (Laplace).
    """

    curves: FloatArray
    covariance: FloatArray
    flare: FloatArray
    drift: float
    drift_noise: FloatArray
    mismatch: float
    evidence: float


def fit_tones(data: ToneData, curve_at: CurveAt, n_curves: int) -> ToneFit | None:
    """Adjust everything for one kind of curve.

    Parameters
    ----------
    data
        What the camera saw.
    curve_at
        The kind: `spline_at`, or a known encoding.
    n_curves
        3: one for each channel; 1: one for all; 0: a known one.

    Returns
    -------
    ToneFit or None
        None if the data leave something open.

    Notes
    -----
    The scales (noise beyond what is stated, mismatch, bends, drift) are those of greatest marginal
    likelihood, by fixed-point steps: a group's sum of squares over its degrees of freedom [1]_.

    References
    ----------
    .. [1] S. N. Wood, M. Fasiolo, "A generalized Fellner-Schall method for smoothing parameter
       optimization", Biometrics 73 (4), 2017, pp. 1071-1081.
    """
    problem = ToneProblem(data, curve_at, n_curves)
    scales = ToneScales(noise=_START_NOISE, mismatch=_MISMATCH, bend=_BEND, drift=_DRIFT)
    state = problem.start()
    for round_ in range(_MAX_ROUNDS):
        before = scales
        problem.look(state)
        result = levenberg_marquardt(
            state, partial(problem.linearise, scales=scales), np.add, max_iterations=_STEPS
        )
        state = result.state
        inverse = _inverse(result.equations.hessian)
        if inverse is None:
            return None
        scales = _next_scales(problem, state, before, inverse)
        if round_ < 3:  # the noise shrinks slowly, so that (2) shows the way first
            scales = replace(scales, noise=max(scales.noise, before.noise / 2))
        if round_ > 3 and _alike(before, scales):
            break
    equations = problem.linearise(state, scales)
    inverse = _inverse(equations.hessian)
    if inverse is None:
        return None
    _, variances = problem.residuals(state, scales)
    n_own = n_curves * N_PARAMETERS
    layout = problem.layout
    return ToneFit(
        curves=np.array([state[layout.curve(channel)] for channel in range(3)]),
        covariance=inverse[:n_own, :n_own],
        flare=np.array([state[layout.mix(channel)][-1] for channel in range(3)]),
        drift=scales.drift,
        drift_noise=problem.drift_noise(variances),
        mismatch=scales.mismatch,
        evidence=_evidence(problem, equations, scales),
    )


def _inverse(hessian: FloatArray) -> FloatArray | None:
    """Invert by Cholesky, scaled to a unit diagonal; None if not positive definite."""
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    try:
        factor = cho_factor(hessian / np.outer(scale, scale))
    except LinAlgError:
        return None
    return np.asarray(cho_solve(factor, np.diag(1 / scale)) / scale[:, None])


def _next_scales(
    problem: ToneProblem, state: FloatArray, scales: ToneScales, inverse: FloatArray
) -> ToneScales:
    residuals, variances = problem.residuals(state, scales)
    z = np.abs(residuals) / np.sqrt(variances)
    problem.weights = np.minimum(1, _HUBER / np.maximum(z, 1e-9))
    free = max(1 - problem.layout.size / residuals.size, 0.2)
    beyond = residuals**2 / (_MEDIAN_OF_CHI2 * free) - (variances - scales.noise**2)
    noise = float(np.sqrt(max(np.median(beyond), _LEAST_NOISE**2)))

    tolerances = problem.tolerances(scales)
    share = (scales.mismatch * problem.looseness) ** 2 * problem.copies / tolerances**2
    squares, n_free = _MISMATCH_WEIGHT * (_MISMATCH / scales.mismatch) ** 2, _MISMATCH_WEIGHT
    for channel in range(3):
        off, level = problem.relation(state, channel)
        z = np.abs(off) / tolerances
        problem.mismatch_weights[channel] = np.minimum(1, _HUBER / np.maximum(z, 1e-9))
        jacobian = problem.relation_jacobian(channel, level)
        weight = problem.mismatch_weights[channel]
        hat = ((jacobian @ inverse) * jacobian).sum(axis=1) * weight / tolerances**2
        squares += float((share * weight * z**2 / problem.copies).sum())
        n_free += float((share * np.maximum(1 - hat, 0) / problem.copies).sum())
    mismatch = scales.mismatch * float(np.sqrt(squares / n_free))

    bends = problem.bends(state)
    used = len(bends) - float(problem.bends(np.diag(inverse)).sum()) / scales.bend**2
    ratio = 1.0 if not len(bends) else float(bends @ bends) / scales.bend**2 / max(used, 1e-3)
    bend = scales.bend * float(np.sqrt(np.clip(ratio, 0.25, 4)))  # a step at most doubles it

    squares, n_free = _DRIFT_WEIGHT * _DRIFT**2, _DRIFT_WEIGHT
    spread = np.diag(inverse)
    for channel in range(3):
        at = problem.layout.drift(channel)
        squares += float((state[at] ** 2).sum())
        n_free += float((1 - spread[at] / scales.drift**2).sum())
    drift = float(np.sqrt(squares / n_free))
    return ToneScales(
        noise=noise, mismatch=mismatch, bend=float(np.clip(bend, 1e-3, 10)), drift=drift
    )


def _alike(a: ToneScales, b: ToneScales) -> bool:
    pairs = ((a.noise, b.noise), (a.mismatch, b.mismatch), (a.bend, b.bend), (a.drift, b.drift))
    return all(abs(np.log(first / second)) < _SETTLED for first, second in pairs)


def _evidence(problem: ToneProblem, equations: ToneEquations, scales: ToneScales) -> float:
    tolerances = problem.tolerances(scales)
    _, precision = problem.priors(np.zeros(problem.layout.size), scales)
    log_prior = 0.5 * float(np.log(precision[precision > 0]).sum())
    log_prior -= _MISMATCH_WEIGHT * (
        float(np.log(scales.mismatch)) + 0.5 * (_MISMATCH / scales.mismatch) ** 2
    )
    log_prior -= _DRIFT_WEIGHT * (float(np.log(scales.drift)) + 0.5 * (_DRIFT / scales.drift) ** 2)
    sign, log_det = np.linalg.slogdet(equations.hessian)
    assert sign > 0  # noqa: S101 (it was inverted)
    return float(-equations.cost - 3 * float(np.log(tolerances).sum()) + log_prior - 0.5 * log_det)

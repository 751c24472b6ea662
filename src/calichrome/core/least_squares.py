"""A small dense Levenberg-Marquardt solver for states that are not vectors.

The caller says how a state is evaluated (residuals and Jacobian in a local step) and how a step
moves it, so rotations stay rotations and the same solver serves a camera, a pair and a board pose.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calichrome.core.arrays import FloatArray

__all__ = ["LeastSquaresResult", "covariance_from_jacobian", "levenberg_marquardt"]

State = TypeVar("State")
StopReason = Literal["cost", "step", "stalled", "iterations"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeastSquaresResult(Generic[State]):
    """The minimum and what is known about it.

    Parameters
    ----------
    state
        The state of least cost.
    residuals : (M,) float
        Weighted residuals there.
    jacobian : (M, P) float
        Derivative of the residuals by a local step.
    cost : float
        Half the sum of squared residuals.
    """

    state: State
    residuals: FloatArray
    jacobian: FloatArray
    cost: float
    n_iterations: int
    stop_reason: StopReason


def levenberg_marquardt(
    start: State,
    evaluate: Callable[[State], tuple[FloatArray, FloatArray]],
    move: Callable[[State, FloatArray], State],
    *,
    max_iterations: int = 100,
    relative_decrease: float = 1e-12,
) -> LeastSquaresResult[State]:
    """Minimise half the sum of squared residuals.

    Parameters
    ----------
    start
        First state.
    evaluate
        ``state -> (residuals (M,), jacobian (M, P))``. Residuals that are not finite mark a state
        as impossible (for example a point behind its camera); such a step is never taken.
    move
        ``(state, step (P,)) -> state``.
    max_iterations
        Trial steps, accepted or not.
    relative_decrease
        Stop when an accepted step lowers the cost by less than this share. The default leaves
        parameters exact to about 1e-6 of their sigma.

    Raises
    ------
    ValueError
        If the start itself is impossible.

    References
    ----------
    .. [1] D. W. Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear Parameters",
       SIAM J. Appl. Math. 11 (2), 1963 (damping scaled by the diagonal of J'J).
    .. [2] K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for Non-Linear Least Squares Problems",
       DTU, 2004, alg. 3.16 (how the damping follows the gain).
    """
    state = start
    residuals, jacobian = evaluate(state)
    if not np.isfinite(residuals).all():
        raise ValueError("least squares: the start has residuals that are not finite")
    cost = 0.5 * float(residuals @ residuals)
    damping, growth = 1e-4, 2.0
    stop_reason: StopReason = "iterations"
    iteration = 0
    for iteration in range(1, max_iterations + 1):  # noqa: B007 (reported after the loop)
        gradient = jacobian.T @ residuals
        hessian = jacobian.T @ jacobian
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        scaled = hessian / np.outer(scale, scale)
        try:
            factor = cho_factor(scaled + damping * np.eye(len(scaled)))
        except LinAlgError:
            damping, growth = damping * growth, growth * 2
            continue
        step = cho_solve(factor, -gradient / scale) / scale
        predicted = -float(step @ gradient) - 0.5 * float(np.sum((jacobian @ step) ** 2))
        if np.max(np.abs(step * scale)) <= 1e-9 * np.sqrt(2 * cost / max(len(residuals), 1)):
            stop_reason = "step"  # a billionth of the residual noise: nothing is left to gain
            break
        trial = move(state, step)
        trial_residuals, trial_jacobian = evaluate(trial)
        trial_cost = 0.5 * float(trial_residuals @ trial_residuals)
        if np.isfinite(trial_cost) and trial_cost < cost:
            gain = (cost - trial_cost) / max(predicted, 1e-300)
            small = cost - trial_cost <= relative_decrease * cost
            state, residuals, jacobian, cost = trial, trial_residuals, trial_jacobian, trial_cost
            damping = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-12)
            growth = 2.0
            if small:
                stop_reason = "cost"
                break
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                stop_reason = "stalled"  # rounding, not slope: no step of any length helps
                break
    return LeastSquaresResult(
        state=state,
        residuals=residuals,
        jacobian=jacobian,
        cost=cost,
        n_iterations=iteration,
        stop_reason=stop_reason,
    )


def covariance_from_jacobian(jacobian: FloatArray) -> FloatArray | None:
    """Return (J'J)^-1 for unit noise, or None where the data leave a direction open.

    The matrix is scaled to a unit diagonal before it is inverted: raw condition numbers of camera
    problems are 1e8 to 1e11 from units alone.
    """
    hessian = jacobian.T @ jacobian
    diagonal = np.diag(hessian)
    if not (diagonal > 0).all():
        return None
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    if values[0] <= len(values) * np.finfo(np.float64).eps * values[-1]:
        return None
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))

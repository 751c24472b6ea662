"""Levenberg-Marquardt for states that are not vectors and Hessians that are not matrices.

The caller says how a state is linearised and how a step moves it, so rotations stay rotations, and
the same loop serves a board pose (dense) and a rig of many cameras (blocks, see `geometry.bundle`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calichrome.core.arrays import FloatArray

__all__ = [
    "DenseEquations",
    "LeastSquaresResult",
    "NormalEquations",
    "Step",
    "covariance_from_jacobian",
    "damped_step",
    "inverse_of_scaled",
    "levenberg_marquardt",
]

State = TypeVar("State")
StopReason = Literal["cost", "step", "stalled", "iterations"]
_SMALLEST_STEP = 1e-9
"""Of the residual noise: when no residual would move by more, nothing is left to gain."""


_SHRINK = 1e-2
"""Of the damping, after a step that the quadratic model foresaw: with 1/10 a rig's weakest
directions kept it a sixth iteration from the minimum, with 1/100 to 1/1000 five are enough
(problems of benchmarks/solver)."""

_SHORT = 1.0
"""Damping from which steps are short because they failed, not because the minimum is near: beside a
wall of impossible states they end wherever the cost stands."""


class Step(NamedTuple):
    """A way to go.

    Parameters
    ----------
    vector : (P,) float
        Local step of all unknowns.
    predicted : float
        By how much the quadratic model lowers the cost.
    largest : float
        Largest component times the norm of its Jacobian column: how far the residuals move.
    """

    vector: FloatArray
    predicted: float
    largest: float


class NormalEquations(Protocol):
    """A state, linearised."""

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals; not finite where the state is impossible."""
        ...

    @property
    def n_residuals(self) -> int:
        """How many residuals the cost holds."""
        ...

    def step(self, damping: float) -> Step | None:
        """Solve (H + damping diag H) d = -g; None if that is not positive definite."""
        ...


Equations = TypeVar("Equations", bound=NormalEquations)


def damped_step(hessian: FloatArray, gradient: FloatArray, damping: float) -> Step | None:
    """Solve (H + damping diag H) d = -g, scaled to a unit diagonal.

    Parameters
    ----------
    hessian : (P, P) float
    gradient : (P,) float
    damping
        As in `NormalEquations.step`.

    Returns
    -------
    Step or None
        None if the matrix is not positive definite.
    """
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    try:
        factor = cho_factor(hessian / np.outer(scale, scale) + damping * np.eye(len(scale)))
    except LinAlgError:
        return None
    vector = cho_solve(factor, -gradient / scale) / scale
    predicted = -float(vector @ gradient) - 0.5 * float(vector @ hessian @ vector)
    return Step(vector, predicted, float(np.max(np.abs(vector * scale))))


@dataclass(frozen=True, slots=True, eq=False)
class DenseEquations:
    """Residuals (M,) and Jacobian (M, P) of a small problem."""

    residuals: FloatArray
    jacobian: FloatArray

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * float(self.residuals @ self.residuals)

    @property
    def n_residuals(self) -> int:
        """How many residuals there are."""
        return len(self.residuals)

    def step(self, damping: float) -> Step | None:
        """Solve the damped normal equations, scaled to a unit diagonal."""
        gradient = self.jacobian.T @ self.residuals
        return damped_step(self.jacobian.T @ self.jacobian, gradient, damping)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeastSquaresResult(Generic[State, Equations]):
    """The minimum and what is known about it.

    Parameters
    ----------
    state
        The state of least cost.
    equations
        Its linearisation.
    """

    state: State
    equations: Equations
    n_iterations: int
    stop_reason: StopReason

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return self.equations.cost


def levenberg_marquardt(
    start: State,
    linearise: Callable[[State], Equations],
    move: Callable[[State, FloatArray], State],
    *,
    max_iterations: int = 100,
    relative_decrease: float = 1e-12,
    foreseen: float = 1e-2,
    damping: float = 1e-4,
) -> LeastSquaresResult[State, Equations]:
    """Minimise half the sum of squared residuals.

    Parameters
    ----------
    start
        First state.
    linearise
        ``state -> normal equations``. A cost that is not finite marks a state as impossible (for
        example a point behind its camera); such a step is never taken.
    move
        ``(state, step (P,)) -> state``.
    max_iterations
        Trial steps, accepted or not.
    relative_decrease
        Stop when an accepted step lowers the cost by less than this share. The default leaves
        parameters exact to about 1e-6 of their sigma.
    foreseen
        Of `relative_decrease`: where even the quadratic model, exact near the minimum, foresees
        less, the trial is spared. With the defaults its cost would drown in rounding; 1 is for who
        needs the neighbourhood only.
    damping
        Of the first step; less for a start that is near the minimum.

    Raises
    ------
    ValueError
        If the start itself is impossible.

    References
    ----------
    .. [1] D. W. Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear Parameters",
       SIAM J. Appl. Math. 11 (2), 1963 (damping scaled by the diagonal of J'J; a hundredth
       of it after a step that the quadratic model foresaw).
    .. [2] K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for Non-Linear Least Squares Problems",
       DTU, 2004, alg. 3.16 (how the damping grows while steps fail).
    """
    state, equations = start, linearise(start)
    if not np.isfinite(equations.cost):
        raise ValueError("least squares: the start has residuals that are not finite")
    growth = 2.0
    stop_reason: StopReason = "iterations"
    iteration = 0
    for iteration in range(1, max_iterations + 1):  # noqa: B007 (reported after the loop)
        step = equations.step(damping)
        if step is None:
            damping, growth = damping * growth, growth * 2
            continue
        noise = np.sqrt(2 * equations.cost / max(equations.n_residuals, 1))
        if step.largest <= _SMALLEST_STEP * noise:
            stop_reason = "step"
            break
        if step.predicted <= foreseen * relative_decrease * equations.cost:
            stop_reason = "cost"
            break
        trial_state = move(state, step.vector)
        trial = linearise(trial_state)
        if np.isfinite(trial.cost) and trial.cost < equations.cost:
            decrease = equations.cost - trial.cost
            gain = decrease / max(step.predicted, 1e-300)
            small = decrease <= relative_decrease * equations.cost
            state, equations = trial_state, trial
            damping = max(damping * max(_SHRINK, 1 - (2 * gain - 1) ** 3), 1e-12)
            growth = 2.0
            if small:
                stop_reason = "cost"
                break
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                stop_reason = "stalled"  # rounding, not slope: no step of any length helps
                break
    if stop_reason != "iterations" and damping > _SHORT:
        stop_reason = "stalled"
    return LeastSquaresResult(
        state=state, equations=equations, n_iterations=iteration, stop_reason=stop_reason
    )


def covariance_from_jacobian(jacobian: FloatArray) -> FloatArray | None:
    """Return (J'J)^-1 for unit noise, or None where the data leave a direction open."""
    return inverse_of_scaled(jacobian.T @ jacobian)


def inverse_of_scaled(hessian: FloatArray) -> FloatArray | None:
    """Invert a positive definite (P, P), or return None where it is singular to rounding.

    The matrix is scaled to a unit diagonal before it is inverted: raw condition numbers of camera
    problems are 1e8 to 1e11 from units alone.
    """
    diagonal = np.diag(hessian)
    if not (diagonal > 0).all():
        return None
    if not len(diagonal):
        return hessian
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    if values[0] <= len(values) * np.finfo(np.float64).eps * values[-1]:
        return None
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))

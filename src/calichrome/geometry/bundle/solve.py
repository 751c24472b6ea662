"""The least-squares solution of a bundle."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import LeastSquaresResult, levenberg_marquardt
from calichrome.geometry.bundle.blocks import chunk_residuals, residual_cost, view_blocks
from calichrome.geometry.bundle.equations import BundleEquations
from calichrome.geometry.bundle.observations import Observations
from calichrome.geometry.bundle.state import BundleState, Free, Priors

__all__ = ["BundleResult", "BundleStep", "residuals_px", "solve_bundle", "step_bundle"]

BundleResult = LeastSquaresResult[BundleState, BundleEquations]


@dataclass(frozen=True, slots=True, eq=False)
class _Bundle:
    """What a bundle is linearised with."""

    observations: Observations
    free: Free
    priors: Priors | None
    huber: float | None

    def linearise(self, state: BundleState) -> BundleEquations:
        blocks = view_blocks(self.observations, state, self.huber)
        return BundleEquations(self.observations, state, self.free, blocks, self.priors)


def solve_bundle(
    observations: Observations,
    start: BundleState,
    free: Free,
    *,
    priors: Priors | None = None,
    huber: float | None = None,
    max_iterations: int = 100,
    relative_decrease: float = 1e-10,
    foreseen: float = 1e-2,
    damping: float = 1e-4,
) -> BundleResult:
    """Minimise the whitened reprojection error of all views together.

    Parameters
    ----------
    observations, start
        What was seen, and where to begin.
    free
        What may move beside the boards.
    priors
        Knowledge from elsewhere; None: none.
    huber
        See `view_blocks`.
    max_iterations, relative_decrease, foreseen, damping
        See `levenberg_marquardt`.

    Raises
    ------
    ValueError
        If `start` puts a board behind a camera that sees it.
    """
    bundle = _Bundle(observations, free, priors, huber)
    with np.errstate(invalid="ignore", over="ignore"):  # of impossible trial states
        return levenberg_marquardt(
            start,
            bundle.linearise,
            BundleState.moved,
            max_iterations=max_iterations,
            relative_decrease=relative_decrease,
            foreseen=foreseen,
            damping=damping,
        )


@dataclass(frozen=True, slots=True, eq=False)
class BundleStep:
    """One step of `step_bundle`.

    Parameters
    ----------
    state
        Where it leads; the start if that is nowhere better.
    is_better
        Whether it was taken.
    residuals
        There, as `chunk_residuals` returns them.
    equations
        Of the start.
    """

    state: BundleState
    is_better: bool
    residuals: list[FloatArray]
    equations: BundleEquations


def step_bundle(
    observations: Observations,
    start: BundleState,
    free: Free,
    *,
    priors: Priors | None = None,
    huber: float | None = None,
    damping: float,
) -> BundleStep:
    """Take one step and linearise nothing at its end.

    Half the price of one iteration of `solve_bundle`, which tells the parameters.
    """
    equations = _Bundle(observations, free, priors, huber).linearise(start)
    step = equations.step(damping)
    if step is not None:
        end = start.moved(step.vector)
        with np.errstate(invalid="ignore", over="ignore"):  # of an impossible end
            residuals = chunk_residuals(observations, end)
            cost = residual_cost(observations, residuals, huber)
        if priors is not None:
            deviation, _ = priors.pull(end)
            cost += 0.5 * float(deviation @ deviation)
        if cost < equations.cost:
            return BundleStep(end, is_better=True, residuals=residuals, equations=equations)
    residuals = chunk_residuals(observations, start)
    return BundleStep(start, is_better=False, residuals=residuals, equations=equations)


def residuals_px(observations: Observations, state: BundleState) -> list[FloatArray]:
    """Projected minus observed corners (N, 2) of each view, pixels, in the order packed."""
    return observations.by_view(chunk_residuals(observations, state))

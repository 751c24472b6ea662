"""Levenberg-Marquardt finds known minima, and the covariance is the inverse of J'J."""

from functools import partial

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import (
    DenseEquations,
    covariance_from_jacobian,
    levenberg_marquardt,
)


def _add(state: FloatArray, step: FloatArray) -> FloatArray:
    return state + step


def _linear(matrix: FloatArray, side: FloatArray, x: FloatArray) -> DenseEquations:
    return DenseEquations(matrix @ x - side, matrix)


@pytest.mark.parametrize("units", [1.0, 1e4])
def test_linear_problems_end_at_the_closed_form(units: float, rng: np.random.Generator) -> None:
    for _ in range(20):
        scale = units ** rng.uniform(-1, 1, 6)
        matrix, side = rng.normal(size=(40, 6)) * scale, rng.normal(size=40)
        result = levenberg_marquardt(np.zeros(6), partial(_linear, matrix, side), _add)
        expected, *_ = np.linalg.lstsq(matrix, side, rcond=None)
        sigma = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
        # the promise of the default: exact to about 1e-6 sigma; unit noise
        np.testing.assert_allclose(result.state / sigma, expected / sigma, atol=2e-6)
        assert result.cost == pytest.approx(0.5 * ((matrix @ expected - side) ** 2).sum())
        assert result.stop_reason in {"cost", "step"}


def _rosenbrock(x: FloatArray) -> DenseEquations:
    residuals = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
    return DenseEquations(residuals, np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]))


@pytest.mark.parametrize("start", [(-1.2, 1.0), (5.0, -7.0), (0.0, 0.0)])
def test_minimum_of_rosenbrock(start: tuple[float, float]) -> None:
    """H. H. Rosenbrock, "An Automatic Method for Finding the Greatest or Least Value", 1960."""
    result = levenberg_marquardt(np.array(start), _rosenbrock, _add)
    np.testing.assert_allclose(result.state, 1, atol=1e-7)  # cost 0: the end is quadratic
    assert result.cost < 1e-14
    assert result.n_iterations < 60


def test_reports_when_it_ran_out_of_iterations() -> None:
    result = levenberg_marquardt(np.array([-1.2, 1.0]), _rosenbrock, _add, max_iterations=9)
    assert (result.stop_reason, result.n_iterations) == ("iterations", 9)
    assert result.cost < 0.5 * (_rosenbrock(np.array([-1.2, 1.0])).residuals ** 2).sum()


def test_impossible_start_is_refused() -> None:
    def evaluate(x: FloatArray) -> DenseEquations:
        return DenseEquations(np.array([np.nan, x[0]]), np.ones((2, 1)))

    with pytest.raises(ValueError, match="start has residuals that are not finite"):
        levenberg_marquardt(np.zeros(1), evaluate, _add)


def test_never_steps_where_residuals_are_not_finite() -> None:
    """sqrt(x) = 0.1 from x = 4: the first Gauss-Newton steps lead below zero."""
    seen: list[float] = []

    def evaluate(x: FloatArray) -> DenseEquations:
        seen.append(float(x[0]))
        root = np.sqrt(x) if x[0] > 0 else np.full(1, np.nan)
        return DenseEquations(root - 0.1, (0.5 / root)[:, None])

    result = levenberg_marquardt(np.array([4.0]), evaluate, _add)
    assert min(seen) <= 0  # it was tempted
    assert result.state[0] == pytest.approx(0.01, rel=1e-6)


def test_cost_never_rises() -> None:
    costs: list[float] = []

    def move(x: FloatArray, step: FloatArray) -> FloatArray:
        costs.append(float((_rosenbrock(x).residuals ** 2).sum()))  # of the state it moves from
        return x + step

    levenberg_marquardt(np.array([-1.2, 1.0]), _rosenbrock, move)
    assert len(costs) > 5
    assert (np.diff(costs) <= 0).all()


def test_covariance_is_the_pseudo_inverse(rng: np.random.Generator) -> None:
    units = 10.0 ** np.array([-4, -2, 0, 2, 4])  # as of focal lengths and k3: condition 1e16
    jacobian = rng.normal(size=(50, 5))
    found = covariance_from_jacobian(jacobian * units)
    assert found is not None
    expected = np.linalg.pinv(jacobian.T @ jacobian)
    np.testing.assert_allclose(found * np.outer(units, units), expected, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("kind", ["zero column", "twice the same", "fewer rows"])
def test_covariance_is_unknown_where_a_direction_is_open(
    kind: str, rng: np.random.Generator
) -> None:
    jacobian = rng.normal(size=(3 if kind == "fewer rows" else 50, 5))
    if kind == "zero column":
        jacobian[:, 2] = 0
    if kind == "twice the same":
        jacobian[:, 4] = 1e6 * jacobian[:, 1]
    assert covariance_from_jacobian(jacobian) is None

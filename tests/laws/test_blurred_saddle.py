"""The model of a corner is a convolution: checked against the normal distribution itself."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from calichrome.core.arrays import FloatArray
from calichrome.detection.blurred_saddle import (
    N_PARAMETERS,
    SaddleParameters,
    saddle_and_derivatives,
)

_TYPICAL = [0.2, -0.1, 0.3, 1.6, 0.1, 0.5, 0.3, 1e-3, -2e-3, 2e-3, 1e-3, 2e-3, -3e-3]


def _value(parameters: FloatArray, points: FloatArray) -> FloatArray:
    corner = np.zeros(len(points), dtype=np.int64)
    return saddle_and_derivatives(SaddleParameters(parameters[None]), corner, points, 7)[0]


@pytest.mark.parametrize("between_deg", [90, 60, 120, 30, 155])
def test_equals_the_bivariate_normal_distribution(
    between_deg: float, rng: np.random.Generator
) -> None:
    angle, sigma = 0.4, 1.3
    parameters = np.zeros(N_PARAMETERS)
    parameters[2:4] = angle, angle + np.deg2rad(between_deg)
    parameters[4], parameters[6] = np.log(sigma), 1.0
    points = rng.uniform(-3, 3, (40, 2))
    normals = np.stack([np.cos(parameters[2:4]), np.sin(parameters[2:4])], axis=1)
    h, k = normals @ points.T / sigma
    rho = float(normals[0] @ normals[1])
    both = multivariate_normal(cov=[[1, rho], [rho, 1]], abseps=1e-10, releps=1e-10)
    expected = [
        4 * both.cdf([a, b]) - 2 * norm.cdf(a) - 2 * norm.cdf(b) + 1
        for a, b in zip(h, k, strict=True)
    ]
    np.testing.assert_allclose(_value(parameters, points), expected, atol=1e-4)


def test_derivatives_are_those_of_the_value(rng: np.random.Generator) -> None:
    parameters = np.array([_TYPICAL, np.array(_TYPICAL) * [1, 1, 2, 1, 2, 1, -1, *[1] * 6]])
    corner = rng.integers(0, 2, 300)
    points = rng.uniform(-8, 8, (300, 2))
    _, derivatives = saddle_and_derivatives(
        SaddleParameters(parameters), corner, points, N_PARAMETERS
    )
    for index in range(N_PARAMETERS):
        step = np.zeros(N_PARAMETERS)
        step[index] = 1e-6
        ahead, behind = (
            saddle_and_derivatives(SaddleParameters(parameters + sign * step), corner, points, 7)[0]
            for sign in (1, -1)
        )
        # the part beyond 4.5 sigma of an edge is cut off: 7e-6 of a step
        np.testing.assert_allclose(derivatives[index], (ahead - behind) / 2e-6, atol=5e-5)


def test_without_odd_terms_it_is_even(rng: np.random.Generator) -> None:
    parameters = np.array(_TYPICAL)
    parameters[7:] = 0
    offsets = rng.uniform(-6, 6, (50, 2))
    at = parameters[:2]
    np.testing.assert_allclose(
        _value(parameters, at + offsets), _value(parameters, at - offsets), atol=1e-12
    )


def test_far_from_one_edge_the_other_is_a_blurred_step() -> None:
    parameters = np.zeros(N_PARAMETERS)
    parameters[3], parameters[4], parameters[6] = np.pi / 2, np.log(0.8), 1.0
    x = np.linspace(-3, 3, 31)
    points = np.stack([x, np.full(31, 9.0)], axis=1)
    np.testing.assert_allclose(_value(parameters, points), 2 * norm.cdf(x / 0.8) - 1, atol=1e-5)

"""Filter and smoother against the batch solution, and against motion that they describe."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.tracking.motion import Gaussian, predict, smooth, update

_TIMES = np.array([0.0, 0.1, 0.15, 0.3, 0.5, 0.6])


def _batch(
    times_s: FloatArray, information: FloatArray, vectors: FloatArray, density: float
) -> tuple[FloatArray, FloatArray]:
    """All states (T, 6, 1 + K) by one weighted least squares over everything."""
    n = len(times_s)
    normal = np.zeros((6 * n, 6 * n))
    right = np.zeros((6 * n, vectors.shape[2]))
    start = Gaussian.diffuse(np.zeros(3)).cov
    normal[:6, :6] += np.linalg.inv(start)
    for k in range(n):
        normal[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] += information[k]
        right[6 * k : 6 * k + 3] += vectors[k]
        if k:
            t = times_s[k] - times_s[k - 1]
            step = np.block([[np.eye(3), t * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
            noise = density * np.block(
                [[t**3 / 3 * np.eye(3), t**2 / 2 * np.eye(3)],
                 [t**2 / 2 * np.eye(3), t * np.eye(3)]]
            )  # fmt: skip
            link = np.zeros((6, 6 * n))
            link[:, 6 * k : 6 * k + 6] = np.eye(6)
            link[:, 6 * k - 6 : 6 * k] = -step
            normal += link.T @ np.linalg.inv(noise) @ link
    cov = np.linalg.inv(normal)
    blocks = np.stack([cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(n)])
    return (cov @ right).reshape(n, 6, -1), blocks


def _measurements(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Information of one view (depth open), of none, and of several."""
    slopes = rng.normal(size=(6, 4, 3)) * 100
    slopes[1, 2:] = 0
    slopes[3] = 0
    information = slopes.swapaxes(1, 2) @ slopes
    return information, slopes.swapaxes(1, 2) @ rng.normal(size=(6, 4, 3))


def test_smoother_is_least_squares_over_everything(rng: np.random.Generator) -> None:
    information, vectors = _measurements(rng)
    expected, cov = _batch(_TIMES, information, vectors, 2.0)
    found = smooth(_TIMES, information, vectors, 2.0)
    np.testing.assert_allclose(
        found.mean, expected, rtol=1e-5, atol=1e-6
    )  # the start of 1 km costs digits
    np.testing.assert_allclose(found.cov, cov, rtol=1e-5, atol=1e-6)


def test_last_filtered_state_is_the_smoothed_one(rng: np.random.Generator) -> None:
    information, vectors = _measurements(rng)
    state = Gaussian.diffuse(np.zeros(3), 2)
    for k in range(6):
        if k:
            state = predict(state, _TIMES[k] - _TIMES[k - 1], 2.0)
        state = update(state, information[k], vectors[k])
    found = smooth(_TIMES, information, vectors, 2.0)
    np.testing.assert_allclose(found.mean[-1], state.mean, atol=1e-9)


def test_a_lasting_bias_passes_unchanged() -> None:
    """Where every measurement is off by the same, so is every place, and no speed is."""
    information = np.tile(1e4 * np.eye(3), (6, 1, 1))
    bias = information @ np.array([[1.0], [0.0], [0.0]])
    vectors = np.concatenate([np.zeros((6, 3, 1)), bias], axis=2)
    found = smooth(_TIMES, information, vectors, 1.0)
    np.testing.assert_allclose(found.mean[:, 0, 1], 1, atol=1e-5)  # but for the start's 1 km
    np.testing.assert_allclose(found.mean[:, 3, 1], 0, atol=1e-5)


@pytest.mark.parametrize("density", [0.1, 3.0])
def test_errors_scatter_as_the_covariance_says(rng: np.random.Generator, density: float) -> None:
    times_s = np.arange(40) / 30
    step = np.block([[np.eye(3), np.eye(3) / 30], [np.zeros((3, 3)), np.eye(3)]])
    root = np.linalg.cholesky(
        density
        * np.block([[np.eye(3) / 30**3 / 3, np.eye(3) / 30**2 / 2],
                    [np.eye(3) / 30**2 / 2, np.eye(3) / 30]])
    )  # fmt: skip
    sigma, squares = 2e-3, []
    for _ in range(60):
        state, truth = rng.normal(size=6), []
        for _ in times_s:
            truth.append(state)
            state = step @ state + root @ rng.normal(size=6)
        information = np.tile(np.eye(3) / sigma**2, (40, 1, 1))
        seen = np.array(truth)[:, :3] + rng.normal(0, sigma, (40, 3))
        found = smooth(times_s, information, seen[..., None] / sigma**2, density)
        error = found.mean[20, :, 0] - truth[20]
        squares.append(error @ np.linalg.solve(found.cov[20], error))
    # 60 draws of 6 degrees of freedom: 6 +- 0.45
    assert np.mean(squares) == pytest.approx(6, abs=1.8)

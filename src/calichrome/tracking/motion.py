"""Constant velocity with white-noise acceleration: filter, smoother, and what they do to biases.

A state is position and velocity (6,). A measurement at one instant is given as information: a
matrix (3, 3) about the position and a vector (3, 1 + K), whose first column is the data and whose
others are its derivatives by K parameters that stay the same over time, such as those of the
cameras. Filter and smoother are linear in the vector, so the derivatives pass through the same
gains; information serves one view, which leaves the depth open, as well as many.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["Gaussian", "Smoothed", "minus_log_likelihood", "predict", "smooth", "update"]

_PLACE_SIGMA_M = 1e3  # before the first measurement: nothing is known ...
_SPEED_SIGMA_M_S = 10.0  # ... of the place, and hardly more of the speed
_UP_RIGHT, _PLACE, _SPEED, _CROSS = (
    np.kron(np.array(blocks, dtype=np.float64), np.eye(3))
    for blocks in ([[0, 1], [0, 0]], [[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [1, 0]])
)


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """A state.

    Parameters
    ----------
    mean : (6, 1 + K) float, metres and metres per second
        First column: the state; others: its derivatives.
    cov : (6, 6) float
    """

    mean: FloatArray
    cov: FloatArray

    @classmethod
    def diffuse(cls, position_m: FloatArray, n_parameters: int = 0) -> "Gaussian":
        """Return what is known before the first measurement; `position_m` is where to start."""
        mean = np.zeros((6, 1 + n_parameters))
        mean[:3, 0] = position_m
        return cls(mean, np.diag([_PLACE_SIGMA_M**2] * 3 + [_SPEED_SIGMA_M_S**2] * 3))

    @property
    def position_m(self) -> FloatArray:
        """Where, (3,), metres."""
        return self.mean[:3, 0]

    @property
    def velocity_m_s(self) -> FloatArray:
        """How fast, (3,), metres per second."""
        return self.mean[3:, 0]


def _transition(interval_s: float) -> tuple[FloatArray, FloatArray]:
    """F (6, 6), and Q (6, 6) of a unit power density of the acceleration.

    References
    ----------
    .. [1] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
       Navigation", 2001, sec. 6.2.2 (continuous white-noise acceleration model).
    """
    t = interval_s
    return np.eye(6) + t * _UP_RIGHT, t**3 / 3 * _PLACE + t**2 / 2 * _CROSS + t * _SPEED


def predict(state: Gaussian, interval_s: float, density: float) -> Gaussian:
    """Move a state on.

    Parameters
    ----------
    state
        Now.
    interval_s
        Seconds.
    density : float, m^2/s^3
        Power density of the acceleration: the velocity spreads by sqrt(density * interval_s).
    """
    step, noise = _transition(interval_s)
    return Gaussian(step @ state.mean, step @ state.cov @ step.T + density * noise)


def update(state: Gaussian, information: FloatArray, vector: FloatArray) -> Gaussian:
    """Use one measurement of the position: information (3, 3) and vector (3, 1 + K).

    With P the covariance of the position, ``(P^-1 + L)^-1 = P - P (1 + L P)^-1 L P`` for any
    information L, also one that leaves directions open.
    """
    shared = state.cov[:, :3]
    gain = shared @ np.linalg.inv(np.eye(3) + information @ state.cov[:3, :3])
    mean = state.mean + gain @ (vector - information @ state.mean[:3])
    cov = state.cov - gain @ information @ shared.T
    return Gaussian(mean, (cov + cov.T) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """All states of a track from all its measurements.

    Parameters
    ----------
    mean : (T, 6, 1 + K) float
    cov : (T, 6, 6) float
    """

    mean: FloatArray
    cov: FloatArray


def _forward(
    times_s: Sequence[float] | FloatArray,
    information: FloatArray,
    vectors: FloatArray,
    density: float,
) -> tuple[list[Gaussian], list[Gaussian]]:
    """Predicted and updated states."""
    state = Gaussian.diffuse(np.zeros(3), vectors.shape[2] - 1)
    predicted, updated = [], []
    for index, (matrix, vector) in enumerate(zip(information, vectors, strict=True)):
        if index:
            state = predict(state, float(times_s[index] - times_s[index - 1]), density)
        predicted.append(state)
        state = update(state, matrix, vector)
        updated.append(state)
    return predicted, updated


def smooth(
    times_s: FloatArray, information: FloatArray, vectors: FloatArray, density: float
) -> Smoothed:
    """Estimate every state of a track from all its measurements.

    Parameters
    ----------
    times_s : (T,) float
        Increasing.
    information : (T, 3, 3) float
        Zero where nothing was measured.
    vectors : (T, 3, 1 + K) float
    density : float, m^2/s^3

    References
    ----------
    .. [1] H. E. Rauch, F. Tung, C. T. Striebel, "Maximum Likelihood Estimates of Linear Dynamic
       Systems", AIAA Journal 3 (8), 1965, pp. 1445-1450.
    """
    predicted, updated = _forward(times_s, information, vectors, density)
    mean, cov = updated[-1].mean, updated[-1].cov
    means, covs = [mean], [cov]
    for index in range(len(updated) - 2, -1, -1):
        step, _ = _transition(float(times_s[index + 1] - times_s[index]))
        ahead = predicted[index + 1]
        gain = np.linalg.solve(ahead.cov, step @ updated[index].cov).T
        mean = updated[index].mean + gain @ (mean - ahead.mean)
        cov = updated[index].cov + gain @ (cov - ahead.cov) @ gain.T
        means.append(mean)
        covs.append((cov + cov.T) / 2)
    return Smoothed(np.stack(means[::-1]), np.stack(covs[::-1]))


def minus_log_likelihood(
    times_s: FloatArray,
    information: FloatArray,
    vectors: FloatArray,
    density: float,
    *,
    complete: BoolArray,
) -> float:
    """Return how unlikely the measurements of a track are, but for a constant.

    Parameters
    ----------
    times_s, information, vectors, density
        As in `smooth`.
    complete : (T,) bool
        Where the information has full rank, so that there is a position to compare with.

    Notes
    -----
    The sum over all innovations v, of covariance S, of ``(v' S^-1 v + log det S) / 2``. The first
    two measurements only start the filter and are left out.
    """
    predicted, _ = _forward(times_s, information, vectors[:, :, :1], density)
    total = 0.0
    for index in np.flatnonzero(complete)[2:]:
        noise = np.linalg.inv(information[index])
        error = noise @ vectors[index, :, 0] - predicted[index].position_m
        spread = predicted[index].cov[:3, :3] + noise
        total += float(error @ np.linalg.solve(spread, error) + np.linalg.slogdet(spread)[1]) / 2
    return total

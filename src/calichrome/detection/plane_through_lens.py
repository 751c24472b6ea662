"""A plane seen through a lens, as a vector of parameters: values, derivatives and their fit.

Parameters, all in normalised coordinates: the homography h00..h21 (h22 = 1), radial terms k1 and
k2, their centre (x, y), and the x and y coefficients of the monomials of degree 2 and more:

    ideal = H lattice,  away = ideal - centre,
    picture = ideal + away (k1 r^2 + k2 r^4) + polynomial(lattice).
"""

import math
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import fit_homography

__all__ = ["N_LENS", "PlaneFit", "design", "fit_plane", "project"]

N_LENS = 12
"""Parameters without the polynomial."""

_PRIOR_TERM = 0.5
"""Sigma of k1, k2 and the polynomial's terms with radii in half diagonals of the picture: k1 = -0.4
at a focal length of the picture's width is -0.16 in this unit."""
_PRIOR_CENTRE = 0.1
"""Sigma of the centre of distortion in half diagonals: 6 % of the width of a 4:3 picture."""
_DEGREES = (2, 3, 4)  # of the polynomial, if there is one; 1 is the homography's
_RESIDUALS_PER_PARAMETER = 2  # at least, for a polynomial; fewer would follow the noise
_LENS_STEPS = 5
_JOINT_STEPS = 2
_CONVERGED = 2.0  # times the squares that the first linear step promised
_LEAST_NOISE = 1e-3  # px, where nothing is known and nothing is left
_DAMPING = 1e-12  # of a unit diagonal: what rounding leaves open stays where it is


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """Parameters (P,) with their covariance for unit noise.

    `squares` is the sum of squared whitened residuals, `used` the number of parameters that the
    data and not the priors determine.
    """

    theta: FloatArray
    covariance: FloatArray
    squares: float
    used: float


def project(theta: FloatArray, lattice: FloatArray) -> FloatArray:
    """Map normalised lattice points (N, 2) to normalised pixels (N, 2)."""
    ideal, away, r2, _ = _lens(theta, lattice)
    picture = ideal + away * (r2 * (theta[8] + theta[9] * r2))[:, None]
    coefficients = theta[N_LENS:].reshape(-1, 2)
    if len(coefficients):
        picture = picture + _monomials(lattice, len(coefficients)) @ coefficients
    return np.asarray(picture)


def design(theta: FloatArray, lattice: FloatArray) -> FloatArray:
    """Differentiate `project` by the parameters, (N, 2, P)."""
    ideal, away, r2, weight = _lens(theta, lattice)
    count = len(lattice)
    outer = away[:, :, None] * away[:, None, :]
    slope = theta[8] + 2 * theta[9] * r2  # of r^2 (k1 + k2 r^2) by r^2
    stretch = r2 * (theta[8] + theta[9] * r2)
    radial = stretch[:, None, None] * np.eye(2) + 2 * slope[:, None, None] * outer
    row = np.concatenate([lattice, np.ones((count, 1))], axis=1) / weight[:, None]
    by_ideal = np.zeros((count, 2, 8))
    by_ideal[:, 0, 0:3] = row
    by_ideal[:, 1, 3:6] = row
    by_ideal[:, :, 6:8] = -ideal[:, :, None] * row[:, None, 0:2]
    derivative = np.zeros((count, 2, len(theta)))
    derivative[:, :, :8] = (np.eye(2) + radial) @ by_ideal
    derivative[:, :, 8] = away * r2[:, None]
    derivative[:, :, 9] = away * (r2 * r2)[:, None]
    derivative[:, :, 10:12] = -radial
    n_terms = (len(theta) - N_LENS) // 2
    if n_terms:
        terms = _monomials(lattice, n_terms)
        derivative[:, 0, N_LENS::2] = terms
        derivative[:, 1, N_LENS + 1 :: 2] = terms
    return derivative


def fit_plane(
    lattice: FloatArray, picture: FloatArray, whitening: FloatArray, *, known_noise: bool
) -> PlaneFit:
    """Fit points, robustly, with the polynomial of least Bayesian information criterion.

    Parameters
    ----------
    lattice, picture : (N, 2) float
        Normalised, N >= 4.
    whitening : (N, 2, 2) float
        Turns residuals into unit noise, or into pixels if the noise is not known.
    known_noise
        Whether residuals are to be judged by the noise or by each other.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the Dimension of a Model", Ann. Statist. 6 (2), 1978.
    """
    theta = np.concatenate([fit_homography(lattice, picture).ravel()[:8], np.zeros(4)])
    for step in range(_LENS_STEPS):
        if step == _LENS_STEPS // 2:
            whitening = whitening * _robust_weights(theta, lattice, picture, whitening)
        theta = _step(theta, lattice, picture, whitening, known_noise=known_noise).theta
    lens = best = _step(theta, lattice, picture, whitening, known_noise=known_noise)
    for degree in _DEGREES:
        n_parameters = N_LENS + (degree + 1) * (degree + 2) - 6
        if picture.size < _RESIDUALS_PER_PARAMETER * n_parameters:
            break
        start = np.concatenate([theta, np.zeros(n_parameters - N_LENS)])
        fit = _step(start, lattice, picture, whitening, known_noise=known_noise)
        if _criterion(fit, picture.size, known_noise) < _criterion(best, picture.size, known_noise):
            best = fit
    if best is lens:
        return lens
    # Homography and polynomial trade large amounts, past one linear step.
    promised = best.squares
    for _ in range(_JOINT_STEPS):
        best = _step(best.theta, lattice, picture, whitening, known_noise=known_noise)
    return best if best.squares <= _CONVERGED * promised else lens


def _lens(
    theta: FloatArray, lattice: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    weight = lattice @ theta[6:8] + 1
    ideal = (lattice @ theta[[[0, 3], [1, 4]]] + theta[[2, 5]]) / weight[:, None]
    away = ideal - theta[10:12]
    return ideal, away, (away * away).sum(axis=1), weight


def _monomials(lattice: FloatArray, count: int) -> FloatArray:
    """Return x^2, x y, y^2, x^3, ... at points (N, 2): the first `count`, (N, count)."""
    x, y = lattice.T
    terms: list[FloatArray] = []
    degree = 2
    while len(terms) < count:
        terms += [x ** (degree - power) * y**power for power in range(degree + 1)]
        degree += 1
    return np.stack(terms[:count], axis=1)


def _robust_weights(
    theta: FloatArray, lattice: FloatArray, picture: FloatArray, whitening: FloatArray
) -> FloatArray:
    """Return weights (N, 1, 1) of residuals: 1 up to 4 sigma, falling with the square beyond."""
    residuals = (whitening @ (picture - project(theta, lattice))[..., None])[..., 0]
    size = np.linalg.norm(residuals, axis=1)
    sigma = float(np.median(size)) / np.sqrt(2 * np.log(2))  # median of a Rayleigh distribution
    return np.asarray(1 / np.maximum(1, size / max(4 * sigma, 1e-12)) ** 2)[:, None, None]


def _step(
    theta: FloatArray,
    lattice: FloatArray,
    picture: FloatArray,
    whitening: FloatArray,
    *,
    known_noise: bool,
) -> PlaneFit:
    """Take one Gauss-Newton step; `squares` is what the linear model leaves."""
    residuals = (whitening @ (picture - project(theta, lattice))[..., None]).ravel()
    jacobian = (whitening @ design(theta, lattice)).reshape(residuals.size, -1)
    noise = 1.0 if known_noise else max(float(np.sqrt((residuals**2).mean())), _LEAST_NOISE)
    precision = np.zeros(len(theta))
    precision[8:] = (noise / _PRIOR_TERM) ** 2
    precision[10:12] = (noise / _PRIOR_CENTRE) ** 2
    data = jacobian.T @ jacobian
    normal = data + np.diag(precision)
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale) + _DAMPING * np.eye(len(scale))
    covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
    step = covariance @ (jacobian.T @ residuals - precision * theta)
    left = residuals - jacobian @ step
    return PlaneFit(
        theta=theta + step,
        covariance=covariance,
        squares=float(left @ left),
        used=float((data * covariance).sum()),
    )


def _criterion(fit: PlaneFit, n_data: int, known_noise: bool) -> float:  # noqa: FBT001 (internal)
    loss = fit.squares
    if not known_noise:
        loss = n_data * math.log(max(fit.squares / n_data, _LEAST_NOISE**2))
    return loss + fit.used * math.log(n_data)

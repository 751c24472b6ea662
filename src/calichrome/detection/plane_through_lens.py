"""A plane seen through a lens: a homography and radial distortion, and what is left.

Parameters of the lens, in normalised coordinates: the homography h00..h21 (h22 = 1), radial terms
k1 and k2, and their centre (x, y):

    ideal = H lattice,  away = ideal - centre,  picture = ideal + away (k1 r^2 + k2 r^4).

What is left (tangential terms, a bowed board) is linear: a combination of the derivatives of these
parameters and of monomials of degree 2 and more. Solved as parameters of their own, homography and
monomials would trade large amounts without end.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import fit_homography

__all__ = ["PlaneFit", "fit_plane"]

_N_LENS = 12
_PRIOR_TERM = 0.5
"""Sigma of k1, k2 and the monomials with radii in half diagonals of the picture: k1 = -0.4 at a
focal length of the picture's width is -0.16 in this unit."""
_PRIOR_CENTRE = 0.1
"""Sigma of the centre of distortion in half diagonals: 6 % of the width of a 4:3 picture."""
_DEGREES = (2, 3, 4)  # of the monomials, if there are any; 1 is the homography's
_RESIDUALS_PER_PARAMETER = 2  # at least, for monomials; fewer would follow the noise
_PLAIN_STEPS = 6
_ROBUST_ROUNDS = 2
_LEAST_GAIN = 1e-3  # of the cost; what is left to gain moves no point by 0.05 sigma
_SHARES = (1.0, 0.3, 0.1, 0.03)  # of a step, tried in turn
_LEAST_NOISE = 1e-3  # px, where nothing is known and nothing is left
_DAMPING = 1e-12  # of a unit diagonal: what rounding leaves open stays where it is


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A fitted map.

    Parameters
    ----------
    theta : (12,) float
        The lens.
    rest : (P,) float
        Coefficients of `design`, P - 12 of them of monomials.
    covariance : (P, P) float
        Of `rest`, for unit noise.
    squares
        Sum of squared whitened residuals.
    used
        Parameters that the data, not the priors, determine.
    """

    theta: FloatArray
    rest: FloatArray
    covariance: FloatArray
    squares: float
    used: float

    def project(self, lattice: FloatArray) -> FloatArray:
        """Map normalised lattice points (N, 2) to normalised pixels (N, 2)."""
        seen = _seen(self.theta, lattice)
        return seen + self.design(lattice) @ self.rest if self.rest.any() else seen

    def design(self, lattice: FloatArray) -> FloatArray:
        """Differentiate `project` by `rest`, (N, 2, P)."""
        return _design(self.theta, lattice, (len(self.rest) - _N_LENS) // 2)


def fit_plane(
    lattice: FloatArray,
    picture: FloatArray,
    whitening: FloatArray,
    *,
    known_noise: bool,
    with_monomials: bool,
) -> PlaneFit:
    """Fit points, robustly, with the monomials of least Bayesian information criterion [1]_.

    Parameters
    ----------
    lattice, picture : (N, 2) float
        Normalised, N >= 4.
    whitening : (N, 2, 2) float
        Turns residuals into unit noise, or into pixels if the noise is not known.
    known_noise
        Whether residuals are to be judged by the noise or by each other.
    with_monomials
        Whether to look for more than the lens.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the Dimension of a Model", Ann. Statist. 6 (2), 1978.
    """
    data = _Points(lattice, picture, whitening, known_noise)
    theta = np.concatenate([fit_homography(lattice, picture).ravel()[:8], np.zeros(4)])
    theta = _descended(theta, data, _PLAIN_STEPS)
    # Outliers show only now that the lens is known.
    for _ in range(_ROBUST_ROUNDS):
        theta = _descended(theta, _reweighted(data, theta), 1)
    weighted = _reweighted(data, theta)
    best = _linear_fit(theta, weighted.residuals(theta), weighted, 0)
    if not with_monomials:
        squares = float((weighted.residuals(theta) ** 2).sum())
        return replace(best, rest=np.zeros(_N_LENS), squares=squares)
    residuals = weighted.residuals(theta)
    for degree in _DEGREES:
        n_terms = (degree + 1) * (degree + 2) // 2 - 3
        if picture.size < _RESIDUALS_PER_PARAMETER * (_N_LENS + 2 * n_terms):
            break
        fit = _linear_fit(theta, residuals, weighted, n_terms)
        if _criterion(fit, weighted) < _criterion(best, weighted):
            best = fit
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    lattice: FloatArray
    picture: FloatArray
    whitening: FloatArray
    known_noise: bool

    def residuals(self, theta: FloatArray) -> FloatArray:
        """Return whitened residuals of the lens alone, (N, 2)."""
        offset = self.picture - _seen(theta, self.lattice)
        return np.asarray((self.whitening @ offset[..., None])[..., 0])


def _lens(
    theta: FloatArray, lattice: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return ideal points (N, 2), their offset from the centre, its square, and the weight."""
    weight = lattice @ theta[6:8] + 1
    ideal = (lattice @ theta[[[0, 3], [1, 4]]] + theta[[2, 5]]) / weight[:, None]
    away = ideal - theta[10:12]
    return ideal, away, (away * away).sum(axis=1), weight


def _seen(theta: FloatArray, lattice: FloatArray) -> FloatArray:
    ideal, away, r2, _ = _lens(theta, lattice)
    return np.asarray(ideal + away * (r2 * (theta[8] + theta[9] * r2))[:, None])


def _design(theta: FloatArray, lattice: FloatArray, n_terms: int) -> FloatArray:
    """Differentiate by the lens and by the x and y coefficients of each monomial."""
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
    design = np.zeros((count, 2, _N_LENS + 2 * n_terms))
    design[:, :, :8] = (np.eye(2) + radial) @ by_ideal
    design[:, :, 8] = away * r2[:, None]
    design[:, :, 9] = away * (r2 * r2)[:, None]
    design[:, :, 10:12] = -radial
    if n_terms:
        terms = _monomials(lattice, n_terms)
        design[:, 0, _N_LENS::2] = terms
        design[:, 1, _N_LENS + 1 :: 2] = terms
    return design


def _monomials(lattice: FloatArray, count: int) -> FloatArray:
    """Return x^2, x y, y^2, x^3, ... at points (N, 2): the first `count`, (N, count)."""
    x, y = lattice.T
    terms: list[FloatArray] = []
    degree = 2
    while len(terms) < count:
        terms += [x ** (degree - power) * y**power for power in range(degree + 1)]
        degree += 1
    return np.stack(terms[:count], axis=1)


def _reweighted(data: _Points, theta: FloatArray) -> _Points:
    """Weigh residuals by 1 up to 4 sigma, falling with the square beyond."""
    size = np.linalg.norm(data.residuals(theta), axis=1)
    sigma = float(np.median(size)) / np.sqrt(2 * np.log(2))  # median of a Rayleigh distribution
    weights = 1 / np.maximum(1, size / max(4 * sigma, 1e-12)) ** 2
    return replace(data, whitening=data.whitening * weights[:, None, None])


def _precision(n_parameters: int, residuals: FloatArray, data: _Points) -> FloatArray:
    """Return the priors' precision in units of the residuals, (P,)."""
    noise = 1.0 if data.known_noise else max(float(np.sqrt((residuals**2).mean())), _LEAST_NOISE)
    precision = np.zeros(n_parameters)
    precision[8:] = (noise / _PRIOR_TERM) ** 2
    precision[10:12] = (noise / _PRIOR_CENTRE) ** 2
    return precision


def _linear_fit(theta: FloatArray, residuals: FloatArray, data: _Points, n_terms: int) -> PlaneFit:
    residuals = residuals.ravel()
    design = data.whitening @ _design(theta, data.lattice, n_terms)
    jacobian = design.reshape(residuals.size, -1)
    precision = _precision(jacobian.shape[1], residuals, data)
    normal = jacobian.T @ jacobian
    posterior = normal + np.diag(precision)
    scale = 1 / np.sqrt(np.maximum(np.diag(posterior), 1e-300))
    scaled = posterior * np.outer(scale, scale) + _DAMPING * np.eye(len(scale))
    covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
    right = jacobian.T @ residuals
    right[:_N_LENS] -= precision[:_N_LENS] * theta
    rest = covariance @ right
    left = residuals - jacobian @ rest
    return PlaneFit(
        theta=theta,
        rest=rest,
        covariance=covariance,
        squares=float(left @ left),
        used=float((normal * covariance).sum()),
    )


def _descended(theta: FloatArray, data: _Points, most_steps: int) -> FloatArray:
    """Go Gauss-Newton steps of the lens, or the parts of them that lower the cost."""
    residuals = data.residuals(theta)
    for _ in range(most_steps):
        precision = _precision(_N_LENS, residuals, data)
        cost = float((residuals**2).sum() + precision @ theta**2)
        step = _linear_fit(theta, residuals, data, 0).rest
        for share in _SHARES:
            there = theta + share * step
            left = data.residuals(there)
            lower = float((left**2).sum() + precision @ there**2)
            if lower < cost:
                break
        else:
            break
        theta, residuals = there, left
        if lower > (1 - _LEAST_GAIN) * cost:
            break
    return theta


def _criterion(fit: PlaneFit, data: _Points) -> float:
    count, loss = data.picture.size, fit.squares
    if not data.known_noise:
        loss = count * math.log(max(fit.squares / count, _LEAST_NOISE**2))
    return loss + fit.used * math.log(count)

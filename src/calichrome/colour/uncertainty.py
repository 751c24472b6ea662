"""How sure a corrected colour is: what noise and print tolerance do to it through the fit."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtri

from calichrome.colorimetry.description import DescriptionSpace, metric
from calichrome.colour.families import fit_model
from calichrome.colour.model import TermModel
from calichrome.colour.models import MODELS
from calichrome.colour.models.white_balance import WhiteBalance
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import Regression, fit_terms
from calichrome.core.arrays import FloatArray

__all__ = ["ColourCovariance", "bound_95", "flattening", "model_covariance", "propagate"]

_REFITS = 60  # the sigma of a sigma is then 9 %
_VARIANCES = 10.0 ** np.arange(-4, 4.1, 0.5)
"""Of drawn coefficients, in units of their penalty: wide about what ColorChecker fits of two
sensors had, 0.2 to 55 (noise of 0.2 to 1 %, prints off by 0.5 to 3 dE)."""
_MISFITS = 10.0 ** np.arange(-2, 0.1, 0.5)  # of what is assumed, which a perfect sensor lacks


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourCovariance:
    """Joint covariance of a term model's coefficients.

    Parameters
    ----------
    model
        The model.
    matrix : (3 P, 3 P) float
        Of the coefficients, row-major (term, channel).
    """

    model: TermModel
    matrix: FloatArray

    def of_xyz(self, rgb_linear: FloatArray, rgb_cov: FloatArray | None = None) -> FloatArray:
        """Return the covariance of corrected colours, (N, 3, 3).

        Parameters
        ----------
        rgb_linear : (N, 3) float
        rgb_cov : (N, 3, 3) float, optional
            Of the colours themselves; without it only the model is uncertain.
        """
        terms = self.model.terms(rgb_linear / self.model.white_rgb)
        n_terms = terms.shape[1]
        blocks = self.matrix.reshape(n_terms, 3, n_terms, 3)
        relative = np.einsum("nk,kilj,nl->nij", terms, blocks, terms)
        scale = np.outer(self.model.white_xyz, self.model.white_xyz)
        total = relative * scale
        if rgb_cov is not None:
            jacobian = self.model.jacobian(rgb_linear)
            total = total + jacobian @ rgb_cov @ np.swapaxes(jacobian, 1, 2)
        return np.asarray(total)


def propagate(model: TermModel, solved: Regression, pairs: ColourPairs) -> ColourCovariance:
    """Covariance of a fitted model about the one that exact colours would have given.

    Three parts. An error of a camera colour acts like one of the target, seen through the model;
    the fit is linear in the targets, so it leaves G E G' with its gain G. Errors of the regressors
    flatten the fit (`flattening`). And exact colours would have chosen a pull of their own, with a
    gain G0, from which this one is off by (G - G0) y0 of the exact targets y0: how large these are
    is told by the colours themselves (`_exact_targets`). As a rule noise makes a pull stronger: of
    those up to the chosen one each is taken to be as likely that of exact colours. Where noise
    made it weaker, the bound is too small.
    """
    n, _ = pairs.rgb.shape
    jacobian = model.jacobian(pairs.rgb)
    seen = jacobian @ pairs.rgb_cov @ np.swapaxes(jacobian, 1, 2)
    errors = (seen + pairs.xyz_cov) / np.outer(pairs.white_xyz, pairs.white_xyz)
    gain = solved.gain.reshape(-1, n, 3)
    total = np.einsum("ani,nij,bnj->ab", gain, errors, gain, optimize=True)
    shift = flattening(model, solved, pairs)
    total += np.outer(shift, shift)
    if model.N_SHRUNK:
        design = np.asarray(np.kron(model.terms(pairs.balanced), np.eye(3)), dtype=np.float64)
        unit = np.asarray(np.linalg.pinv(solved.penalty), dtype=np.float64)
        exact = _exact_targets(model, design, unit, errors, pairs)
        away = solved.gain - solved.gains
        total = total + np.einsum("kai,ij,kbj->ab", away, exact, away, optimize=True) / len(away)
    return ColourCovariance(model=model, matrix=total)


def flattening(model: TermModel, solved: Regression, pairs: ColourPairs) -> FloatArray:
    """Shift (3 P,) of the coefficients that errors of the camera colours cause in the mean.

    Notes
    -----
    The fit stands where the gradient g of its cost is 0. Colours with their errors once more would
    have the mean gradient E g, and so a fit that is H^-1 E g away: as far, to second order, as this
    one is from that of exact colours. The mean is taken by cubature [1]_: over both ends of each
    principal axis, sqrt(3) sigma long.

    References
    ----------
    .. [1] I. Arasaratnam, S. Haykin, "Cubature Kalman Filters", IEEE Trans. Automatic Control 54
       (6), 2009.
    .. [2] W. A. Fuller, "Measurement Error Models", 1987, section 1.1 (slopes that errors of the
       regressors flatten).
    """

    def gradient(balanced: FloatArray) -> FloatArray:
        terms = model.terms(balanced)
        base = balanced[:, 1:2] if model.WHITE_EXACT else 0.0
        misfit = base + terms @ model.coefficients - pairs.relative
        return np.asarray(np.einsum("nk,nij,nj->ki", terms, solved.weights, misfit).ravel())

    ends = np.sqrt(3) * _root(pairs.rgb_cov / np.outer(pairs.white_rgb, pairs.white_rgb))
    moved = [gradient(pairs.balanced + sign * ends[..., axis])
             for axis in range(3) for sign in (-1, 1)]  # fmt: skip
    return np.asarray(solved.inverse @ (gradient(pairs.balanced) - np.mean(moved, axis=0)))


def _exact_targets(
    model: TermModel,
    design: FloatArray,
    prior: FloatArray,
    errors: FloatArray,
    pairs: ColourPairs,
) -> FloatArray:
    """Covariance of exact targets beyond what free terms follow, (3 N, 3 N).

    Notes
    -----
    It is m M + t Phi prior Phi': a share m of the assumed misfit, and the drawn coefficients. The
    targets have E, the covariance of their errors, on top; what the free terms can follow is
    projected out (restricted likelihood [1]_). The posterior means of m and t are taken over a
    grid, the standard deviation sqrt(t) uniform beforehand [2]_, ln m uniform.

    References
    ----------
    .. [1] D. A. Harville, "Maximum Likelihood Approaches to Variance Component Estimation", JASA 72
       (358), 1977.
    .. [2] A. Gelman, "Prior distributions for variance parameters in hierarchical models", Bayesian
       Analysis 1 (3), 2006.
    """
    free = design[:, : -3 * model.N_SHRUNK]
    others = np.linalg.qr(free, mode="complete")[0][:, free.shape[1] :]

    def seen(matrix: FloatArray) -> FloatArray:
        return np.asarray(others.T @ matrix @ others)

    base = pairs.balanced[:, 1:2] if model.WHITE_EXACT else 0.0
    wanted = others.T @ (pairs.relative - base).ravel()
    misfit = block_diag(*np.linalg.inv(pairs.whitening))
    drawn = design @ prior @ design.T
    noise, seen_misfit, seen_drawn = seen(block_diag(*errors)), seen(misfit), seen(drawn)
    logs = np.empty((len(_VARIANCES), len(_MISFITS)))
    for row, variance in enumerate(_VARIANCES):
        for column, share in enumerate(_MISFITS):
            factor = np.linalg.cholesky(noise + share * seen_misfit + variance * seen_drawn)
            white = solve_triangular(factor, wanted, lower=True)
            logs[row, column] = -0.5 * white @ white - np.log(np.diag(factor)).sum()
    chances = np.exp(logs - logs.max()) * np.sqrt(_VARIANCES)[:, None]
    chances /= chances.sum()
    share, variance = chances.sum(axis=0) @ _MISFITS, chances.sum(axis=1) @ _VARIANCES
    return np.asarray(share * misfit + variance * drawn)


def model_covariance(
    name: str, pairs: ColourPairs, rgb_linear: FloatArray, *, mean_error: bool = False
) -> FloatArray:
    """Covariance of corrected colours (N, 3, 3) by what a model was fitted to.

    Parameters
    ----------
    name
        Of the model.
    pairs
        What it was fitted to.
    rgb_linear : (N, 3) float
    mean_error
        As in `fit_model`.
    """
    kind = MODELS[name]
    if issubclass(kind, TermModel) and kind is not WhiteBalance:
        fitted, solved = fit_terms(kind, pairs, mean_error=mean_error)
        return propagate(fitted, solved, pairs).of_xyz(rgb_linear)
    return _refit_covariance(name, pairs, rgb_linear)


def _refit_covariance(name: str, pairs: ColourPairs, rgb_linear: FloatArray) -> FloatArray:
    """Covariance of colours corrected by any model: it is fitted again to colours with new errors.

    References
    ----------
    .. [1] B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993, section 6.5
       (parametric; 25 to 200 repetitions for a standard error).
    """
    rng = np.random.default_rng(0)
    roots = [_root(cov) for cov in (pairs.rgb_cov, pairs.xyz_cov)]
    here = fit_model(name, pairs).apply(rgb_linear)
    total = np.zeros((len(rgb_linear), 3, 3))
    for _ in range(_REFITS):
        moved_rgb, moved_xyz = (
            np.einsum("nij,nj->ni", root, rng.normal(size=pairs.rgb.shape)) for root in roots
        )
        other = replace(pairs, rgb=pairs.rgb + moved_rgb, xyz=pairs.xyz + moved_xyz)
        step = fit_model(name, other).apply(rgb_linear) - here
        total += step[:, :, None] * step[:, None, :]
    return total / _REFITS


def _root(cov: FloatArray) -> FloatArray:
    """Return R with R R' = cov, (N, 3, 3), of covariances that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0))[:, None, :])


def bound_95(
    xyz: FloatArray, cov: FloatArray, adopted_white: FloatArray, space: DescriptionSpace = "lab2000"
) -> FloatArray:
    """Difference that the error of a colour stays below in 95 of 100 cases, (N,).

    Parameters
    ----------
    xyz : (N, 3) float
    cov : (N, 3, 3) float
    adopted_white : (3,) float
    space
        Where the difference is taken.

    Notes
    -----
    The squared difference is d' M d, a sum of chi-squares with the eigenvalues of M cov as weights;
    its quantile is that of the scaled chi-square of the same mean and variance.

    References
    ----------
    .. [1] F. E. Satterthwaite, "An Approximate Distribution of Estimates of Variance Components",
       Biometrics Bulletin 2 (6), 1946.
    """
    product = metric(xyz, space, adopted_white) @ cov
    mean = np.trace(product, axis1=1, axis2=2)
    squares = np.trace(product @ product, axis1=1, axis2=2)
    safe = np.maximum(mean, 1e-30)
    freedom = np.clip(safe**2 / np.maximum(squares, 1e-60), 1.0, 3.0)
    return np.asarray(np.sqrt(chdtri(freedom, 0.05) * safe / freedom))

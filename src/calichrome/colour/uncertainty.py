"""How sure a corrected colour is: what noise and print tolerance do to it through the fit."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from calichrome.colorimetry.description import DescriptionSpace, metric
from calichrome.colour.families import fit_model
from calichrome.colour.model import TermModel
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import Regression
from calichrome.core.arrays import FloatArray

__all__ = ["ColourCovariance", "bound_95", "propagate", "refit_covariance"]

_REFITS = 60  # the sigma of a sigma is then 9 %


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
    """Carry the errors of the colours it was fitted to into a model.

    An error of a camera colour acts like one of the target, seen through the model; the fit is
    linear in the targets, so the covariance of the coefficients is G E G' with its gain G. What the
    model cannot follow is no noise and has no part in it.
    """
    jacobian = model.jacobian(pairs.rgb)
    seen = jacobian @ pairs.rgb_cov @ np.swapaxes(jacobian, 1, 2)
    errors = (seen + pairs.xyz_cov) / np.outer(pairs.white_xyz, pairs.white_xyz)
    n_terms, _, n, _ = solved.gain.shape
    gain = solved.gain.reshape(3 * n_terms, n, 3)
    return ColourCovariance(
        model=model, matrix=np.einsum("ani,nij,bnj->ab", gain, errors, gain, optimize=True)
    )


def refit_covariance(
    name: str, pairs: ColourPairs, rgb_linear: FloatArray, *, mean_error: bool = False
) -> FloatArray:
    """Covariance of corrected colours (N, 3, 3), by fitting again to colours with new errors.

    `propagate` holds the strength of the pull; here it is chosen anew each time, which moves a
    model more than the errors alone do, and any model can be asked.

    Parameters
    ----------
    name
        Of the model.
    pairs
        What it was fitted to.
    rgb_linear : (N, 3) float
    mean_error
        As in `fit_model`.

    References
    ----------
    .. [1] B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993, section 6.5
       (parametric; 25 to 200 repetitions for a standard error).
    """
    rng = np.random.default_rng(0)
    roots = [_root(cov) for cov in (pairs.rgb_cov, pairs.xyz_cov)]
    here = fit_model(name, pairs, mean_error=mean_error).apply(rgb_linear)
    total = np.zeros((len(rgb_linear), 3, 3))
    for _ in range(_REFITS):
        moved_rgb, moved_xyz = (
            np.einsum("nij,nj->ni", root, rng.normal(size=pairs.rgb.shape)) for root in roots
        )
        other = replace(pairs, rgb=pairs.rgb + moved_rgb, xyz=pairs.xyz + moved_xyz)
        step = fit_model(name, other, mean_error=mean_error).apply(rgb_linear) - here
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
    return np.asarray(np.sqrt(chi2.ppf(0.95, freedom) * safe / freedom))

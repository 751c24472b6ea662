"""Least squares for models that are linear in their parameters.

The errors of X, Y and Z are weighed together (a small error in the description space couples them),
so all 3 P coefficients are solved at once:

    minimise  sum_i |W_i^(1/2) (t_i - b_i - C' phi_i)|^2  +  s sum_k |W_mean^(1/2) c_k|^2 p_k

over the rows c_k of C, with phi the terms, b the base, and p_k > 0 for the terms that are drawn
towards 0. The strength s is the one with the smallest leave-one-out error in the description space.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.linalg

from calichrome.colour.model import TermModel
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray

__all__ = ["Regression", "fit_terms"]

_STRENGTHS = 10.0 ** np.arange(-5, 2.01, 0.5)
"""Of the pull, relative to what the data say of the mean term: from none to a matrix."""
_REFINEMENTS = 8  # of the mean error instead of the squared one; changes fall below 0.01 dE
_SMALLEST = 0.1  # dE: errors below it all count alike, or one exact colour would hold the fit

_OPEN = 1e-12  # of a column's length: below what 20 terms of a ColorChecker still tell apart (1e-8)
_TINY = 1e-9  # keeps the leave-one-out error of a colour finite that alone fixes a term

Model = TypeVar("Model", bound=TermModel)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regression:
    """A solved model and what it hangs on.

    Parameters
    ----------
    coefficients : (P, 3) float
    vectors : (3 P, 3 P) float
        In which the normal equations of every pull are diagonal.
    scales : (K, 3 P) float
        The inverse of that diagonal for every pull that is not stronger than the chosen one,
        weakest first.
    rows : (N, 3, 3 P) float
        What a relative target of each colour adds to the right side, in those vectors.
    weights : (N, 3, 3) float
        Of each colour's error, as they were in the last fit.
    strength
        Of the pull; 0 where nothing is drawn.
    penalty : (3 P, 3 P) float
        What the pull of strength 1 costs, p_k W_mean along the diagonal; zero rows are not drawn.
    left_out : (N, 3) float
        What each relative target is predicted as by the others.
    """

    coefficients: FloatArray
    vectors: FloatArray
    scales: FloatArray
    rows: FloatArray
    weights: FloatArray
    strength: float
    penalty: FloatArray
    left_out: FloatArray

    @property
    def gain(self) -> FloatArray:
        """Derivative of the coefficients by relative targets, (3 P, 3 N): the estimator."""
        return self._gain(self.scales[-1])

    @property
    def gains(self) -> FloatArray:
        """The same of every pull that is not stronger, (K, 3 P, 3 N); the last is `gain`."""
        return np.stack([self._gain(scales) for scales in self.scales])

    @property
    def inverse(self) -> FloatArray:
        """Of the normal equations, the pull among them, (3 P, 3 P)."""
        return np.asarray((self.vectors * self.scales[-1]) @ self.vectors.T)

    def _gain(self, scales: FloatArray) -> FloatArray:
        return np.asarray((self.vectors * scales) @ self.rows.reshape(-1, len(scales)).T)


def fit_terms(
    model: type[Model], pairs: ColourPairs, *, mean_error: bool = False
) -> tuple[Model, Regression]:
    """Fit a term model.

    Parameters
    ----------
    model
        Its class.
    pairs
        At least `model.MIN_COLOURS` colours.
    mean_error
        Minimise the mean difference in the description space instead of the squared one.

    Raises
    ------
    ValueError
        With fewer colours.

    Notes
    -----
    The mean is reached by reweighting: a square divided by its own size is the size (E. Weiszfeld,
    Tohoku Math. J. 43, 1937).
    """
    if len(pairs) < model.MIN_COLOURS:
        raise ValueError(f"{model.MODEL} needs {model.MIN_COLOURS} colours, got {len(pairs)}")
    terms = model.terms(pairs.balanced)
    base = pairs.balanced[:, 1:2] if model.WHITE_EXACT else np.zeros((1, 1))
    whitening = pairs.whitening
    solved = _solve(terms, pairs, base, whitening, model.N_SHRUNK)
    if mean_error:
        for _ in range(_REFINEMENTS):
            fitted = (base + terms @ solved.coefficients) * pairs.white_xyz
            error = pairs.difference(fitted)
            weighted = whitening / np.maximum(error, _SMALLEST)[:, None, None]
            solved = _solve(terms, pairs, base, weighted, model.N_SHRUNK)
    return model(pairs.white_rgb, pairs.white_xyz, solved.coefficients), solved


def _solve(
    terms: FloatArray, pairs: ColourPairs, base: FloatArray, whitening: FloatArray, n_shrunk: int
) -> Regression:
    n, n_terms = terms.shape
    wanted = pairs.relative - base
    # rows of the design: colour i, channel j, whitened; columns: term k, channel l
    factor = np.swapaxes(np.linalg.cholesky(whitening), 1, 2)
    design = np.einsum("nk,nij->nikj", terms, factor).reshape(3 * n, -1)
    pulled = np.zeros((n_terms, n_terms))
    if n_shrunk:
        own = np.einsum("nk,nk->k", terms, terms)[-n_shrunk:].mean()
        pulled[-n_shrunk:, -n_shrunk:] = np.sqrt(own) * np.eye(n_shrunk)
    pull = np.kron(pulled, np.linalg.cholesky(whitening.mean(axis=0)).T)
    # one triangle for both: design = q r, pull = p r with q'q + p'p = 1, so that with p's singular
    # vectors both are diagonal; normal equations would lose twice the digits
    lengths = np.sqrt((design**2).sum(axis=0) + (pull**2).sum(axis=0))
    loose = _OPEN * np.diag(lengths)  # colours that repeat leave a direction open
    orthogonal, triangle = np.linalg.qr(np.concatenate([design, pull, loose]))
    _, drawn, turn = np.linalg.svd(orthogonal[3 * n : -len(loose)])
    rows = (orthogonal[: 3 * n] @ turn.T).reshape(n, 3, -1)
    side = np.einsum("niv,nij,nj->v", rows, factor, wanted, optimize=True)
    strengths = _STRENGTHS if n_shrunk else np.ones(1)
    scales = 1 / np.maximum(1 + (strengths[:, None] - 1) * drawn**2, 1e-12)
    back = np.linalg.inv(factor)
    by_colour = back @ rows
    residuals = wanted - np.einsum("njv,sv->snj", by_colour, scales * side)
    weighted = np.swapaxes(factor, 1, 2) @ rows
    leverage = np.einsum("niv,sv,njv->snij", by_colour, scales, weighted, optimize=True)
    gap = (1 + _TINY) * np.eye(3) - leverage
    left_out = base + wanted - np.linalg.solve(gap, residuals[..., None])[..., 0]
    errors = pairs.difference(left_out * pairs.white_xyz)
    best = int(np.argmin(errors @ pairs.weights))
    vectors = scipy.linalg.solve_triangular(triangle, turn.T)
    return Regression(
        coefficients=(vectors @ (scales[best] * side)).reshape(n_terms, 3),
        vectors=vectors,
        scales=scales[: best + 1],
        rows=weighted,
        weights=whitening,
        strength=float(strengths[best]) if n_shrunk else 0.0,
        penalty=pull.T @ pull,
        left_out=left_out[best],
    )

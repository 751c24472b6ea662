"""How the light changes over the board, seen at its corners."""

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["light_gradients"]

_FEWEST_FOR_QUADRATIC = 12
_FEWEST_FOR_PLANE = 5
_STEEPEST = 0.1
"""Sigma of the change over one square, as a share of the level, where too few corners tell it:
wide enough to leave the gradient to the corner's own pixels; not set on data."""


def light_gradients(lattice: FloatArray, levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit a quadratic to levels at corners and return its gradients with their covariance.

    Parameters
    ----------
    lattice : (N, 2) float
        Where the corners are on the board, squares.
    levels : (N,) float

    Returns
    -------
    gradients : (N, 2) float
        Level per square.
    covariance : (N, 2, 2) float
        From the scatter of the levels about the fit.
    """
    x, y = (lattice - lattice.mean(axis=0)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    terms = np.stack([one, x, y, x * x, x * y, y * y], axis=1)
    by_x = np.stack([zero, one, zero, 2 * x, y, zero], axis=1)
    by_y = np.stack([zero, zero, one, zero, x, 2 * y], axis=1)
    count = len(levels)
    if count < _FEWEST_FOR_PLANE:
        sigma = _STEEPEST * float(np.abs(levels).mean())
        return np.zeros((count, 2)), np.broadcast_to(sigma**2 * np.eye(2), (count, 2, 2))
    n_terms = 6 if count >= _FEWEST_FOR_QUADRATIC else 3
    terms, slopes = terms[:, :n_terms], np.stack([by_x, by_y], axis=1)[:, :, :n_terms]
    weights = np.ones(count)
    for _ in range(3):
        weighted = terms * weights[:, None]
        coefficients, *_ = np.linalg.lstsq(weighted, levels * weights, rcond=None)
        residuals = np.abs(levels - terms @ coefficients)
        sigma = max(1.4826 * float(np.median(residuals)), 1e-9)
        weights = 1 / np.maximum(1, residuals / (3 * sigma))
    left = (levels - terms @ coefficients) * weights
    variance = float(left @ left) / max(count - n_terms, 1)
    inverse = np.linalg.pinv(weighted.T @ weighted, hermitian=True) * variance
    return slopes @ coefficients, np.einsum("nip,pq,njq->nij", slopes, inverse, slopes)

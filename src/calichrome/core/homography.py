"""Plane to plane."""

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["apply_homography", "fit_homography"]


def fit_homography(
    source: FloatArray, target: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Fit H with ``target ~ H source`` by the normalised direct linear transform.

    Parameters
    ----------
    source, target : (N, 2) float
        Matching points, N >= 4, no three of four on a line. Any unit.
    weights : (N,) float, optional
        Of the squares of each point's errors.

    Returns
    -------
    (3, 3) float
        Scaled to ``H[2, 2] = 1``.

    Raises
    ------
    ValueError
        If fewer than four points are given.

    References
    ----------
    .. [1] R. Hartley, "In Defense of the Eight-Point Algorithm", IEEE PAMI 19 (6), 1997 (the
       normalisation); R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd ed., alg. 4.2.
    """
    if len(source) < 4 or len(source) != len(target):
        raise ValueError(f"homography: needs 4 or more matching points, got {len(source)}")
    to_source, to_target = _normaliser(source), _normaliser(target)
    x, y = apply_homography(to_source, source).T
    u, v = apply_homography(to_target, target).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows_u = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1)
    rows_v = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1)
    rows = np.concatenate([rows_u, rows_v])
    if weights is not None:
        rows *= np.sqrt(np.concatenate([weights, weights]))[:, None]
    _, _, vt = np.linalg.svd(rows, full_matrices=len(rows) < 9)
    homography = np.linalg.solve(to_target, vt[-1].reshape(3, 3) @ to_source)
    return np.asarray(homography / homography[2, 2])


def apply_homography(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Map points of shape (..., 2)."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def _normaliser(points: FloatArray) -> FloatArray:
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / max(np.linalg.norm(points - centre, axis=1).mean(), 1e-300)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])

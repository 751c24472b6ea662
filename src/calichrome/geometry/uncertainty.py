"""What a covariance means in pixels: over the picture, after the rotation that nobody can know."""

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import cross_matrix
from calichrome.geometry.lenses import Lens

__all__ = ["picture_grid", "projection_covariances", "projection_sigma_px"]

_GRID = (16, 12)


def picture_grid(size_wh: tuple[int, int], shape: tuple[int, int] = _GRID) -> FloatArray:
    """Pixels on a grid from border to border, (nx ny, 2), row by row."""
    x = np.linspace(0, size_wh[0] - 1, shape[0])
    y = np.linspace(0, size_wh[1] - 1, shape[1])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def projection_covariances(
    lens: Lens, lens_cov: FloatArray, pixels: FloatArray, picture: FloatArray | None = None
) -> FloatArray:
    """Covariance of where far points project, after the best rotation of the camera.

    The boards hardly tell the orientation of a camera apart from its principal point: errors of
    both are large and cancel. So each error of the lens is followed by the small rotation omega
    that moves the picture back best: with A = d pixels / d omega over the picture, a the same at
    one pixel, and B by the lens,

        d = (B - a (A'A)^-1 A'B) dtheta

    Parameters
    ----------
    lens, lens_cov
        Lens and (P, P) covariance of its parameters.
    pixels : (N, 2) float
        Where to tell; nan is returned where the lens has no ray.
    picture : (M, 2) float, optional
        Over which pixels the rotation is fitted; None: `pixels` themselves.

    Returns
    -------
    (N, 2, 2) float, px^2

    References
    ----------
    .. [1] D. Kogan, mrcal, "Differencing" (the rotation fitted over the picture; here linearised).
    """
    by_rotation, by_lens = _derivatives(lens, pixels)
    whole = (by_rotation, by_lens) if picture is None else _derivatives(lens, picture)
    seen = np.isfinite(whole[0]).all(axis=(1, 2)) & np.isfinite(whole[1]).all(axis=(1, 2))
    turns = whole[0][seen].reshape(-1, 3)
    changes = whole[1][seen].reshape(-1, len(lens_cov))
    answer, *_ = np.linalg.lstsq(turns, changes, rcond=None)
    response = by_lens - by_rotation @ answer
    return np.asarray(response @ lens_cov @ response.transpose(0, 2, 1))


def projection_sigma_px(lens: Lens, lens_cov: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Root mean square 2-D error of projection on `picture_grid`, (N,), pixels; nan: no ray."""
    covariances = projection_covariances(lens, lens_cov, picture_grid(size_wh))
    return np.asarray(np.sqrt(np.trace(covariances, axis1=1, axis2=2)))


def _derivatives(lens: Lens, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By a rotation (N, 2, 3) and by the lens (N, 2, P), of the rays through `pixels`."""
    rays = lens.unproject(pixels)
    _, by_lens, by_point = lens.project_with_jacobians(rays)
    return by_point @ -cross_matrix(rays), by_lens

"""How far two lenses are apart, in pixels over the picture.

A lens and a rotation of the camera describe the same pictures as another lens, almost: so lenses
are compared after the rotation that brings them closest, as a user would see it, with the
poses absorbing the rotation.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import cross_matrix
from calichrome.geometry.lenses import BrownConrady

__all__ = ["difference_px", "picture_grid", "predicted_ms_px2"]

_GRID = (33, 25)
_STEPS = 4  # Gauss-Newton on three angles below a degree converges to rounding in three


def picture_grid(size_wh: tuple[int, int]) -> FloatArray:
    """Return pixels (825, 2) from border to border."""
    x, y = (np.linspace(0, side - 1, count) for side, count in zip(size_wh, _GRID, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def difference_px(lens: BrownConrady, other: BrownConrady, size_wh: tuple[int, int]) -> FloatArray:
    """Return where `other` projects what `lens` sees at each pixel of the grid, minus it, (G, 2).

    After the rotation of least root mean square difference; nan if a lens folds in the picture.
    """
    pixels = picture_grid(size_wh)
    rays = lens.unproject(pixels)
    turn = Rotation.identity()
    for _ in range(_STEPS):
        turned = turn.apply(rays)
        projected, _, d_points = other.project_with_jacobians(turned)
        difference = projected - pixels
        if not np.isfinite(difference).all():
            return np.full_like(pixels, np.nan)
        by_turn = _by_turn(turned, d_points)
        step, *_ = np.linalg.lstsq(by_turn, -difference.ravel(), rcond=None)
        turn = Rotation.from_rotvec(step) * turn
    return other.project(turn.apply(rays)) - pixels


def predicted_ms_px2(lens: BrownConrady, covariance: FloatArray, size_wh: tuple[int, int]) -> float:
    """Mean over the picture of the expected squared 2-D difference to the truth, px^2.

    Parameters
    ----------
    covariance : (9, 9) float
        Of the lens's parameters.

    Notes
    -----
    With P the derivative of all pixels by the parameters and A that by a rotation, the difference
    that is left is (1 - A A^+) P d for an error d, to first order, and so the mean of its square
    is the trace of (1 - A A^+) P C P' (1 - A A^+)' over the number of pixels.
    """
    pixels = picture_grid(size_wh)
    rays = lens.unproject(pixels)
    _, d_lens, d_points = lens.project_with_jacobians(rays)
    by_lens = d_lens.reshape(2 * len(pixels), -1)
    basis, _ = np.linalg.qr(_by_turn(rays, d_points))
    left = by_lens - basis @ (basis.T @ by_lens)
    return float(np.einsum("ij,jk,ik->", left, covariance, left)) / len(pixels)


def _by_turn(rays: FloatArray, d_points: FloatArray) -> FloatArray:
    return np.asarray((-d_points @ cross_matrix(rays)).reshape(2 * len(rays), 3))

"""Frames in which geometry alone cannot tell two balls apart in a pair of cameras."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import cross_matrix
from calichrome.synthetic import CameraTruth
from calichrome.synthetic.workspace import WorkspaceTruth

__all__ = ["epipolar_distances_px", "exchangeable"]

_SIGMAS = 2.0
_SEEN = 0.5  # share of a ball that makes it a candidate


def epipolar_distances_px(a: CameraTruth, b: CameraTruth, points_world: FloatArray) -> FloatArray:
    """Sampson distance of each ball's picture in `a` to each ball's picture in `b`.

    Parameters
    ----------
    points_world : (n, 3) float, metres

    Returns
    -------
    (n, n) float, pixels
        [i, j]: ball i as seen by `a`, ball j as seen by `b`. Errors of the four pixel coordinates
        of equal sigma give this distance the same sigma.

    References
    ----------
    .. [1] R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., 2004,
       eq. 11.9.
    """
    b_from_a = b.cam_from_world @ a.cam_from_world.inverse()
    essential = cross_matrix(b_from_a.trans_m) @ b_from_a.rotation
    in_a, in_b = (camera.cam_from_world.apply(points_world) for camera in (a, b))
    rays_a, rays_b = in_a / in_a[:, 2:], in_b / in_b[:, 2:]
    # Lines in each ideal image, in pixels of that camera's focal length.
    lines_b, lines_a = rays_a @ essential.T, rays_b @ essential
    residual = np.abs(lines_b @ rays_b.T)
    slope = ((lines_b[:, :2] / b.lens.fx) ** 2).sum(axis=1)[:, None] + (
        (lines_a[:, :2] / a.lens.fx) ** 2
    ).sum(axis=1)[None]
    return np.asarray(residual / np.sqrt(slope))


def exchangeable(
    truth: WorkspaceTruth, sigma_px: Mapping[str, float] | float
) -> dict[tuple[str, str], BoolArray]:
    """Find the frames in which two balls are exchangeable for a pair of cameras.

    They are if both cameras see both, and each one's picture in one camera lies within two sigmas
    of the epipolar line of the other's picture in the other camera.

    Parameters
    ----------
    sigma_px
        Standard deviation of a ball's centre in a picture, per coordinate.

    Returns
    -------
    dict
        pair of cameras -> (n_frames, n_balls, n_balls) bool, symmetric.
    """
    positions = np.stack([ball.positions_world for ball in truth.balls], axis=1)
    result = {}
    for first, second in combinations(truth.cameras, 2):
        a, b = truth.cameras[first], truth.cameras[second]
        both = np.stack(
            [(ball.seen[first] >= _SEEN) & (ball.seen[second] >= _SEEN) for ball in truth.balls],
            axis=1,
        )
        sigma = (
            sigma_px
            if isinstance(sigma_px, float)
            else float(np.sqrt((sigma_px[first] ** 2 + sigma_px[second] ** 2) / 2))
        )
        near = np.stack(
            [epipolar_distances_px(a, b, points) < _SIGMAS * sigma for points in positions]
        )
        near &= near.swapaxes(1, 2) & both[:, :, None] & both[:, None]
        near[:, np.arange(near.shape[1]), np.arange(near.shape[1])] = False
        result[first, second] = near
    return result

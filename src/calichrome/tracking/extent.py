"""How large an object is along the axes of the world, from its silhouettes."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import nnls

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.tracking.track import Sighting
from calichrome.tracking.view import View

__all__ = ["extent_of"]


def extent_of(
    position_ref: FloatArray,
    sightings: Mapping[str, Sighting],
    views: Mapping[str, View],
    world_from_ref: Pose,
) -> FloatArray:
    """Return the sides (3,), metres, of the upright box about an object; nan: fewer than two views.

    Notes
    -----
    An ellipsoid with half axes h along the world reaches ``sqrt(sum (g_i h_i)^2)`` pixels to either
    side of its centre, with g the derivative of that pixel coordinate by the place: linear in the
    squares of h. Widths and heights of two or more silhouettes fix them by non-negative least
    squares.
    """
    rows, squares = [], []
    for camera, sighting in sightings.items():
        if not sighting.used:
            continue
        seen = views[camera].look(position_ref[None])
        slope = seen.d_points[0] @ world_from_ref.rotation.T
        left, top, right, bottom = sighting.box
        rows += [slope[0] ** 2, slope[1] ** 2]
        squares += [((right - left) / 2) ** 2, ((bottom - top) / 2) ** 2]
    if len(rows) < 4:
        return np.full(3, np.nan)
    matrix, right_side = np.array(rows), np.array(squares)
    scale = matrix.max()
    half_squares, _ = nnls(matrix / scale, right_side / scale)
    return np.asarray(2 * np.sqrt(half_squares))

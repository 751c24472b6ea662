"""How far two objects are apart, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.tracking.trajectory import Trajectory

__all__ = ["Distances", "distance_bounds"]


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Between the centres of two objects.

    Parameters
    ----------
    distance_m : (N,) float
    sigma_m : (N,) float
        Standard deviation.
    direction_ref : (N, 3) float
        Unit vectors from the second to the first.
    """

    distance_m: FloatArray
    sigma_m: FloatArray
    direction_ref: FloatArray


def distance_bounds(
    first: Trajectory, second: Trajectory, places: Sequence[tuple[int, int]]
) -> Distances:
    """Return the distances of two objects at N instants.

    Parameters
    ----------
    first, second
        The objects.
    places
        Index of the same instant in each.

    Notes
    -----
    The errors of the cameras move both objects: with u the direction between them, P what each has
    alone, D their derivatives by the cameras and S the covariance of those, the variance is
    ``u'(P_1 + P_2)u + u'(D_1 - D_2) S (D_1 - D_2)'u``. What moves both alike drops out.
    """
    i, j = (np.array(column, dtype=np.int64) for column in zip(*places, strict=True))
    between = first.positions_ref[i] - second.positions_ref[j]
    distance = np.linalg.norm(between, axis=1)
    unit = between / np.maximum(distance, 1e-12)[:, None]
    own = first.own_cov[i, :3, :3] + second.own_cov[j, :3, :3]
    moved = np.einsum("na,nak->nk", unit, first.d_cameras[i, :3] - second.d_cameras[j, :3])
    variance = np.einsum("na,nab,nb->n", unit, own, unit)
    variance += np.einsum("nk,kl,nl->n", moved, first.cameras_cov, moved)
    return Distances(distance, np.sqrt(variance), unit)

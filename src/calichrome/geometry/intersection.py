"""Rays that meet: points from chosen views by least squares, and how sure they are.

Formulas in `calichrome.geometry.triangulation.triangulate`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.lenses import Lens

__all__ = ["Cameras", "Sights", "chords", "covariances", "intersect"]

_PARALLEL = 1e-14  # det / mean^3 of a normal matrix: rays that meet at less than about 1e-7 rad
_STEPS = 60  # Gauss-Newton needs 3 to 8; a point that runs away to infinity all of them
_CONVERGED = 1e-16  # squared whitened step: 1e-8 of a sigma
_STALLED = 1e-6  # share of a step, where nothing shorter helps either: rounding, if ...
_STALLED_LENGTH = 1e-6  # ... the squared whitened step is 1e-3 of a sigma
_MOST_NUMBERS = 4_000_000  # in the largest array of one block: 32 MB


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """C calibrated cameras; `cov` is the joint covariance of their K parameters, or None."""

    lenses: tuple[Lens, ...]
    rotations: FloatArray  # (C, 3, 3) cam_from_ref
    trans_m: FloatArray  # (C, 3)
    cov: FloatArray | None

    @classmethod
    def placed(
        cls, lenses: Sequence[Lens], cams_from_ref: Sequence[Pose], cov: FloatArray | None
    ) -> "Cameras":
        """Collect lenses and poses."""
        return cls(
            lenses=tuple(lenses),
            rotations=np.stack([pose.rotation for pose in cams_from_ref]),
            trans_m=np.stack([pose.trans_m for pose in cams_from_ref]),
            cov=cov,
        )

    @property
    def centres_ref(self) -> FloatArray:
        """Where they stand, (C, 3), metres."""
        return np.asarray(-np.einsum("cji,cj->ci", self.rotations, self.trans_m))


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """What N points look like in C cameras; nan where there is no pixel or no ray."""

    pixels: FloatArray  # (N, C, 2)
    whitening: FloatArray  # (N, C, 2, 2)
    rays_ref: FloatArray  # (N, C, 3), unit length

    @classmethod
    def seen(cls, cameras: Cameras, pixels: FloatArray, whitening: FloatArray) -> "Sights":
        """Turn pixels into rays."""
        rays = np.full((*pixels.shape[:2], 3), np.nan)
        for index, lens in enumerate(cameras.lenses):
            rows = np.isfinite(pixels[:, index]).all(axis=1)
            rays_cam = lens.unproject(pixels[rows, index])
            rays_cam /= np.linalg.norm(rays_cam, axis=1, keepdims=True)
            rays[rows, index] = rays_cam @ cameras.rotations[index]
        return cls(pixels, whitening, rays)

    @property
    def has_ray(self) -> BoolArray:
        """Which views there are, (N, C)."""
        return np.asarray(np.isfinite(self.rays_ref).all(axis=2))

    def take(self, rows: IntArray) -> "Sights":
        """Return some of the points."""
        return Sights(self.pixels[rows], self.whitening[rows], self.rays_ref[rows])


def intersect(
    cameras: Cameras, sights: Sights, rows: IntArray, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Solve for points.

    Parameters
    ----------
    cameras, sights
        All there is.
    rows : (M,) int
        Which points; one may come several times.
    used : (M, C) bool
        From which views, each of which has a ray; two or more per point.

    Returns
    -------
    points_ref : (M, 3) float, metres
        nan where the rays meet behind a camera or nowhere.
    chi_square : (M,) float
        Of 2 n - 3 degrees of freedom for n views; infinite where there is no point.
    """
    points, chi_square = np.empty((len(rows), 3)), np.full(len(rows), np.inf)
    for block in _blocks(len(rows), 9 * len(cameras.lenses)):
        own = sights.take(rows[block])
        start = _nearest_to_rays(cameras.centres_ref, own.rays_ref, used[block])
        points[block] = _refined(cameras, own, used[block], start)
    solved = np.flatnonzero(np.isfinite(points).all(axis=1))
    for block in _blocks(len(solved), _width(cameras)):
        some = solved[block]
        own = sights.take(rows[some])
        chi_square[some] = _chi_square(cameras, own, used[some], points[some])
    return points, chi_square


def covariances(
    cameras: Cameras, sights: Sights, used: BoolArray, points: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return the covariance (N, 3, 3) of solved points and d_points_d_cameras (N, 3, K) or None."""
    cov = np.full((len(points), 3, 3), np.nan)
    moved = None if cameras.cov is None else np.full((len(points), 3, len(cameras.cov)), np.nan)
    solved = np.flatnonzero(np.isfinite(points).all(axis=1))
    for block in _blocks(len(solved), _width(cameras)):
        rows = solved[block]
        own = sights.take(rows)
        _, jacobian = _residuals(cameras, own, used[rows], points[rows])
        cov[rows] = np.linalg.inv(jacobian.swapaxes(1, 2) @ jacobian)
        if moved is not None and cameras.cov is not None:
            by_cameras = _by_cameras(cameras, own, used[rows], points[rows])
            moved[rows] = -cov[rows] @ (jacobian.swapaxes(1, 2) @ by_cameras)
            cov[rows] += moved[rows] @ cameras.cov @ moved[rows].swapaxes(1, 2)
    return cov, moved


def chords(rays: FloatArray, used: BoolArray) -> FloatArray:
    """Largest distance between the ends of two used unit rays of each point, (N,)."""
    longest = np.zeros(len(rays))
    for index in range(rays.shape[1]):
        apart = np.linalg.norm(rays - rays[:, index : index + 1], axis=2)
        both = used & used[:, index : index + 1]
        longest = np.maximum(longest, np.where(both, apart, 0).max(axis=1))
    return longest


def _nearest_to_rays(centres: FloatArray, rays: FloatArray, used: BoolArray) -> FloatArray:
    """Point (M, 3) of least squared distance to its rays, over their squared ranges."""
    directions = np.where(used[..., None], rays, 0)
    across = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    weight = used.astype(np.float64)
    for _ in range(3):  # ranges hardly change after the first
        normal = np.einsum("nc,ncij->nij", weight, across)
        right = np.einsum("nc,ncij,cj->ni", weight, across, centres)
        points = _solved(normal, right)
        ranges = np.linalg.norm(points[:, None] - centres, axis=2)
        nearest = np.where(used, ranges, np.inf).min(axis=1, keepdims=True)
        weight = np.where(used, (nearest / np.where(ranges > 0, ranges, np.inf)) ** 2, 0)
        weight = np.where(np.isfinite(weight), weight, 0)
    return points


def _refined(cameras: Cameras, sights: Sights, used: BoolArray, start: FloatArray) -> FloatArray:
    """Minimise the whitened reprojection error of each point; nan where that leads nowhere."""
    points = start.copy()
    residuals, jacobian = _residuals(cameras, sights, used, points)
    cost = _cost(residuals)
    share = np.ones(len(points))
    settled = np.zeros(len(points), dtype=bool)
    going = np.flatnonzero(np.isfinite(cost))
    for _ in range(_STEPS):
        if not going.size:
            break
        slope = np.einsum("nri,nr->ni", jacobian[going], residuals[going])
        step = _solved(jacobian[going].swapaxes(1, 2) @ jacobian[going], -slope)
        length = -(slope * step).sum(axis=1)  # squared, whitened; nan where rays are parallel
        trial = points[going] + share[going, None] * step
        trial_residuals, trial_jacobian = _residuals(
            cameras, sights.take(going), used[going], trial
        )
        trial_cost = _cost(trial_residuals)
        better = trial_cost < cost[going]
        won = going[better]
        points[won], cost[won] = trial[better], trial_cost[better]
        residuals[won], jacobian[won] = trial_residuals[better], trial_jacobian[better]
        share[going] = np.where(better, np.minimum(4 * share[going], 1), share[going] / 4)
        stalled = share[going] < _STALLED
        settled[going] = (length <= _CONVERGED) | (stalled & (length <= _STALLED_LENGTH))
        going = going[~settled[going] & ~stalled & np.isfinite(length)]
    return np.where(settled[:, None], points, np.nan)


def _residuals(
    cameras: Cameras, sights: Sights, used: BoolArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals (M, 2C) and their derivative by the points (M, 2C, 3).

    Zero in views that are not used; nan where a camera does not see its point.
    """
    n_points, n_cameras = used.shape
    residuals = np.zeros((n_points, n_cameras, 2))
    jacobian = np.zeros((n_points, n_cameras, 2, 3))
    for index, lens in enumerate(cameras.lenses):
        rows = np.flatnonzero(used[:, index])
        points_cam = points[rows] @ cameras.rotations[index].T + cameras.trans_m[index]
        seen = lens.sees(points_cam)
        residuals[rows[~seen], index] = np.nan
        rows, points_cam = rows[seen], points_cam[seen]
        pixels, _, d_points = lens.project_with_jacobians(points_cam)
        whitening = sights.whitening[rows, index]
        error = pixels - sights.pixels[rows, index]
        residuals[rows, index] = np.einsum("nij,nj->ni", whitening, error)
        jacobian[rows, index] = whitening @ d_points @ cameras.rotations[index]
    return residuals.reshape(n_points, -1), jacobian.reshape(n_points, -1, 3)


def _by_cameras(
    cameras: Cameras, sights: Sights, used: BoolArray, points: FloatArray
) -> FloatArray:
    """Differentiate the whitened residuals by the parameters of all cameras, (M, 2C, K)."""
    n_points, n_cameras = used.shape
    sizes = [len(lens.NAMES) + 6 for lens in cameras.lenses]
    derivative = np.zeros((n_points, n_cameras, 2, sum(sizes)))
    for index, (lens, end) in enumerate(zip(cameras.lenses, np.cumsum(sizes), strict=True)):
        rows = np.flatnonzero(used[:, index])
        turned = points[rows] @ cameras.rotations[index].T
        _, d_lens, d_points = lens.project_with_jacobians(turned + cameras.trans_m[index])
        d_pose = np.concatenate([-d_points @ cross_matrix(turned), d_points], axis=2)
        whitened = sights.whitening[rows, index] @ np.concatenate([d_lens, d_pose], axis=2)
        derivative[rows, index, :, end - sizes[index] : end] = whitened
    return derivative.reshape(n_points, 2 * n_cameras, -1)


def _chi_square(
    cameras: Cameras, sights: Sights, used: BoolArray, points: FloatArray
) -> FloatArray:
    """Sum of squares of residuals, over their covariance with that of the cameras, (M,)."""
    residuals, jacobian = _residuals(cameras, sights, used, points)
    if cameras.cov is None:
        return _cost(residuals)
    by_cameras = _by_cameras(cameras, sights, used, points)
    spread = np.eye(residuals.shape[1]) + by_cameras @ cameras.cov @ by_cameras.swapaxes(1, 2)
    right = np.concatenate([residuals[:, :, None], jacobian], axis=2)
    product = right.swapaxes(1, 2) @ np.linalg.solve(spread, right)
    slope = product[:, 1:, 0]
    taken_up = (slope * _solved(product[:, 1:, 1:], slope)).sum(axis=1)
    return np.asarray(product[:, 0, 0] - taken_up)


def _cost(residuals: FloatArray) -> FloatArray:
    """Sum of squares (M,); infinite where a camera does not see its point."""
    cost = (residuals**2).sum(axis=1)
    return np.where(np.isfinite(cost), cost, np.inf)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (M, 3, 3) systems; nan where the matrix leaves a direction open."""
    mean = np.trace(matrix, axis1=1, axis2=2) / 3
    determined = np.linalg.det(matrix) > _PARALLEL * mean**3
    safe = np.where(determined[:, None, None], matrix, np.eye(3))
    solution = np.linalg.solve(safe, right[..., None])[..., 0]
    return np.where(determined[:, None], solution, np.nan)


def _width(cameras: Cameras) -> int:
    """Numbers per point in the largest array of `_by_cameras` and `_chi_square`."""
    n_rows = 2 * len(cameras.lenses)
    return n_rows * max(n_rows, 0 if cameras.cov is None else len(cameras.cov), 3)


def _blocks(n_rows: int, numbers_per_row: int) -> Iterator[slice]:
    size = max(1, _MOST_NUMBERS // numbers_per_row)
    return (slice(at, at + size) for at in range(0, n_rows, size))

"""Points in space from the pixels of any number of calibrated views, with what they are worth."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from calichrome.core.arrays import BoolArray, FloatArray, IntArray, checked
from calichrome.core.pose import Pose
from calichrome.geometry.intersection import Cameras, Sights, chords, covariances, intersect
from calichrome.geometry.lenses import Lens

__all__ = ["TriangulatedPoints", "triangulate"]

# Choice: a depth known to a tenth of the distance. Its second-order bias, sigma^2 / distance, is
# then a tenth of sigma; beyond, the error is no ellipsoid and the covariance is no longer true.
_LARGEST_DEPTH_SHARE = 0.1
_FALSE_ALARM = 1e-3  # choice: one clean point of a thousand is called inconsistent
_LESS_LIKELY = -2 * np.log(_FALSE_ALARM)  # in chi-square: a thousandth of the likelihood
_EVERY_SUBSET_UP_TO = 8  # views: 92 subsets leave out fewer than half of 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriangulatedPoints:
    """Points in ref and how far they are to be trusted.

    Parameters
    ----------
    points_ref : (N, 3) float, metres
        nan where `few_views` or `behind`.
    cov_m2 : (N, 3, 3) float, metres squared
        From the pixels and, if given, the calibration.
    used : (N, C) bool
        Views that the point stands on: those with a ray, less the outliers that were found.
    chi_square : (N,) float
        Squared residuals of the used views in units of their covariance.
    freedom : (N,) int
        Its degrees of freedom, 2 n - 3 for n views.
    angle_rad : (N,) float
        Largest angle between two used rays.
    few_views : (N,) bool
        Fewer than two views have a ray.
    behind : (N,) bool
        The rays meet behind one of the cameras, or nowhere.
    inconsistent : (N,) bool
        The views contradict each other by more than chance allows, and it is not clear which one is
        wrong; with two views it never is.
    small_angle : (N,) bool
        The rays are so nearly parallel that the depth has a sigma of more than a tenth of the
        distance.
    d_points_d_cameras : (N, 3, K) float or None
        By the parameters that `cameras_cov` is about; None if it was not given.
    cameras_cov : (K, K) float or None
        As given.
    """

    points_ref: FloatArray
    cov_m2: FloatArray
    used: BoolArray
    chi_square: FloatArray
    freedom: IntArray
    angle_rad: FloatArray
    few_views: BoolArray
    behind: BoolArray
    inconsistent: BoolArray
    small_angle: BoolArray
    d_points_d_cameras: FloatArray | None = None
    cameras_cov: FloatArray | None = None

    def joint_covariance(self, indices: Sequence[int] | IntArray) -> FloatArray:
        """Return the covariance (M, 3, M, 3), metres squared, of some points together.

        Pixel noise is independent from point to point; the errors of the cameras are shared.
        """
        index = np.asarray(indices, dtype=np.int64)
        joint = np.zeros((len(index), 3, len(index), 3))
        if self.d_points_d_cameras is not None and self.cameras_cov is not None:
            moved = self.d_points_d_cameras[index].reshape(3 * len(index), -1)
            joint[:] = (moved @ self.cameras_cov @ moved.T).reshape(joint.shape)
        first, second = np.nonzero(index[:, None] == index)
        joint[first, :, second] = self.cov_m2[index[first]]
        return joint

    def distance_sigma_m(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Return the standard deviation of distances between points.

        Parameters
        ----------
        first, second : (M,) int
            Indices of the two ends of each distance.

        Returns
        -------
        (M,) float, metres
            nan where both ends are at one place: the distance has no direction there.

        Notes
        -----
        With u the unit vector between the ends, C their covariances from pixels and D their
        derivatives by the camera parameters of covariance S, the variance is
        ``u'(C_i + C_j) u + |S^(1/2) (D_i - D_j)' u|^2``: errors of the cameras that move both
        points alike leave the distance as it is.
        """
        i, j = np.asarray(first, dtype=np.int64), np.asarray(second, dtype=np.int64)
        between = self.points_ref[i] - self.points_ref[j]
        length = np.linalg.norm(between, axis=-1, keepdims=True)
        unit = between / np.where(length > 0, length, np.nan)
        variance = np.einsum("...a,...ab,...b->...", unit, self.cov_m2[i] + self.cov_m2[j], unit)
        if self.d_points_d_cameras is not None and self.cameras_cov is not None:
            along_i = np.einsum("...a,...ak->...k", unit, self.d_points_d_cameras[i])
            along_j = np.einsum("...a,...ak->...k", unit, self.d_points_d_cameras[j])
            shared = np.einsum("...k,kl,...l->...", along_i, self.cameras_cov, along_j)
            variance = variance - 2 * shared
        return np.asarray(np.sqrt(variance))


def triangulate(
    pixels: ArrayLike,
    lenses: Sequence[Lens],
    cams_from_ref: Sequence[Pose],
    *,
    cov_px2: ArrayLike,
    cameras_cov: ArrayLike | None = None,
) -> TriangulatedPoints:
    """Find points from their pixels in two or more views.

    Parameters
    ----------
    pixels : (N, C, 2) float, pixels
        Of N points in C cameras; nan where not seen.
    lenses, cams_from_ref
        Of the C cameras.
    cov_px2 : (..., 2, 2) float, pixels squared
        Covariance of each pixel position, to be broadcast to (N, C, 2, 2).
    cameras_cov : (K, K) float or None
        Joint covariance of all camera parameters: camera by camera its lens in the order of
        `NAMES`, then its pose (omega, tau) as `Pose` defines them. Rows of what is certain are
        zero. None: the cameras are taken as exact.

    Raises
    ------
    ValueError
        If a shape is wrong or the covariance of a pixel is not positive definite.

    Notes
    -----
    *Estimate.* The point X minimises ``sum |W_v (p_v(X, theta) - y_v)|^2`` over the views v, with
    y a pixel, W'W the inverse of its covariance, theta the camera parameters. Start: the point
    nearest to all rays, each weighted by its squared inverse range, so that angles count; then
    Gauss-Newton with shortened steps.

    *Covariance.* At the minimum the gradient g(X, y, theta) = J'r is zero, with r the whitened
    residuals, J = dr/dX. By the implicit function theorem ``dX = -(dg/dX)^-1 dg``; to first order
    (residuals times second derivatives left out) dg/dX = J'J = H, dg/dy = -J'W and dg/dtheta = J'G
    with G = dr/dtheta. Whitened pixel noise has unit covariance, so with S that of theta::

        D = dX/dtheta = -H^-1 J'G        cov X = H^-1 + D S D'

    *Consistency.* r has the covariance V = I + G S G' less what the fit takes up. The test value is
    ``min over dX of (r + J dX)' V^-1 (r + J dX)``, chi-square of 2n - 3 degrees of freedom for n
    views. It exceeds its limit for one clean point of a thousand.

    *Outliers.* A point over the limit is solved without one view, then without two, as long as more
    than half of its views remain: all subsets of up to 8 views, of more the best one's children. A
    subset is taken if it is consistent and every other of its size is less than a thousandth as
    likely (chi-square larger by 2 ln 1000). If none is, the point keeps all views and is
    `inconsistent`.

    References
    ----------
    .. [1] R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed., 2004, ch. 5.2 (propagation
       of covariance) and ch. 12 (triangulation).
    .. [2] W. Förstner, B. P. Wrobel, "Photogrammetric Computer Vision", 2016, ch. 4 (redundancy
       and tests of residuals).
    """
    cameras, pixel_array, whitening = _checked_inputs(
        pixels, lenses, cams_from_ref, cov_px2, cameras_cov
    )
    sights = Sights.seen(cameras, pixel_array, whitening)
    used = sights.has_ray
    n_points = len(used)
    few_views = used.sum(axis=1) < 2
    points, chi_square = np.full((n_points, 3), np.nan), np.full(n_points, np.nan)
    rows = np.flatnonzero(~few_views)
    points[rows], chi_square[rows] = intersect(cameras, sights, rows, used[rows])
    _leave_out_outliers(cameras, sights, points, chi_square, used)

    cov_m2, moved = covariances(cameras, sights, used, points)
    freedom = np.maximum(2 * used.sum(axis=1) - 3, 0)
    lost = np.isnan(points).any(axis=1)
    n_used = np.maximum(used.sum(axis=1, keepdims=True), 1)
    forward = points - used @ cameras.centres_ref / n_used
    distance = np.linalg.norm(forward, axis=1)
    along = np.einsum("ni,nij,nj->n", forward, cov_m2, forward)  # sigma^2 times distance^2
    return TriangulatedPoints(
        points_ref=points,
        cov_m2=cov_m2,
        used=used,
        chi_square=np.where(lost, np.nan, chi_square),
        freedom=freedom,
        angle_rad=2 * np.arcsin(np.minimum(chords(sights.rays_ref, used) / 2, 1)),
        few_views=few_views,
        behind=lost & ~few_views,
        inconsistent=~lost & (chi_square > _limit(used)),
        small_angle=np.sqrt(along) > _LARGEST_DEPTH_SHARE * distance**2,
        d_points_d_cameras=moved,
        cameras_cov=cameras.cov,
    )


def _leave_out_outliers(
    cameras: Cameras,
    sights: Sights,
    points: FloatArray,
    chi_square: FloatArray,
    used: BoolArray,
) -> None:
    """Find views that contradict the others; `points`, `chi_square` and `used` are put right."""
    doubtful = (used.sum(axis=1) > 2) & (chi_square > _limit(used))
    # of each point in doubt the views from which one is left out next
    parents = {int(row): np.flatnonzero(used[row]) for row in np.flatnonzero(doubtful)}
    n_left_out = 0
    while parents:
        n_left_out += 1
        subsets = {}
        for row, parent in parents.items():
            views = np.flatnonzero(used[row])
            if 2 * (len(views) - n_left_out) > len(views):
                every = len(views) <= _EVERY_SUBSET_UP_TO
                subsets[row] = list(
                    combinations(views if every else parent, len(views) - n_left_out)
                )
        rows = np.repeat(list(subsets), [len(item) for item in subsets.values()]).astype(np.int64)
        masks = np.zeros((len(rows), used.shape[1]), dtype=bool)
        for mask, subset in zip(masks, (s for item in subsets.values() for s in item), strict=True):
            mask[list(subset)] = True
        trial_points, trial_chi_square = intersect(cameras, sights, rows, masks)
        parents = {}
        for row in subsets:
            mine = np.flatnonzero(rows == row)
            best, second = mine[np.argsort(trial_chi_square[mine])[:2]]
            consistent = trial_chi_square[best] <= _limit(masks[best : best + 1])[0]
            if consistent and trial_chi_square[second] > trial_chi_square[best] + _LESS_LIKELY:
                points[row], chi_square[row] = trial_points[best], trial_chi_square[best]
                used[row] = masks[best]
            else:
                parents[row] = np.flatnonzero(masks[best])


def _limit(used: BoolArray) -> FloatArray:
    """Chi-square (N,) that a clean point exceeds once in a thousand; nan below two views."""
    n_views = used.sum(axis=1)
    limit = chdtri(np.maximum(2 * n_views - 3, 1), _FALSE_ALARM)
    return np.where(n_views > 1, limit, np.nan)


def _checked_inputs(
    pixels: ArrayLike,
    lenses: Sequence[Lens],
    cams_from_ref: Sequence[Pose],
    cov_px2: ArrayLike,
    cameras_cov: ArrayLike | None,
) -> tuple[Cameras, FloatArray, FloatArray]:
    """Cameras, pixels (N, C, 2) and whitening (N, C, 2, 2)."""
    n_cameras = len(lenses)
    if n_cameras < 2 or len(cams_from_ref) != n_cameras:
        raise ValueError(
            f"triangulate: {n_cameras} lenses and {len(cams_from_ref)} poses; give one of each for "
            f"every one of two or more cameras"
        )
    array = np.asarray(pixels, dtype=np.float64)
    if array.ndim != 3 or array.shape[1:] != (n_cameras, 2):
        raise ValueError(f"pixels: expected shape (n, {n_cameras}, 2), got {array.shape}")
    cov = np.array(np.broadcast_to(np.asarray(cov_px2, dtype=np.float64), (*array.shape, 2)))
    cov[~np.isfinite(array).all(axis=2)] = np.eye(2)
    try:
        whitening = np.linalg.inv(np.linalg.cholesky(checked(cov, (2, 2), "cov_px2")))
    except np.linalg.LinAlgError:
        raise ValueError("cov_px2: a covariance is not positive definite") from None
    if cameras_cov is not None:
        n_parameters = sum(len(lens.NAMES) + 6 for lens in lenses)
        cameras_cov = checked(cameras_cov, (n_parameters, n_parameters), "cameras_cov")
    return Cameras.placed(lenses, cams_from_ref, cameras_cov), array, whitening

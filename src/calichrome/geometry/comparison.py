"""How far two calibrations of a camera differ, in pixels, and how far chance lets them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.lenses import Lens
from calichrome.geometry.uncertainty import picture_grid

__all__ = [
    "LensDifference",
    "chance_of_more",
    "compare_lenses",
    "projection_difference",
    "root_of",
]

_ITERATIONS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensDifference:
    """Two lenses of one camera, compared over the picture.

    Parameters
    ----------
    pixels : (N, 2) float
        `picture_grid`, once for each distance.
    difference_px : (N, 2) float
        Where lens b projects what lens a sees there, less `pixels`; nan where one has no ray.
    b_from_a
        The motion between the two camera frames that brings them nearest.
    roots : (N, 2, K) float, pixels, or None
        R with R R' = the covariance that both calibrations predict for the difference.
    """

    pixels: FloatArray
    difference_px: FloatArray
    b_from_a: Pose
    roots: FloatArray | None

    @property
    def _seen(self) -> BoolArray:
        return np.asarray(np.isfinite(self.difference_px).all(axis=1), dtype=np.bool_)

    @property
    def rms_px(self) -> float:
        """Root mean square 2-D difference."""
        return float(np.sqrt((self.difference_px[self._seen] ** 2).sum(axis=1).mean()))

    @property
    def max_px(self) -> float:
        """Largest 2-D difference."""
        return float(np.linalg.norm(self.difference_px[self._seen], axis=1).max())

    @property
    def sigma_px(self) -> float | None:
        """Root mean square 2-D difference that both covariances predict."""
        weights = self._weights
        return None if weights is None else float(np.sqrt(weights.sum()))

    @property
    def ratio(self) -> float | None:
        """`rms_px` over `sigma_px`: about 1 if both covariances are true."""
        sigma = self.sigma_px
        return None if not sigma else self.rms_px / sigma

    @property
    def chance(self) -> float | None:
        """Probability of a larger mean square, if both covariances are true."""
        weights = self._weights
        if weights is None or not weights.any():
            return None
        return chance_of_more(self.rms_px**2, weights)

    @property
    def _weights(self) -> FloatArray | None:
        """The predicted mean square is the sum of these times chi-squares of one degree."""
        if self.roots is None:
            return None
        flat = self.roots[self._seen].reshape(-1, self.roots.shape[2])
        products = flat.T @ flat / self._seen.sum()
        return np.maximum(np.linalg.eigvalsh(products), 0)


def compare_lenses(
    lens_a: Lens,
    lens_b: Lens,
    size_wh: tuple[int, int],
    *,
    covs: tuple[FloatArray, FloatArray] | None = None,
    distances_m: Sequence[float] = (),
) -> LensDifference:
    """Compare two lenses of one camera after the motion that brings them nearest.

    A camera's orientation cannot be told from its principal point, nor, at one distance, its place
    from both; so two calibrations are compared after the rigid motion between their camera frames
    that minimises the difference over the picture (Gauss-Newton).

    Parameters
    ----------
    lens_a, lens_b
        Of the same camera; they may be of different models.
    size_wh
        Pixels.
    covs
        (P, P) covariances of the parameters of a and b, from independent data.
    distances_m
        Ranges of the points over which the motion is fitted. None: the points are far, and there is
        only a rotation. At a *single* range a translation is as good as its multiple at a multiple
        of the range: the difference does not depend on it.

    Returns
    -------
    LensDifference

    Notes
    -----
    With A the derivative of all pixels by the motion and B_a, B_b by the lenses, the motion's fit
    leaves M = 1 - A (A'A)^-1 A' of any change, so the covariance of the difference is
    M (B_a S_a B_a' + B_b S_b B_b') M', to first order.

    References
    ----------
    .. [1] D. Kogan, mrcal, "Differencing" (the implied transformation; there each point is weighted
       by its uncertainty).
    """
    grid = picture_grid(size_wh)
    rays = lens_a.unproject(grid)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    ranges = np.asarray(distances_m, dtype=np.float64)
    unit_m = float(np.median(ranges)) if len(ranges) else 1.0
    points = np.concatenate([rays * share for share in (ranges / unit_m if len(ranges) else [1])])
    pixels = np.tile(grid, (max(len(ranges), 1), 1))
    rotation, shift = np.eye(3), np.zeros(3)
    for _ in range(_ITERATIONS):
        moved = points @ rotation.T + shift
        projected, by_lens_b, by_point = lens_b.project_with_jacobians(moved)
        difference = projected - pixels
        by_motion = by_point @ -cross_matrix(moved)
        if len(ranges):
            by_motion = np.concatenate([by_motion, by_point], axis=2)
        seen = np.asarray(np.isfinite(by_motion).all(axis=(1, 2)), dtype=np.bool_)
        seen &= np.isfinite(difference).all(axis=1)
        columns = by_motion[seen].reshape(-1, by_motion.shape[2])
        step, *_ = np.linalg.lstsq(columns, -difference[seen].ravel(), rcond=None)
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        rotation = turn @ rotation
        if len(ranges):
            shift = turn @ shift + step[3:]
        if np.linalg.norm(step) < 1e-12:
            break
    difference = np.where(seen[:, None], difference, np.nan)
    roots = None
    if covs is not None:
        _, by_lens_a, _ = lens_a.project_with_jacobians(points)
        changes = np.concatenate(
            [by_lens_a @ root_of(covs[0]), by_lens_b @ root_of(covs[1])], axis=2
        )  # fmt: skip
        answer, *_ = np.linalg.lstsq(
            columns, changes[seen].reshape(-1, changes.shape[2]), rcond=None
        )
        roots = changes - by_motion @ answer
    return LensDifference(
        pixels=pixels,
        difference_px=difference,
        b_from_a=Pose(rotation, shift * unit_m),
        roots=roots,
    )


def projection_difference(
    lens_a: Lens, lens_b: Lens, size_wh: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Where lens b projects what lens a sees, after the rotation that brings them nearest.

    Parameters
    ----------
    lens_a, lens_b
        Of the same camera.
    size_wh
        Pixels.

    Returns
    -------
    difference : (N, 2) float, pixels
        On `picture_grid`; nan where a lens has no ray.
    rotvec : (3,) float, radians
        The rotation b_from_a.
    """
    found = compare_lenses(lens_a, lens_b, size_wh)
    return found.difference_px, found.b_from_a.rotvec_rad


def chance_of_more(value: float, weights: FloatArray) -> float:
    """Probability that sum_i w_i X_i exceeds `value`, for X_i chi-square of one degree each.

    The sum is replaced by a shifted and scaled chi-square of the same first three cumulants: exact
    for equal weights.

    Examples
    --------
    >>> round(chance_of_more(3.841, np.array([1.0])), 3)
    0.05

    References
    ----------
    .. [1] M. J. Buckley, G. K. Eagleson, "An approximation to the distribution of quadratic forms
       in normal random variables", Austral. J. Stat. 30A, 1988.
    """
    first, second, third = (float((weights**power).sum()) for power in (1, 2, 3))
    freedom = second**3 / third**2
    return float(chdtrc(freedom, max(freedom + (value - first) * second / third, 0.0)))


def root_of(cov: FloatArray) -> FloatArray:
    """R, (n, rank), with R R' = cov; columns of directions that are certain are left out.

    Parameters are scaled by their sigmas first: radians, metres and pixels differ by 1e6.
    """
    sigma = np.sqrt(np.diag(cov))
    scale = np.where(sigma > 0, sigma, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    kept = values > len(cov) * np.finfo(np.float64).eps * max(float(values[-1]), 0.0)
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))

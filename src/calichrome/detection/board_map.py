"""Where the points of the board lie in one picture, from its corners alone.

A homography, radial distortion about a centre near the picture's middle, and a polynomial for what
is left (tangential terms, a bowed board), as long as the corners ask for it. No camera needs to be
known.
"""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.detection.plane_through_lens import PlaneFit, fit_plane

__all__ = ["BoardMap", "EdgeBend"]

_STENCIL = 0.05  # of a square, for second differences
_LINEAR_STEP = 1e-4  # of a square, for first differences


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBend:
    """Both edges at N points of the lattice.

    Parameters
    ----------
    along_i, along_j : (N, 2) float
        Pixels per square along +i and +j.
    curvature : (N, 2) float, 1 / px
        Of the edge along j (which separates +i from -i) and of the edge along i; positive where the
        edge bends towards its normal, which points to +i and to +j.
    variance : (N, 2) float
        Of the curvatures, from the covariance of the map.
    """

    along_i: FloatArray
    along_j: FloatArray
    curvature: FloatArray
    variance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardMap:
    """A smooth map from lattice coordinates (i, j) to pixels.

    Parameters
    ----------
    origin : (2,) float
        Middle of the corners in lattice coordinates.
    unit
        Squares per unit of the normalised lattice coordinates.
    centre_px, scale_px
        Middle (2,) and half diagonal of the picture, which make normalised pixels.
    plane
        The map between normalised coordinates.
    covariance : (P, P) float
        Of the plane's linear parameters.
    misfit
        Mean squared residual per degree of freedom, over its expectation if the noise was given, in
        px^2 if not; nan without a degree of freedom.
    n_free
        Degrees of freedom behind `misfit`.
    """

    origin: FloatArray
    unit: float
    centre_px: FloatArray
    scale_px: float
    plane: PlaneFit
    covariance: FloatArray
    misfit: float
    n_free: int

    @classmethod
    def fit(
        cls,
        indices: FloatArray,
        corners_px: FloatArray,
        size_wh: tuple[int, int],
        cov_px: FloatArray | None = None,
        *,
        lens_only: bool = False,
    ) -> "BoardMap":
        """Fit corners, robustly.

        Parameters
        ----------
        indices : (N, 2) float
            Lattice coordinates, N >= 4, not all on a line.
        corners_px : (N, 2) float
        size_wh
            Of the picture.
        cov_px : (N, 2, 2) float, or None
            Covariance of each corner; None: all alike, of unknown size.
        lens_only
            Leave out what homography and radial distortion do not explain; faster.
        """
        centre, scale = (np.array(size_wh) - 1.0) / 2, float(np.hypot(*size_wh)) / 2
        origin = indices.mean(axis=0)
        unit = max(float(np.abs(indices - origin).max()), 1.0)
        if cov_px is None:
            whitening = np.tile(scale * np.eye(2), (len(indices), 1, 1))
        else:
            whitening = np.linalg.inv(np.linalg.cholesky(cov_px)) * scale
        fit = fit_plane(
            (indices - origin) / unit,
            (corners_px - centre) / scale,
            whitening,
            known_noise=cov_px is not None,
            with_monomials=not lens_only,
        )
        free = corners_px.size - fit.used
        misfit = fit.squares / free if free >= 1 else float("nan")
        unknown = cov_px is None and free >= 1
        return cls(
            origin=origin,
            unit=unit,
            centre_px=centre,
            scale_px=scale,
            plane=fit,
            covariance=fit.covariance * (misfit if unknown else 1.0),
            misfit=misfit,
            n_free=round(free) if free > 0 else 0,
        )

    @property
    def size_wh(self) -> tuple[int, int]:
        """Of the picture."""
        width, height = np.rint(2 * self.centre_px + 1).astype(int).tolist()
        return width, height

    def __call__(self, points: FloatArray) -> FloatArray:
        """Map lattice coordinates (..., 2) to pixels (..., 2)."""
        lattice = (np.reshape(points, (-1, 2)) - self.origin) / self.unit
        pixels = self.plane.project(lattice) * self.scale_px + self.centre_px
        return pixels.reshape(np.shape(points))

    def jacobian(self, points: FloatArray) -> FloatArray:
        """Return d pixel / d lattice at points (..., 2), shape (..., 2, 2)."""
        steps = _LINEAR_STEP * np.eye(2)
        around = np.asarray(points)[..., None, :]
        rows = (self(around + steps) - self(around - steps)) / (2 * _LINEAR_STEP)
        return np.asarray(np.swapaxes(rows, -1, -2))

    def covariance_at(self, points: FloatArray) -> FloatArray:
        """Return the covariance of the map at lattice points (N, 2), (N, 2, 2), px^2."""
        by_theta = self._design(points)
        return np.asarray(
            by_theta @ self.covariance @ np.swapaxes(by_theta, 1, 2) * self.scale_px**2
        )

    def edges(self, points: FloatArray) -> EdgeBend:
        """Return direction and curvature of both edges at lattice points (N, 2)."""
        steps = _STENCIL * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        stencil = points[:, None] + steps
        here, *around = np.moveaxis(self(stencil), 1, 0)
        along = [(ahead - behind) / (2 * _STENCIL) for ahead, behind in (around[:2], around[2:])]
        curvature, variance = np.empty((len(points), 2)), np.empty((len(points), 2))
        for edge in (0, 1):
            # The edge that separates +i from -i runs along j, and the other way round.
            run = 1 - edge
            ahead, behind = around[2 * run], around[2 * run + 1]
            bend = (ahead - 2 * here + behind) / _STENCIL**2
            length = np.linalg.norm(along[run], axis=1)
            normal = np.stack([along[run][:, 1], -along[run][:, 0]], axis=1) / length[:, None]
            normal *= np.sign((normal * along[edge]).sum(axis=1))[:, None]
            curvature[:, edge] = (normal * bend).sum(axis=1) / length**2
            variance[:, edge] = self._bend_variance(
                stencil[:, [0, 1 + 2 * run, 2 + 2 * run]], normal, along[run], bend
            )
        return EdgeBend(along[0], along[1], curvature, variance)

    def _design(self, points: FloatArray) -> FloatArray:
        return self.plane.design((points - self.origin) / self.unit)

    def _bend_variance(
        self, line: FloatArray, normal: FloatArray, along: FloatArray, bend: FloatArray
    ) -> FloatArray:
        """Return the variance (N,) of n . p'' / |p'|^2 from the covariance of the parameters.

        `line` (N, 3, 2) holds each point and its neighbours ahead and behind. p'' (`bend`) has a
        part along the edge (perspective), which enters as the normal turns with p' (`along`): the
        derivative by the parameters is (n . dp'' - (p'' . p') / |p'|^2 (n . dp')) / |p'|^2.
        """
        middle, ahead, behind = (self._design(line[:, index]) for index in range(3))
        first = np.einsum("ni,nip->np", normal, (ahead - behind) / (2 * _STENCIL))
        second = np.einsum("ni,nip->np", normal, (ahead - 2 * middle + behind) / _STENCIL**2)
        length2 = (along * along).sum(axis=1)
        sliding = (bend * along).sum(axis=1) / length2
        by_theta = (second - sliding[:, None] * first) * (self.scale_px / length2)[:, None]
        return np.asarray(((by_theta @ self.covariance) * by_theta).sum(axis=1))

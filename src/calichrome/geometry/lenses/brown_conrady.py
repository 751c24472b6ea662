"""Pinhole with radial and tangential distortion: the paper's nine numbers."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["BrownConrady"]

_TOLERANCE = 1e-12  # of the normalised plane: 1e-9 px at f = 1000 px
_NEWTON_STEPS = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class BrownConrady:
    """Focal lengths and principal point in pixels, distortion k1 k2 p1 p2 k3 as in OpenCV.

    Notes
    -----
    With x = X/Z, y = Y/Z, r^2 = x^2 + y^2 and g = 1 + k1 r^2 + k2 r^4 + k3 r^6::

        u = fx (x g + 2 p1 x y + p2 (r^2 + 2 x^2)) + cx
        v = fy (y g + p1 (r^2 + 2 y^2) + 2 p2 x y) + cy

    References
    ----------
    .. [1] D. C. Brown, "Close-Range Camera Calibration", Photogrammetric Engineering 37 (8), 1971,
       pp. 855-866.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    MODEL: ClassVar[str] = "brown-conrady"
    NAMES: ClassVar[tuple[str, ...]] = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

    @property
    def parameters(self) -> FloatArray:
        """Values in the order of `NAMES`."""
        return np.array([getattr(self, name) for name in self.NAMES])

    @classmethod
    def from_parameters(cls, parameters: FloatArray) -> Self:
        """Build from values in the order of `NAMES`."""
        return cls(**{k: float(v) for k, v in zip(cls.NAMES, parameters, strict=True)})

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return {name: getattr(self, name) for name in self.NAMES}

    @property
    def matrix(self) -> FloatArray:
        """The pinhole matrix K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def project(self, points_cam: FloatArray) -> FloatArray:
        """Project points (N, 3), metres, to pixels (N, 2); nan behind the camera."""
        depth = np.where(points_cam[..., 2] > 0, points_cam[..., 2], np.nan)
        distorted = self._distort(points_cam[..., :2] / depth[..., None])
        return distorted * [self.fx, self.fy] + [self.cx, self.cy]

    def project_with_jacobians(
        self, points_cam: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pixels (N, 2), d_pixels_d_parameters (N, 2, 9), d_pixels_d_points (N, 2, 3)."""
        depth = np.where(points_cam[:, 2] > 0, points_cam[:, 2], np.nan)
        plane = points_cam[:, :2] / depth[:, None]
        x, y = plane.T
        distorted = self._distort(plane)
        focal = np.array([self.fx, self.fy])
        pixels = distorted * focal + [self.cx, self.cy]

        r2 = x * x + y * y
        d_parameters = np.zeros((len(x), 2, 9))
        d_parameters[:, 0, 0], d_parameters[:, 1, 1] = distorted.T
        d_parameters[:, 0, 2] = d_parameters[:, 1, 3] = 1
        for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
            d_parameters[:, :, column] = plane * power[:, None]
        d_parameters[:, :, 6] = np.stack([2 * x * y, r2 + 2 * y * y], axis=1)
        d_parameters[:, :, 7] = np.stack([r2 + 2 * x * x, 2 * x * y], axis=1)
        d_parameters[:, :, 4:] *= focal[:, None]

        d_plane = self._d_distort(plane) * focal[:, None]
        d_points = np.empty((len(x), 2, 3))
        d_points[:, :, :2] = d_plane / depth[:, None, None]
        d_points[:, :, 2] = -np.einsum("nij,nj->ni", d_plane, plane) / depth[:, None]
        return pixels, d_parameters, d_points

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Return rays (N, 3) with z = 1, by Newton's method with step control.

        nan where the distortion folds: no ray of the valid region reaches such a pixel.
        """
        target = (np.asarray(pixels) - [self.cx, self.cy]) / [self.fx, self.fy]
        plane = target.copy()
        for _ in range(_NEWTON_STEPS):
            error = self._distort(plane) - target
            if np.nanmax(np.abs(error), initial=0.0) < _TOLERANCE:
                break
            jacobian = self._d_distort(plane)
            a, b = jacobian[..., 0, 0], jacobian[..., 0, 1]
            c, d = jacobian[..., 1, 0], jacobian[..., 1, 1]
            determinant = a * d - b * c
            determinant = np.where(determinant > 0, determinant, np.nan)
            step = np.stack(
                [
                    (d * error[..., 0] - b * error[..., 1]) / determinant,
                    (a * error[..., 1] - c * error[..., 0]) / determinant,
                ],
                axis=-1,
            )
            length = np.linalg.norm(step, axis=-1, keepdims=True)
            plane = plane - step * np.minimum(1, 0.5 / np.maximum(length, 1e-12))
        converged = np.abs(self._distort(plane) - target).max(axis=-1) < 1e3 * _TOLERANCE
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return np.where((converged & self._is_monotonic(plane))[..., None], rays, np.nan)

    def sees(self, points_cam: FloatArray) -> BoolArray:
        """Tell which points (N, 3) lie before the camera and short of the fold, shape (N,).

        `project` gives points beyond the fold a place in the picture that belongs to others.
        """
        depth = np.where(points_cam[..., 2] > 0, points_cam[..., 2], np.nan)
        return self._is_monotonic(points_cam[..., :2] / depth[..., None])

    def _is_monotonic(self, plane: FloatArray) -> BoolArray:
        """Whether the radial curve still rises everywhere from the axis out to `plane`.

        Beyond the first turning point of r g(r) a pixel has two rays, and the far one is wrong.
        """
        # d(r g)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 with s = r^2: its first positive root
        roots = np.roots([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        limit = real.min() if len(real) else np.inf
        return np.asarray((plane**2).sum(axis=-1) < limit)

    def _distort(self, plane: FloatArray) -> FloatArray:
        x, y = plane[..., 0], plane[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ],
            axis=-1,
        )

    def _d_distort(self, plane: FloatArray) -> FloatArray:
        """Differentiate the distorted by the ideal point, (..., 2, 2)."""
        x, y = plane[..., 0], plane[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3)  # d radial / d r2
        xx = radial + 2 * x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
        yy = radial + 2 * y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
        xy = 2 * x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
        return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)

"""Fisheye: the image distance is a polynomial of the angle from the axis."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses.base import Lens
from calichrome.geometry.lenses.curves import first_positive_root, invert_rising

__all__ = ["KannalaBrandt"]

_SMALLEST = 1e-30  # m: distance from the axis that stands for 0, so that its square is not 0


@dataclass(frozen=True, slots=True, kw_only=True)
class KannalaBrandt(Lens):
    """Focal lengths and principal point in pixels, distortion k1 k2 k3 k4 as in OpenCV's fisheye.

    Points beside and behind the camera have an image, too; none have it where the curve falls.

    Notes
    -----
    With r^2 = X^2 + Y^2, theta = atan2(r, Z) and
    d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)::

        u = fx d X / r + cx
        v = fy d Y / r + cy

    References
    ----------
    .. [1] J. Kannala and S. S. Brandt, "A Generic Camera Model and Calibration Method for
       Conventional, Wide-Angle, and Fish-Eye Lenses", PAMI 28 (8), 2006, pp. 1335-1340, eq. 6
       with its first coefficient in the focal lengths.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    MODEL: ClassVar[str] = "kannala-brandt"
    NAMES: ClassVar[tuple[str, ...]] = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    OPTIONAL: ClassVar[tuple[tuple[str, ...], ...]] = (("k3", "k4"),)

    @property
    def max_angle_rad(self) -> float:
        """Angle from the axis below which every ray has a pixel of its own."""
        even = [[(2 * n + 1) * k, 0.0] for n, k in enumerate(self.parameters[4:], start=1)]
        turn = first_positive_root(np.array([1.0, 0.0, *np.ravel(even)]))
        return min(turn, np.pi)

    @classmethod
    def _curve(cls, p: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image distance at focal length 1 and its slope."""
        k1, k2, k3, k4 = p[4:]
        t = theta * theta
        distance = theta * (1 + t * (k1 + t * (k2 + t * (k3 + t * k4))))
        return distance, 1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * (9 * k4))))

    @classmethod
    def _bent(cls, p: FloatArray, points_cam: FloatArray) -> tuple[FloatArray, ...]:
        """Return the image (2, V, N), and of each point (V, N): r^2, theta, the slope, 1/r, d/r.

        1/r and the image are nan where there is none.
        """
        x, y, z = points_cam[:, 0], points_cam[:, 1], points_cam[:, 2]
        r2 = np.maximum(x * x + y * y, _SMALLEST**2)
        r = np.sqrt(r2)
        theta = np.arctan2(r, z)
        distance, slope = cls._curve(p, theta)
        # neither beyond the fold, nor straight behind, nor the projection centre itself
        valid = (slope > 0) & (theta < np.pi) & ((r2 > _SMALLEST**2) | (z > 0))
        inverse = 1 / np.where(valid, r, np.nan)
        scale = distance * inverse
        return np.stack([x * scale, y * scale]), r2, theta, slope, inverse, scale

    @classmethod
    def _image(cls, p: FloatArray, points_cam: FloatArray) -> FloatArray:
        return cls._bent(p, points_cam)[0]

    @classmethod
    def project_block(
        cls,
        parameters: FloatArray,
        points_cam: FloatArray,
        d_parameters: FloatArray,
        d_points: FloatArray,
    ) -> FloatArray:
        """Project views (V, 3, N) with all derivatives; see `Lens.project_block`."""
        p = np.ascontiguousarray(parameters.T)[:, :, None]
        d_p, d_x = d_parameters.transpose(1, 2, 0, 3), d_points.transpose(1, 2, 0, 3)
        image, r2, theta, slope, inverse, scale = cls._bent(p, points_cam)

        d_p[0, 0], d_p[1, 1] = image
        d_p[2, 0] = d_p[3, 1] = 1
        d_p[0, 1] = d_p[1, 0] = d_p[2, 1] = d_p[3, 0] = 0
        squared = theta * theta
        cubed = theta * squared * inverse
        # d(theta)/dX = X Z / (r rho^2), d(theta)/dZ = -r / rho^2, d(X/r)/dX = 1/r - X^2 / r^3
        x, y, z = points_cam[:, 0], points_cam[:, 1], points_cam[:, 2]
        per_rho2 = slope / (r2 + z * z)
        turning = (per_rho2 * z - scale) / r2
        for row, along in enumerate((x, y)):
            along_px = p[row] * along
            np.multiply(along_px, cubed, out=d_p[4, row])
            for column in 5, 6, 7:
                np.multiply(d_p[column - 1, row], squared, out=d_p[column, row])
            turning_px = turning * along_px
            np.multiply(turning_px, x, out=d_x[0, row])
            np.multiply(turning_px, y, out=d_x[1, row])
            d_x[row, row] += p[row] * scale
            np.multiply(along_px, -per_rho2, out=d_x[2, row])
        return (p[:2] * image + p[2:4]).swapaxes(0, 1)

    def _rays(self, image: FloatArray) -> FloatArray:
        p = self.parameters[:, None]
        distance = np.hypot(*image)
        theta = invert_rising(lambda angle: self._curve(p, angle), distance, self.max_angle_rad)
        per_distance = np.sin(theta) / np.where(distance > 0, distance, 1)
        return np.stack([*(image * per_distance), np.cos(theta)])

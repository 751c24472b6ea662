"""What the lenses share that bend the plane z = 1 along the radius, and a little across it."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses.base import Lens
from calichrome.geometry.lenses.curves import first_fold, invert_rising

__all__ = ["RadialTangential"]

_NEAR_IMAGE = 1e-14  # of the image: rounding; near a fold the plane follows only as its root
_NEAR_PLANE = 1e-11  # of the plane: the last step squares it; near a pole the image is all rounding
_MAX_STEPS = 100  # of Newton's method, shortened ones included
_SHORTEST = 1e-4  # of a Newton step: no progress any more
_START = 0.999  # of the way to the end: the Jacobian is singular at the end itself


@dataclass(frozen=True, slots=True, kw_only=True)
class RadialTangential(Lens):
    """Parameters begin with fx fy cx cy k1 k2 p1 p2 k3, as in OpenCV.

    Notes
    -----
    With v = (X/Z, Y/Z), s = v.v, q = (p2, p1) and the radial factor g(s) of the model, the image is
    ``v (g + 2 q.v) + q s``. It is the gradient of a function of v, so its Jacobian is symmetric:
    ``(g + 2 q.v) I + 2 g' v v' + 2 (q v' + v q')``. The radial part alone stretches by d(r g)/dr
    along the radius and by g across it; the rest takes away at most 6 |q| r of either. Inside the
    disc in which both stay above that, the function is convex and no two points share an image.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @classmethod
    @abstractmethod
    def _radial(cls, p: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radial factor g and its slope dg/ds at s = r^2, both new arrays shaped like s."""

    @classmethod
    @abstractmethod
    def _d_radial(cls, p: FloatArray, s: FloatArray, plane_px: FloatArray, out: FloatArray) -> None:
        """Write the rows of the radial coefficients into `out` (P, 2, V, N); plane_px is f v."""

    @property
    @abstractmethod
    def _fraction(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Coefficients of the radial factor's numerator and denominator by rising powers of s."""

    @property
    def max_angle_rad(self) -> float:
        """Angle from the axis below which every ray has a pixel of its own."""
        return float(np.arctan(self._end))

    @property
    def _end(self) -> float:
        """Radius of the disc of the plane z = 1 inside which no two points share an image."""
        return first_fold(*self._fraction, 6 * float(np.hypot(self.p1, self.p2)))

    def _rays(self, image: FloatArray) -> FloatArray:
        end = self._end
        p = self.parameters[:, None]
        distance = np.hypot(*image)

        def curve(radius: FloatArray) -> tuple[FloatArray, FloatArray]:
            g, slope = self._radial(p, radius * radius)
            return radius * g, g + 2 * radius * radius * slope

        tangential = bool(self.p1 or self.p2)
        if tangential and np.isfinite(end):  # they carry some images beyond the radial curve
            farthest = _START * curve(np.array([end]))[0]  # nan at a pole
            distance = np.where(distance > farthest, farthest, distance)
        radius = invert_rising(curve, distance, end)
        plane = image * (radius / np.maximum(np.hypot(*image), np.finfo(np.float64).tiny))
        if tangential:
            plane = self._newton(p, plane, image, end)
        return np.stack([*plane, np.where(np.isfinite(plane[0]), 1.0, np.nan)])

    def _newton(
        self, p: FloatArray, start: FloatArray, image: FloatArray, end: float
    ) -> FloatArray:
        """Solve for the plane (2, N) by Newton's method; nan where it leads out of the disc.

        A step is shortened until it brings the image nearer and stays inside the disc.
        """
        found = np.full(image.shape, np.nan)
        todo = np.flatnonzero(np.isfinite(start[0]))
        plane, target = start[:, todo], image[:, todo]
        step, share, off = np.zeros_like(plane), np.ones(len(todo)), np.full(len(todo), np.inf)
        for _ in range(_MAX_STEPS):
            if not len(todo):
                break
            trial = plane - share * step
            bent, _, _, slope, factor = self._bent(p, trial)
            (xx, yy), xy = self._d_bent(p, trial, slope, factor)
            error = bent - target
            trial_off = np.hypot(*error)
            better = (trial_off < off) & (np.hypot(*trial) < end)
            newton = (np.stack([yy, xx]) * error - xy * error[::-1]) / (xx * yy - xy * xy)
            plane, step = np.where(better, trial, plane), np.where(better, newton, step)
            off, share = np.where(better, trial_off, off), np.where(better, 1.0, share / 2)
            done = (off <= _NEAR_IMAGE * (1 + np.hypot(*target))) | (
                np.hypot(*step) <= _NEAR_PLANE * np.hypot(*plane)
            )
            found[:, todo[done]] = (plane - step)[:, done]
            left = ~done & (share > _SHORTEST)
            todo, share, off = todo[left], share[left], off[left]
            plane, target, step = plane[:, left], target[:, left], step[:, left]
        return np.where(np.hypot(*found) < end, found, np.nan)

    @classmethod
    def _image(cls, p: FloatArray, points_cam: FloatArray) -> FloatArray:
        plane, _ = _on_plane(points_cam)
        return cls._bent(p, plane)[0]

    @classmethod
    def _bent(cls, p: FloatArray, plane: FloatArray) -> tuple[FloatArray, ...]:
        """Return the image (2, V, N), x^2 and y^2 (2, V, N), s, the slope of g, and g + 2 q.v."""
        q = p[7:5:-1]
        squares = plane * plane
        s = squares[0] + squares[1]
        g, slope = cls._radial(p, s)
        g += (2 * q[0]) * plane[0]
        g += (2 * q[1]) * plane[1]
        image = plane * g
        image += q * s
        return image, squares, s, slope, g

    @classmethod
    def _d_bent(
        cls, p: FloatArray, plane: FloatArray, slope: FloatArray, factor: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Differentiate the image by the plane: both diagonal elements (2, V, N), the mixed one."""
        q = p[7:5:-1]
        turning = (2 * slope) * plane
        mixed = turning[0] * plane[1]
        mixed += (2 * q[1]) * plane[0]
        mixed += (2 * q[0]) * plane[1]
        turning += 4 * q
        turning *= plane
        turning += factor
        return turning, mixed

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
        focal = p[:2]
        d_p, d_x = d_parameters.transpose(1, 2, 0, 3), d_points.transpose(1, 2, 0, 3)
        plane, inverse = _on_plane(points_cam)
        image, squares, s, slope, factor = cls._bent(p, plane)
        straight, mixed = cls._d_bent(p, plane, slope, factor)
        pixels = focal * image
        pixels += p[2:4]

        d_p[0, 0], d_p[1, 1] = image
        d_p[2, 0] = d_p[3, 1] = 1
        d_p[0, 1] = d_p[1, 0] = d_p[2, 1] = d_p[3, 0] = 0
        plane_px = focal * plane
        cls._d_radial(p, s, plane_px, d_p)
        twice = 2 * plane
        np.multiply(plane_px[0], twice[1], out=d_p[6, 0])
        np.multiply(plane_px[1], twice[0], out=d_p[7, 1])
        squares *= 2
        squares += s
        np.multiply(focal[0], squares[0], out=d_p[7, 0])
        np.multiply(focal[1], squares[1], out=d_p[6, 1])

        px_per_m = focal * inverse
        for row in 0, 1:  # of the symmetric 2 x 2 block, then of the depth
            np.multiply(px_per_m[row], straight[row], out=d_x[row, row])
            np.multiply(px_per_m[row], mixed, out=d_x[1 - row, row])
        plane_x, plane_y = plane
        depth = d_x[0] * plane_x
        depth += d_x[1] * plane_y
        np.negative(depth, out=d_x[2])
        return pixels.swapaxes(0, 1)


def _on_plane(points_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x/z and y/z, (2, V, N), and 1/z, (V, N), of points (V, 3, N); nan behind."""
    inverse = 1 / np.where(points_cam[:, 2] > 0, points_cam[:, 2], np.nan)
    plane = np.empty((2, *inverse.shape))
    np.multiply(points_cam[:, 0], inverse, out=plane[0])
    np.multiply(points_cam[:, 1], inverse, out=plane[1])
    return plane, inverse

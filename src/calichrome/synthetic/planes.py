"""Flat things in one picture: where they are seen, and which share of each pixel they cover."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.synthetic.coverage import (
    RAMP_VARIANCE_PX2,
    Grid,
    filtered,
    pixels_per_unit,
    plane_coordinates,
    sampled,
    soft_step,
)

__all__ = ["Bounds", "PlanePatch"]

Bounds = tuple[float, float, float, float]
"""u0, u1, v0, v1 of a rectangle of the plane, metres."""

_FAR_M = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class PlanePatch:
    """The part of a picture in which a rectangle of a plane is seen.

    Parameters
    ----------
    origin_yx : (2,) int
        Row and column of its first pixel in the picture.
    padding
        Pixels by which `u_padded` and `v_padded` reach beyond the patch on each side; one more
        than the filter's radius.
    u_padded, v_padded : (h + 2 padding, w + 2 padding) float, metres
        Coordinates of pixel centres on the plane.
    psf_sigma_px
        Standard deviation of the point spread.
    """

    origin_yx: tuple[int, int]
    padding: int
    u_padded: FloatArray
    v_padded: FloatArray
    psf_sigma_px: float

    @classmethod
    def whole_picture(
        cls, rays_cam: FloatArray, cam_from_plane: Pose, padding: int, psf_sigma_px: float
    ) -> "PlanePatch":
        """Return the plane in all of a picture, from its rays (H + 2 padding, W + 2 padding, 3)."""
        u, v = (
            # A plane that recedes beyond its horizon covers nothing there: put it far away.
            np.nan_to_num(values, nan=_FAR_M)
            for values in plane_coordinates(rays_cam, cam_from_plane)
        )
        return cls((0, 0), padding, u, v, psf_sigma_px)

    @property
    def u(self) -> FloatArray:
        """First plane coordinate of the pixels, (h, w), metres."""
        return self.u_padded[self.padding : -self.padding, self.padding : -self.padding]

    @property
    def v(self) -> FloatArray:
        """Second plane coordinate of the pixels, (h, w), metres."""
        return self.v_padded[self.padding : -self.padding, self.padding : -self.padding]

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the patch in the picture."""
        (y, x), (height, width) = self.origin_yx, self.u.shape
        return slice(y, y + height), slice(x, x + width)

    def around(self, bounds: Bounds) -> "PlanePatch | None":
        """Return the smaller patch that a rectangle reaches, blur included; None if none."""
        u0, u1, v0, v1 = bounds
        u, v = self.u_padded, self.v_padded
        inside = (u >= u0) & (u <= u1) & (v >= v0) & (v <= v1)
        height, width = self.u.shape
        rows = _reached(inside.any(axis=1), self.padding, height)
        columns = _reached(inside.any(axis=0), self.padding, width)
        if rows is None or columns is None:
            return None
        (y0, y1), (x0, x1) = rows, columns
        part = slice(y0, y1 + 2 * self.padding), slice(x0, x1 + 2 * self.padding)
        origin = self.origin_yx[0] + y0, self.origin_yx[1] + x0
        return PlanePatch(origin, self.padding, u[part], v[part], self.psf_sigma_px)

    def rectangle(self, bounds: Bounds) -> FloatArray:
        """Share of each pixel that a rectangle covers, (h, w), 0..1."""
        u, v = sampled(self.u_padded), sampled(self.v_padded)
        return self._filtered(
            _interval(u, bounds[:2], pixels_per_unit(self.u_padded))
            * _interval(v, bounds[2:], pixels_per_unit(self.v_padded))
        )

    def checkerboard(
        self, squares: tuple[int, int], square_m: tuple[float, float], *, black_first: bool
    ) -> FloatArray:
        """Share of each pixel that a chessboard's black squares cover, (h, w), 0..1.

        Parameters
        ----------
        squares, square_m : (2,)
            Number and size of the squares; square [0, 0] covers u and v from -square_m to 0.
        black_first
            Whether square [0, 0] is black.
        """
        waves, area = [], []
        for padded, n_squares, side_m in zip(
            (self.u_padded, self.v_padded), squares, square_m, strict=True
        ):
            position, slope = sampled(padded / side_m), pixels_per_unit(padded / side_m)
            # Nearest line between squares: the rim is not one, the colour does not change there.
            line = np.clip(np.round(position), 0, n_squares - 2)
            sign = np.float32(1) - np.float32(2) * (line % np.float32(2))
            waves.append(sign * soft_step((position - line) * slope))
            area.append(_interval(position, (-1, n_squares - 1), slope))
        first = np.float32(1 if black_first else -1)
        # A product of two waves is the exact pattern; at a corner the ramp, not the Gaussian,
        # is a product along the board's axes, which keeps it symmetric about the corner.
        return self._filtered(area[0] * area[1] * _share(first * waves[0] * waves[1]))

    def disc(self, centre_uv: tuple[float, float], radius_m: float) -> FloatArray:
        """Share of each pixel that a disc covers, (h, w), 0..1."""
        du, dv = self.u_padded - centre_uv[0], self.v_padded - centre_uv[1]
        # The gradient of the distance vanishes in the centre, far from the edge: any slope serves.
        slope = pixels_per_unit(np.hypot(du, dv))
        inwards_px = (np.float32(radius_m) - np.hypot(sampled(du), sampled(dv))) * slope
        # A ramp about a curved edge has more of its area outside; this keeps the disc's area.
        inwards_px -= np.float32(RAMP_VARIANCE_PX2 / 2) / (np.float32(radius_m) * slope)
        return self._filtered(_share(soft_step(inwards_px)))

    def _filtered(self, samples: Grid) -> FloatArray:
        return filtered(samples, self.psf_sigma_px)


def _interval(position: Grid, ends: tuple[float, float], slope: Grid) -> Grid:
    """Share 0..1 between two ends, soft at both."""
    half, middle = np.float32((ends[1] - ends[0]) / 2), np.float32((ends[1] + ends[0]) / 2)
    return _share(soft_step((half - np.abs(position - middle)) * slope))


def _share(step: Grid) -> Grid:
    """Turn -1..1 into 0..1."""
    return (step + np.float32(1)) * np.float32(0.5)


def _reached(lines: ArrayLike, padding: int, length: int) -> tuple[int, int] | None:
    """Rows (or columns) of a patch within `padding` of the marked ones of its padded grid."""
    marked = np.flatnonzero(np.asarray(lines))
    if not len(marked):
        return None
    # Line i of the padded grid is line i - padding of the patch.
    first = max(0, int(marked[0]) - 2 * padding)
    end = min(length, int(marked[-1]) + 1)
    return (first, end) if first < end else None

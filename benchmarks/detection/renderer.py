"""A board in a picture, exact in its sub-pixel phase, with derivatives by position.

Edges are drawn 4 x 4 per pixel with a ramp of known variance; then one exact kernel, the rest of
the Gaussian integrated over the square pixel, turns samples into pixels. The same kernel,
differentiated, gives how every pixel changes as the picture moves.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.special import erf

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic.coverage import (
    RAMP_VARIANCE_PX2,
    SAMPLES,
    Grid,
    pixels_per_unit,
    plane_coordinates,
    sampled,
    soft_step,
)

__all__ = ["Bounds", "Canvas", "Picture", "Shape", "checkers", "disc", "reach", "rectangle"]

Picture = NDArray[np.float32]
"""(H, W) float; 0..1 for a share of a pixel."""

Bounds = tuple[float, float, float, float]
"""u0, u1, v0, v1 of a rectangle of the board plane."""

Shape = Callable[[Grid, Grid, Grid, Grid], Grid]
"""Coordinates u, v and pixels per unit of u and v, (h, 4, w, 4) -> samples of a pattern."""

_COARSE_PX = 8
"""Spacing of the points where rays are cast; a cubic spline between them is off by 7e-6 px at most
in the first 60 scenes."""

_BAND_ROWS = 128
"""Rows drawn at once: 128 rows of 4000 px are 33 MB of samples."""

_TRUNCATION_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class Canvas:
    """What a camera sees of the plane of a board.

    Parameters
    ----------
    lens, cam_from_board, size_wh
        The camera, where the board is, and the size of the picture.
    unit_m
        Length of one unit of u and v; a square, say.
    psf_sigma_px
        Point spread, standard deviation.
    """

    lens: BrownConrady
    cam_from_board: Pose
    size_wh: tuple[int, int]
    unit_m: float
    psf_sigma_px: float

    @property
    def radius_px(self) -> int:
        """Pixels beyond a pixel on which its value depends."""
        return math.ceil(_TRUNCATION_SIGMAS * self.psf_sigma_px + 0.5)

    def pixels_of(self, points_uv: FloatArray) -> FloatArray:
        """Project points (..., 2) of the plane to pixels (..., 2)."""
        flat = np.asarray(points_uv, dtype=np.float64).reshape(-1, 2) * self.unit_m
        points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
        pixels = self.lens.project(self.cam_from_board.apply(points))
        return np.asarray(pixels.reshape(points_uv.shape))

    def window(self, bounds: Bounds) -> tuple[slice, slice] | None:
        """Rows and columns of the picture that a rectangle reaches; None if it is outside."""
        u0, u1, v0, v1 = bounds
        t = np.linspace(0, 1, 33)
        u, v = u0 + (u1 - u0) * t, v0 + (v1 - v0) * t
        rim = np.concatenate(
            [
                np.stack(np.broadcast_arrays(a, b), -1)
                for a, b in ((u, v0), (u, v1), (u0, v), (u1, v))
            ]
        )
        pixels = self.pixels_of(rim)
        low = np.floor(pixels.min(axis=0)).astype(int) - self.radius_px
        high = np.ceil(pixels.max(axis=0)).astype(int) + self.radius_px + 1
        low, high = np.maximum(low, 0), np.minimum(high, self.size_wh)
        if (low >= high).any():
            return None
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def plane(self, window: tuple[slice, slice], padding: int) -> tuple[FloatArray, FloatArray]:
        """Coordinates u, v of the pixels of a window and of `padding` more on each side."""
        rows = np.arange(window[0].start - padding, window[0].stop + padding, dtype=np.float64)
        columns = np.arange(window[1].start - padding, window[1].stop + padding, dtype=np.float64)
        coarse_y, coarse_x = _coarse(rows), _coarse(columns)
        pixels = np.stack(np.meshgrid(coarse_x, coarse_y), axis=-1)
        u, v = plane_coordinates(self.lens.unproject(pixels), self.cam_from_board)
        fine = [
            RectBivariateSpline(coarse_y, coarse_x, values / self.unit_m)(rows, columns)
            for values in (u, v)
        ]
        return fine[0], fine[1]

    def draw(
        self, shape: Shape, window: tuple[slice, slice], *, derivatives: bool = False
    ) -> list[Picture]:
        """Draw a pattern of the plane into a window.

        Parameters
        ----------
        shape
            The pattern; its edges are ramps (`soft_step`).
        derivatives
            Whether to return how the pixels change as the pattern moves.

        Returns
        -------
        list of (h, w) float
            The picture; with derivatives also those by the pattern's x and y, per pixel.
        """
        radius = self.radius_px
        smooth, slope = _kernels(self.psf_sigma_px, radius)
        pairs = [(smooth, smooth), (smooth, slope), (slope, smooth)]  # along y, along x
        bands = []
        for start in range(window[0].start, window[0].stop, _BAND_ROWS):
            band = slice(start, min(start + _BAND_ROWS, window[0].stop)), window[1]
            u, v = self.plane(band, radius + 1)
            samples = shape(sampled(u), sampled(v), pixels_per_unit(u), pixels_per_unit(v))
            bands.append([_filtered(samples, *pair) for pair in pairs[: 3 if derivatives else 1]])
        return [np.concatenate(parts) for parts in zip(*bands, strict=True)]


def reach(points_uv: FloatArray, margin: float) -> Bounds:
    """Return the bounds of points (..., 2), widened by a margin."""
    flat = points_uv.reshape(-1, 2)
    (u0, v0), (u1, v1) = flat.min(axis=0) - margin, flat.max(axis=0) + margin
    return float(u0), float(u1), float(v0), float(v1)


def rectangle(bounds: Bounds) -> Shape:
    """Return a rectangle: 1 inside, 0 outside."""

    def shape(u: Grid, v: Grid, u_px: Grid, v_px: Grid) -> Grid:
        return _interval(u, bounds[:2], u_px) * _interval(v, bounds[2:], v_px)

    return shape


def checkers(squares: tuple[int, int], *, black_first: bool) -> Shape:
    """Return the black squares of a chessboard whose square [0, 0] covers u, v from -1 to 0."""
    first = np.float32(1 if black_first else -1)

    def shape(u: Grid, v: Grid, u_px: Grid, v_px: Grid) -> Grid:
        wave = first * _wave(u, squares[0], u_px) * _wave(v, squares[1], v_px)
        area = _interval(u, (-1, squares[0] - 1), u_px) * _interval(v, (-1, squares[1] - 1), v_px)
        return area * _share(wave)

    return shape


def disc(centre_uv: Sequence[float], radius: float) -> Shape:
    """Return a disc: 1 inside, 0 outside."""
    u0, v0 = (np.float32(value) for value in centre_uv)

    def shape(u: Grid, v: Grid, _: Grid, __: Grid) -> Grid:
        du, dv = u - u0, v - v0
        distance = np.hypot(du, dv)
        # The gradient of the distance, taken from sample to sample: it knows the foreshortening.
        slope = _sample_slope(distance)
        inwards_px = (np.float32(radius) - distance) * slope
        # A ramp about a curved edge has more of its area outside; this keeps the disc's area.
        inwards_px -= np.float32(RAMP_VARIANCE_PX2 / 2) / (np.float32(radius) * slope)
        return _share(soft_step(inwards_px))

    return shape


def _wave(position: Grid, n_squares: int, slope: Grid) -> Grid:
    # Nearest line between squares: the rim is not one, the colour does not change there.
    line = np.clip(np.round(position), 0, n_squares - 2)
    sign = np.float32(1) - np.float32(2) * (line % np.float32(2))
    return np.asarray(sign * soft_step((position - line) * slope))


def _interval(position: Grid, ends: tuple[float, float], slope: Grid) -> Grid:
    half, middle = np.float32((ends[1] - ends[0]) / 2), np.float32((ends[1] + ends[0]) / 2)
    return _share(soft_step((half - np.abs(position - middle)) * slope))


def _share(step: Grid) -> Grid:
    """Turn -1..1 into 0..1."""
    return (step + np.float32(1)) * np.float32(0.5)


def _sample_slope(values: Grid) -> Grid:
    """Pixels per unit of values that are given at the samples."""
    height, n, width, _ = values.shape
    down, across = np.gradient(values.reshape(height * n, width * n), np.float32(1 / SAMPLES))
    slope = 1 / np.maximum(np.hypot(across, down), np.float32(1e-9))
    return np.asarray(slope.reshape(values.shape), dtype=np.float32)


def _coarse(line: FloatArray) -> FloatArray:
    """Cover a line of pixels with points for a cubic spline."""
    n_points = max(4, math.ceil((line[-1] - line[0]) / _COARSE_PX) + 1)
    return np.linspace(line[0], line[-1], n_points)


def _kernels(psf_sigma_px: float, radius: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weights of samples in a pixel, (2 radius + 1, 4), and their derivative by position."""
    sigma = math.sqrt(psf_sigma_px**2 - RAMP_VARIANCE_PX2)
    n_pixels = 2 * radius + 1
    offsets = (np.arange(n_pixels * SAMPLES) + 0.5) / SAMPLES - n_pixels / 2
    ends = (offsets + 0.5) / sigma, (offsets - 0.5) / sigma
    smooth = (erf(ends[0] / math.sqrt(2)) - erf(ends[1] / math.sqrt(2))) / 2
    gauss = [np.exp(-(end**2) / 2) / (sigma * math.sqrt(2 * math.pi)) for end in ends]
    # Moved by d, a sample at t goes to t + d: the derivative by d is that of smooth(t).
    slope = gauss[0] - gauss[1]
    return (
        (smooth / smooth.sum()).reshape(-1, SAMPLES).astype(np.float32),
        (slope / smooth.sum()).reshape(-1, SAMPLES).astype(np.float32),
    )


def _filtered(samples: Grid, along_y: NDArray[np.float32], along_x: NDArray[np.float32]) -> Picture:
    """Weight samples (h, 4, w, 4) into the pixels (h - 2 r, w - 2 r) that have all of them."""
    height, _, width, _ = samples.shape
    n_taps = len(along_y)
    rows = np.matmul(along_y, samples.reshape(height, SAMPLES, width * SAMPLES))
    kept = height - n_taps + 1
    summed = rows[:kept, 0]
    for step in range(1, n_taps):
        summed = summed + rows[step : step + kept, step]
    columns = summed.reshape(kept, width, SAMPLES) @ along_x.T
    kept = width - n_taps + 1
    result = columns[:, :kept, 0]
    for step in range(1, n_taps):
        result = result + columns[:, step : step + kept, step]
    return np.asarray(result, dtype=np.float32)

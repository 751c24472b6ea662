"""Which share of each pixel a flat shape covers, after the point spread and the square pixel.

A shape is sampled 4 x 4 per pixel. Its edges are drawn with a triangular ramp of known variance
instead of a jump, so that an edge does not snap to the sample grid; the Gaussian that follows is
narrowed by that variance, and the sum is the point spread that was asked for.
"""

import math

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose

__all__ = [
    "RAMP_VARIANCE_PX2",
    "SAMPLES",
    "Grid",
    "filter_radius_px",
    "filtered",
    "pixels_per_unit",
    "plane_coordinates",
    "sampled",
    "soft_step",
]

SAMPLES = 4  # per pixel and axis
_RAMP_PX = 0.5  # half width of the edge ramp: two samples, so that neither falls between them
RAMP_VARIANCE_PX2 = _RAMP_PX**2 / 6
# The mean of 4 samples is a narrower box than the pixel: (1 - 1/16) / 12 instead of 1 / 12.
_BOX_DEFICIT_PX2 = 1 / (12 * SAMPLES**2)
_TRUNCATION_SIGMAS = 4.0
_OFFSETS = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5

Grid = NDArray[np.float32]
"""Sampled values, shape (h, 4, w, 4): pixel row, sample row, pixel column, sample column."""


def filter_radius_px(psf_sigma_px: float) -> int:
    """Return how many pixels beyond a pixel its value depends on."""
    return math.ceil(_TRUNCATION_SIGMAS * psf_sigma_px)


def plane_coordinates(rays_cam: FloatArray, cam_from_plane: Pose) -> tuple[FloatArray, FloatArray]:
    """Intersect rays with the plane z = 0 of a frame.

    Parameters
    ----------
    rays_cam : (..., 3) float
        Rays from the camera centre, any length.

    Returns
    -------
    u, v : (...) float, metres
        Coordinates on the plane; nan where the plane is behind the camera.
    """
    basis = np.column_stack([cam_from_plane.rotation[:, :2], cam_from_plane.trans_m])
    homogeneous = rays_cam @ np.linalg.inv(basis).T
    weight = homogeneous[..., 2]
    weight = np.where(weight > 0, weight, np.nan)
    return homogeneous[..., 0] / weight, homogeneous[..., 1] / weight


def sampled(values: FloatArray) -> Grid:
    """Interpolate pixel values with a ring of one pixel, (h + 2, w + 2), to samples (h, 4, w, 4).

    Quadratic: what it leaves out of a lens and a perspective is of third order, below 1e-5 px.
    """
    before = _OFFSETS * (_OFFSETS - 1) / 2
    centre = 1 - _OFFSETS**2
    after = _OFFSETS * (_OFFSETS + 1) / 2
    rows = (
        values[:-2, None] * before[:, None]
        + values[1:-1, None] * centre[:, None]
        + values[2:, None] * after[:, None]
    ).astype(np.float32)
    return np.asarray(
        rows[:, :, :-2, None] * before.astype(np.float32)
        + rows[:, :, 1:-1, None] * centre.astype(np.float32)
        + rows[:, :, 2:, None] * after.astype(np.float32)
    )


def pixels_per_unit(values: FloatArray) -> Grid:
    """Return 1 / |gradient| of pixel values with a ring, (h + 2, w + 2), as (h, 1, w, 1)."""
    across = (values[1:-1, 2:] - values[1:-1, :-2]) / 2
    down = (values[2:, 1:-1] - values[:-2, 1:-1]) / 2
    slope = 1 / np.maximum(np.hypot(across, down), 1e-12)
    return slope[:, None, :, None].astype(np.float32)


def soft_step(distance_px: Grid) -> Grid:
    """Return -1..1 across an edge, 0 on it: the jump convolved with the triangular ramp."""
    ramp = np.clip(distance_px / np.float32(_RAMP_PX), -1, 1)
    return np.asarray(ramp * (2 - np.abs(ramp)))


def filtered(samples: Grid, psf_sigma_px: float) -> FloatArray:
    """Convolve samples with the rest of the point spread and the pixel, and keep one per pixel.

    Parameters
    ----------
    samples : (h, 4, w, 4) float

    Returns
    -------
    (h - 2 r, w - 2 r) float
        Values of the inner pixels, r = `filter_radius_px`.
    """
    radius = filter_radius_px(psf_sigma_px)
    kernel = _kernel(psf_sigma_px, radius)  # (2 r + 1, 4)
    height, _, width, _ = samples.shape
    rows = np.matmul(kernel, samples.reshape(height, SAMPLES, width * SAMPLES))
    kept = height - 2 * radius
    summed = rows[:kept, 0]
    for step in range(1, 2 * radius + 1):
        summed = summed + rows[step : step + kept, step]
    columns = summed.reshape(kept, width, SAMPLES) @ kernel.T
    kept = width - 2 * radius
    result = columns[:, :kept, 0]
    for step in range(1, 2 * radius + 1):
        result = result + columns[:, step : step + kept, step]
    return np.asarray(result, dtype=np.float64)


def _kernel(psf_sigma_px: float, radius: int) -> Grid:
    variance = psf_sigma_px**2 + _BOX_DEFICIT_PX2 - RAMP_VARIANCE_PX2
    steps = np.arange(-SAMPLES * radius, SAMPLES * radius + 1) / SAMPLES
    gauss = np.exp(-(steps**2) / (2 * variance))
    kernel = np.convolve(gauss / gauss.sum(), np.full(SAMPLES, 1 / SAMPLES))
    return kernel.reshape(-1, SAMPLES).astype(np.float32)

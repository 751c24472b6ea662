"""Many small least-squares problems at once: a saddle per corner, weighted by its pixels' noise."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.detection.blurred_saddle import SaddleParameters, saddle_and_derivatives
from calichrome.detection.corner_pixels import CornerPixels

__all__ = [
    "MIN_PIXELS",
    "N_ALONE",
    "Equations",
    "NoiseOfLevels",
    "inverse",
    "normal_equations",
    "solved",
]

_OUTLIER_SIGMAS = 5.0
_OUTLIER_LEVEL = 8 / 255  # what the model may be wrong by, beyond noise
_PIXELS_AT_ONCE = 4000
_FLAT = 0.8  # of the way from edge to white: 1.3 sigma of the blur beside an edge
_FEWEST_PIXELS_OF_LEVEL = 100
_LEAST_SHARE = 0.3  # of the largest noise: clipped white has none, and must not outweigh all else
_LEAST_NOISE = 1e-4  # of full scale, so that pictures without noise have weights too
MIN_PIXELS = 14  # twice the parameters that a corner determines alone
N_ALONE = 7  # parameters that a corner determines alone: position, angles, blur, two levels


@dataclass(frozen=True, slots=True, eq=False)
class NoiseOfLevels:
    """Standard deviation (3,) of pixels that are black, half way and white, levels 0..1.

    Light is noisier than darkness, above all where an encoding was removed; half way lie the
    edges, which print and lens blur as they like.
    """

    sigma: FloatArray

    @classmethod
    def of(cls, residuals: FloatArray, brightness: FloatArray) -> "NoiseOfLevels":
        """Estimate from residuals (P,) at brightness (P,), -1 black to 1 white."""
        group = np.digitize(brightness, [-_FLAT, _FLAT])
        every = _robust_sigma(residuals)
        sigma = [
            _robust_sigma(residuals[group == index])
            if np.count_nonzero(group == index) >= _FEWEST_PIXELS_OF_LEVEL
            else every
            for index in range(3)
        ]
        return cls(np.maximum(sigma, max(_LEAST_SHARE * max(sigma), _LEAST_NOISE)))

    def weights(self, residuals: FloatArray, brightness: FloatArray) -> FloatArray:
        """Return 1 / sigma (P,), 0 for outliers."""
        sigma = np.interp(brightness, [-1, 0, 1], self.sigma)
        return (np.abs(residuals) <= _OUTLIER_SIGMAS * sigma + _OUTLIER_LEVEL) / sigma


def _robust_sigma(residuals: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(residuals))) if len(residuals) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equations:
    """J'J (N, n, n), J'r (N, n), r'r (N,) and how many pixels count (N,).

    `residuals` and `brightness` (P,) are those of the pixels, not weighted.
    """

    normal: FloatArray
    right: FloatArray
    squares: FloatArray
    n_pixels: IntArray
    residuals: FloatArray
    brightness: FloatArray

    def squares_after(self, steps: FloatArray) -> FloatArray:
        """Sum of squared residuals after steps (N, n), of the linearised model."""
        gain = 2 * (steps * self.right).sum(axis=1)
        bent = (self.normal @ steps[..., None])[..., 0]
        return np.asarray(self.squares - gain + (steps * bent).sum(axis=1))

    def variance(self, squares: FloatArray) -> float:
        """Return the variance of the residuals of the median corner."""
        told = self.n_pixels > MIN_PIXELS
        if not told.any():
            return _OUTLIER_LEVEL**2
        return float(np.median(squares[told] / (self.n_pixels[told] - N_ALONE)))


def normal_equations(
    parameters: SaddleParameters,
    pixels: CornerPixels,
    seen: FloatArray,
    n_free: int,
    noise: NoiseOfLevels | None = None,
) -> Equations:
    """Linearise the model at the pixels, weighted by their noise if that is known."""
    count = len(parameters)
    ranges = pixels.ranges(count)
    products = np.empty((count, n_free + 1, n_free + 1))
    n_pixels = np.zeros(count, dtype=np.int64)
    residuals, brightness = np.empty(len(pixels)), np.empty(len(pixels))
    sign = np.sign(parameters.values[:, 6])
    # A few corners at a time, so that the arrays stay in the processor's cache.
    groups = np.searchsorted(ranges, np.arange(0, len(pixels), _PIXELS_AT_ONCE))
    first = 0
    for last in np.unique(np.concatenate([groups, [count]])):
        span = slice(ranges[first], ranges[last])
        corner = pixels.corner[span]
        predicted, derivatives = saddle_and_derivatives(
            parameters, corner, pixels.points[span], n_free
        )
        residuals[span] = seen[span] - predicted
        brightness[span] = derivatives[6] * sign[corner]  # dI / db is the saddle, -1..1
        stacked = np.concatenate([derivatives, residuals[None, span]])
        if noise is not None:
            stacked *= noise.weights(residuals[span], brightness[span])
        for index in range(first, last):
            own = stacked[:, ranges[index] - span.start : ranges[index + 1] - span.start]
            np.matmul(own, own.T, out=products[index])
            n_pixels[index] = np.count_nonzero(own[5])  # dI / da is 1 where a pixel counts
        first = last
    return Equations(
        normal=products[:, :n_free, :n_free],
        right=products[:, :n_free, n_free],
        squares=products[:, n_free, n_free],
        n_pixels=n_pixels,
        residuals=residuals,
        brightness=brightness,
    )


def _scaled(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Scale to a unit diagonal, with a trace of damping for corners without pixels."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-12))
    scaled = normal * scale[:, :, None] * scale[:, None, :]
    return scaled + 1e-10 * np.eye(normal.shape[1]), scale


def solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return the steps (N, n) of normal equations (N, n, n), (N, n)."""
    scaled, scale = _scaled(normal)
    return np.asarray(np.linalg.solve(scaled, (right * scale)[..., None])[..., 0] * scale)


def inverse(normal: FloatArray) -> FloatArray:
    """Return the inverses of matrices (N, n, n)."""
    scaled, scale = _scaled(normal)
    return np.asarray(np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :])

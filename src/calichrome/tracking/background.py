"""The empty scene of one camera, and what differs from it.

Each pixel of the empty scene has a mean; how far pixels scatter about it depends on their level
alone, so it is learnt from all pixels together: a dozen empty frames are enough, where a variance
per pixel would need hundreds before its quantiles could be trusted.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["Background", "Picture"]

Picture = NDArray[np.float32]
"""(H, W, 3), linear light."""

_FALSE_ALARM = 1e-5  # choice: a few pixels of a picture, which the opening removes
_BRIGHTEST_GLOW = 1.1  # of the light without it
_N_LEVELS = 24  # bins in which the scatter is learnt
_AROUND = (5, 5)  # pixels whose light is averaged before it is taken for a shadow
_TINT = 0.03
"""Of a level: the shadow of one of several lamps keeps the colour of the others. With 0.01 specks
of the shadows stay that balls cast under lamps of 5000 K and 6500 K; with 0.03 none did, and no
ball lost a part (simulated workspace)."""
_STRAY = 0.01  # of a level: lamps flicker, and things near a pixel change the light on it
_LEAST_SIGMA = 1e-4  # of full scale: a noise-free picture still has its last digit


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The empty scene.

    Parameters
    ----------
    mean : (H, W, 3) float32
        Linear light.
    sigma : (H, W, 3) float32
        Standard deviation of one frame.
    noise : 3 of (L, 2) float
        Levels of each channel, and the standard deviation of pixels at that level.
    whitening : (3, 3) float32
        Takes deviations in units of `sigma`, which the channels share in part, to independent ones.
    """

    mean: Picture
    sigma: Picture
    noise: tuple[FloatArray, ...]
    whitening: Picture

    @classmethod
    def learn(cls, frames: Iterable[Picture]) -> "Background":
        """Learn from frames of the empty scene.

        Raises
        ------
        ValueError
            If there are fewer than two.
        """
        n_frames, total, squares, products = 0, None, None, None
        for frame in frames:
            if total is None or squares is None or products is None:
                first = frame
                total, squares, products = (np.zeros(frame.shape, np.float64) for _ in range(3))
            n_frames += 1
            apart = (frame - first).astype(np.float64)  # small numbers: squares keep their digits
            total += apart
            squares += apart**2
            products += apart * np.roll(apart, 1, axis=2)
        if n_frames < 2 or total is None or squares is None or products is None:
            raise ValueError("Background.learn: needs two frames or more of the empty scene")
        mean = first + total / n_frames
        spread = (squares - total**2 / n_frames) / (n_frames - 1)
        shared = (products - total * np.roll(total, 1, axis=2) / n_frames) / (n_frames - 1)
        noise = tuple(_noise_curve(mean[..., k], spread[..., k]) for k in range(3))
        sigma = _interpolated(noise, mean)
        correlation = np.eye(3)
        for channel in range(3):
            other = channel - 1
            norm = np.mean(sigma[..., channel] * sigma[..., other])
            value = float(np.clip(np.mean(shared[..., channel]) / norm, -0.95, 0.95))
            correlation[channel, other] = correlation[other, channel] = value
        sigma = np.hypot(sigma, _STRAY * mean)
        return cls(
            mean.astype(np.float32),
            sigma.astype(np.float32),
            noise,
            _inverse_root(correlation).astype(np.float32),
        )

    def sigma_at(self, values: FloatArray) -> FloatArray:
        """Return the standard deviation of pixels (..., 3) of linear light."""
        return _interpolated(self.noise, values)

    def foreground(self, frame: Picture, darkest_shadow: float) -> BoolArray:
        """Tell where the scene is not empty, (H, W).

        Parameters
        ----------
        frame : (H, W, 3) float32
            Linear light.
        darkest_shadow
            Pixels that only lost or gained light, all channels by one factor of at least this, are
            taken as shadow or glow of the background; 1 or more: nothing is.

        Notes
        -----
        The test value is the squared deviation from the mean in units of its covariance, chi-square
        of three degrees of freedom in an empty scene. For a shadow the same value is taken after
        the factor that makes it least, of the neighbourhood's mean light: the noise of one pixel
        would let grey-brown pass as a shadow of grey.
        """
        limit = float(chdtri(3, _FALSE_ALARM))
        differs = self._deviation(frame, self.mean, self.sigma) > limit
        if darkest_shadow < 1 and differs.any():
            seen, empty = (cv2.boxFilter(light, -1, _AROUND) for light in (frame, self.mean))
            # of the mean over a neighbourhood: less noise, but the tint of a shadow stays
            sigma = np.hypot(self.sigma / np.sqrt(np.prod(_AROUND)), _TINT * empty)
            scaled = (seen * empty / sigma**2).sum(axis=2) / (empty**2 / sigma**2).sum(axis=2)
            rest = self._deviation(seen, scaled[..., None] * empty, sigma)
            in_range = (scaled >= darkest_shadow) & (scaled <= _BRIGHTEST_GLOW)
            differs &= ~(in_range & (rest <= limit))
        return _cleaned(differs)

    def _deviation(self, seen: Picture, expected: Picture, sigma: Picture) -> Picture:
        """Squared deviation (H, W) in units of its covariance."""
        scaled = ((seen - expected) / sigma) @ self.whitening.T
        return np.asarray((scaled**2).sum(axis=2))


def _cleaned(mask: BoolArray) -> BoolArray:
    """Remove single pixels, close gaps of one pixel."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    return np.asarray(cv2.morphologyEx(opened, cv2.MORPH_CLOSE, kernel) > 0)


def _noise_curve(mean: FloatArray, variance: FloatArray) -> FloatArray:
    """Levels and standard deviations (L, 2) of one channel."""
    edges = np.quantile(mean, np.linspace(0, 1, _N_LEVELS + 1))
    bins = np.clip(np.searchsorted(edges, mean.ravel()) - 1, 0, _N_LEVELS - 1)
    count = np.bincount(bins, minlength=_N_LEVELS)
    filled = count > 0
    levels = np.bincount(bins, mean.ravel(), _N_LEVELS)[filled] / count[filled]
    spread = np.bincount(bins, variance.ravel(), _N_LEVELS)[filled] / count[filled]
    order = np.argsort(levels)
    sigma = np.sqrt(np.maximum(spread[order], _LEAST_SIGMA**2))
    return np.asarray(np.stack([levels[order], sigma], axis=1))


def _interpolated(noise: Sequence[FloatArray], values: FloatArray) -> FloatArray:
    channels = [np.interp(values[..., k], *noise[k].T) for k in range(3)]
    return np.stack(channels, axis=-1)


def _inverse_root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors / np.sqrt(np.maximum(values, 0.05))) @ vectors.T)

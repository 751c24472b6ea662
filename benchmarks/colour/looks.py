"""What a camera does to a picture before it stores it: tone curve, saturation, sharpening."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter

from calichrome.colorimetry.encoding import encode
from calichrome.core.arrays import FloatArray

__all__ = ["SRGB", "Curve", "Look", "random_curve", "random_webcam"]

Curve = Callable[[FloatArray], FloatArray]
"""Linear 0..1 to stored 0..1, any shape."""

_KNOTS = 7
_SWAY = 0.35  # of the logarithm of a step between knots: slopes from half to double those of sRGB
_LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """From linear light to stored values, in the order in which a camera works.

    Parameters
    ----------
    curve
        Of all three channels.
    saturation
        Factor of the colour differences from the luma, after the curve.
    sharpening
        Share of the difference from a blurred picture that is added back.
    sharpening_sigma_px
        Of that blur.
    """

    name: str
    curve: Curve
    saturation: float = 1.0
    sharpening: float = 0.0
    sharpening_sigma_px: float = 1.0

    def of_even(self, rgb_linear: FloatArray) -> FloatArray:
        """Return stored values, not rounded, of large even surfaces, (..., 3)."""
        coded = self.curve(np.clip(rgb_linear, 0, 1))
        luma = (coded @ _LUMA)[..., None]
        return np.asarray(np.clip(luma + self.saturation * (coded - luma), 0, 1))

    def of_picture(self, rgb_linear: FloatArray) -> NDArray[np.uint8]:
        """Return what the file holds of a picture (H, W, 3)."""
        coded = self.of_even(rgb_linear)
        if self.sharpening:
            blur: Any = (self.sharpening_sigma_px, self.sharpening_sigma_px, 0)
            coded = coded + self.sharpening * (coded - gaussian_filter(coded, blur))
        stored: NDArray[np.uint8] = np.round(255 * np.clip(coded, 0, 1)).astype(np.uint8)
        return stored


SRGB = Look(name="sRGB", curve=lambda linear: encode(linear, "srgb"))
"""Nothing but the standard curve."""


def random_curve(rng: np.random.Generator) -> Curve:
    """Draw a strictly rising curve from 0 to 1: sRGB, then a smooth curve through random knots."""
    steps = np.exp(rng.normal(0, _SWAY, _KNOTS - 1))
    values = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    bend = PchipInterpolator(np.linspace(0, 1, _KNOTS), values)
    return lambda linear: np.asarray(bend(encode(linear, "srgb")))


def random_webcam(rng: np.random.Generator, number: int) -> Look:
    """Draw a webcam: a random curve, more saturation, sharpening."""
    return Look(
        name=f"webcam {number}",
        curve=random_curve(rng),
        saturation=rng.uniform(1.1, 1.4),
        sharpening=rng.uniform(0.3, 1.0),
        sharpening_sigma_px=rng.uniform(0.7, 1.3),
    )

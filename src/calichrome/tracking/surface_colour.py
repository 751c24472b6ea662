"""The colour of an object's surface, so that cameras which see other sides of it agree.

Light falls from above and cameras stand around: each sees the object shaded in another way. What
they share is the chromaticity of the surface, and the level where it faces the light best. Two
colours are compared up to a factor of light, which has a spread of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz, xyz_per_lab
from calichrome.core.arrays import FloatArray
from calichrome.tracking.background import Background, Picture

__all__ = ["SurfaceColour", "colour_covariance", "mean_colour", "surface_colour"]

_LIT = (0.80, 0.97)  # quantiles of luminance: the part that faces the light, less its highlight
_SMOOTH = (7, 7)  # pixels
_MIN_PIXELS = 9
_STEP = 0.2  # in Lab, for second differences of CIEDE2000


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceColour:
    """Colour of a region.

    Parameters
    ----------
    lab_d65 : (3,) float
        Of the lit part.
    xyz_d65 : (3,) float
        The same; Y = 1 for the perfect diffuser.
    noise_lab : (3, 3) float
        Covariance of `lab_d65` by the noise of the pixels.
    """

    lab_d65: FloatArray
    xyz_d65: FloatArray
    noise_lab: FloatArray

    def in_light(self, factor: float) -> "SurfaceColour":
        """Return the colour with its light divided by a factor."""
        xyz = self.xyz_d65 / factor
        return SurfaceColour(lab_from_xyz(xyz), xyz, self.noise_lab / factor ** (2 / 3))


def surface_colour(
    picture: Picture, inner: NDArray[np.uint8], background: Background
) -> SurfaceColour | None:
    """Measure the inside of a region; None if it is too small or black.

    Parameters
    ----------
    picture : (h, w, 3) float32
        XYZ of the window that holds it.
    inner : (h, w) uint8
        1 inside it, away from its edge.
    background
        Knows the noise of pixels.

    Notes
    -----
    Which pixels are lit is told from smoothed luminance: noise makes a pixel brighter and of
    another colour at once, so that the brightest single pixels have the wrong one (up to 10 units
    of b* behind a sensor whose colours overlap).
    """
    if int(inner.sum()) < _MIN_PIXELS:
        return None
    weight = cv2.boxFilter(inner.astype(np.float32), -1, _SMOOTH, normalize=False)
    light = cv2.boxFilter(picture[..., 1] * inner, -1, _SMOOTH, normalize=False)
    smooth = (light / np.maximum(weight, 1))[inner > 0]
    low, high = np.quantile(smooth, _LIT)
    lit = picture[inner > 0][(smooth >= low) & (smooth <= high)].astype(np.float64)
    xyz = lit.mean(axis=0)
    if not xyz[1] > 0:
        return None
    sigma = background.sigma_at(xyz)
    slope = np.linalg.inv(xyz_per_lab(xyz))
    noise = slope @ np.diag(sigma**2 / len(lit)) @ slope.T
    return SurfaceColour(lab_from_xyz(xyz), xyz, noise)


def colour_covariance(lab: FloatArray, sigma_de: float, sigma_light: float) -> FloatArray:
    """Return how far colours (N, 3) in Lab may be off, (N, 3, 3).

    Parameters
    ----------
    lab : (N, 3) float
    sigma_de
        Per axis, in units of CIEDE2000.
    sigma_light
        Of the logarithm of the light.

    Notes
    -----
    Near a colour the squared difference CIEDE2000 is a form d'Md, so an error of one unit in every
    direction has the covariance M^-1. Light times k moves a colour along its own ray through the
    black point, (L + 16, a, b) / 3 per unit of log k: Lab is a cube root of light.
    """
    forms = np.empty((len(lab), 3, 3))
    unit = _STEP * np.eye(3)

    def squared(step: FloatArray) -> FloatArray:
        return np.asarray(delta_e_2000(lab - step / 2, lab + step / 2) ** 2)

    alone = [squared(step) for step in unit]
    for i in range(3):
        forms[:, i, i] = alone[i]
        for j in range(i):
            cross = (squared(unit[i] + unit[j]) - alone[i] - alone[j]) / 2
            forms[:, i, j] = forms[:, j, i] = cross
    along = (lab + np.array([16.0, 0.0, 0.0])) / 3
    spread = np.linalg.inv(forms / _STEP**2 + 1e-9 * np.eye(3)) * sigma_de**2
    return np.asarray(spread + sigma_light**2 * along[:, :, None] * along[:, None, :])


def mean_colour(colours: Sequence[SurfaceColour]) -> FloatArray:
    """Mean Lab (3,) of one object's colours in several cameras; one that is far off counts less.

    Weights 1 / (1 + (d / s)^2), d the difference from the median, s the median difference.
    """
    lab = np.stack([colour.lab_d65 for colour in colours])
    middle = np.median(lab, axis=0)
    apart = delta_e_2000(lab, middle[None])
    scale = max(float(np.median(apart)), 1e-6)
    weight = 1 / (1 + (apart / scale) ** 2)
    return np.asarray(weight @ lab / weight.sum())

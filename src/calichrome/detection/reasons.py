"""Why a picture shows no board, in words that a person at the camera can act on."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.imaging import Image
from calichrome.target import Target

__all__ = ["why_no_board"]

_MOST_CLIPPED = 0.2  # of the picture
_LEAST_CONTRAST = 40.0  # of 255 levels, between the darkest and the brightest hundredth
_WIDEST_EDGE_PX = 8.0
"""From 10 to 90 % of an edge. On rendered boards squares of 12 px were found at edges of 6 px and
lost at 7, squares of 20 and 30 px were found beyond 12: wider edges may hide a board."""
_SCALES_PX = (1.0, 4.0)
_DIFFERENCE = 1 / 3  # px^2: a central difference averages the slope over two pixels
_STEEPEST = 0.999  # share of pixels that are less steep than an edge
_WIDTH_OF_SIGMA = 2.563  # 10 to 90 % of a Gaussian step, in sigmas


def why_no_board(image: Image, tones: NDArray[np.float32], target: Target) -> str:
    """Say what may keep a board from being seen.

    Parameters
    ----------
    tones : (H, W) float32, 0..255
        The picture as it was searched.
    target
        What was searched for.
    """
    what = f"no board of {target.corners_xy[0]}x{target.corners_xy[1]} inner corners in sight"
    clipped = float(image.is_clipped((slice(None), slice(None))).mean())
    if clipped > _MOST_CLIPPED:
        return f"{what}: {clipped:.0%} of the picture is overexposed; close the aperture"
    contrast = float(np.quantile(tones, 0.99)) - float(np.quantile(tones, 0.01))
    if contrast < _LEAST_CONTRAST:
        return f"{what}: the picture has only {contrast:.0f} of 255 levels; add light"
    width = edge_width_px(tones)
    if width > _WIDEST_EDGE_PX:
        return (
            f"{what}: the picture is too blurred (edges {width:.1f} px wide); focus, or hold still"
        )
    return f"{what}; show it whole, sharp and without shadows"


def edge_width_px(tones: NDArray[np.float32]) -> float:
    """Return the width of the sharpest edges, from 10 to 90 %.

    A step blurred by sigma has a slope of C / sqrt(2 pi sigma^2). Blurred further by two known
    scales its slopes tell sigma, whatever C.
    """
    slopes = []
    for scale in _SCALES_PX:
        blurred = cv2.GaussianBlur(tones, (0, 0), scale)
        across = cv2.Sobel(blurred, cv2.CV_32F, 1, 0)
        down = cv2.Sobel(blurred, cv2.CV_32F, 0, 1)
        slopes.append(float(np.quantile(cv2.magnitude(across, down), _STEEPEST)))
    ratio = (slopes[0] / max(slopes[1], 1e-9)) ** 2
    fine, coarse = (scale**2 for scale in _SCALES_PX)
    if ratio <= 1.0:
        return float("inf")
    variance = max((coarse - ratio * fine) / (ratio - 1) - _DIFFERENCE, 0.0)
    return _WIDTH_OF_SIGMA * float(np.sqrt(variance))

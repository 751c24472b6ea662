"""Whether the stated encoding is true, and whether a camera changed its exposure on its own."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.core.arrays import FloatArray

__all__ = ["exposure_jumps", "grey_slope"]

_GREY_CHROMA = 6.0  # of Lab: discs below count as grey (the greys of a ColorChecker are below 3)
_JUMP = 0.30  # share by which one camera's white may move against another's in one frame
_MIN_FRAMES = 3  # of a pair, before "usual" means anything


def grey_slope(disc_rgb: FloatArray, nominal_xyz: FloatArray) -> float | None:
    """Slope of log(measured green) over log(nominal Y) through the grey discs.

    A linear camera has slope 1; a wrong encoding acts as an exponent and shows as the slope (2.2
    or 0.45 when linear and sRGB are mixed up).

    Parameters
    ----------
    disc_rgb : (N, 3) float
        Linear disc means in the reference light; nan where not seen.
    nominal_xyz : (N, 3) float

    Returns
    -------
    float or None
        None with fewer than four grey discs or less than a tenfold range of Y.
    """
    lab = lab_from_xyz(nominal_xyz)
    green, luminance = disc_rgb[:, 1], nominal_xyz[:, 1]
    grey = (np.hypot(lab[:, 1], lab[:, 2]) < _GREY_CHROMA) & (green > 0) & np.isfinite(green)
    if grey.sum() < 4 or luminance[grey].max() < 10 * luminance[grey].min():
        return None
    return float(np.polyfit(np.log(luminance[grey]), np.log(green[grey]), 1)[0])


def exposure_jumps(
    white_levels: Mapping[str, Mapping[str, float]],
) -> list[tuple[str, str, float]]:
    """Find frames in which one camera's white moved against the others'.

    The level alone says nothing: a board that turns away from the lamp is darker in all cameras.

    Parameters
    ----------
    white_levels
        camera -> frame -> level of the white squares (any one channel, linear).

    Returns
    -------
    list of (camera, frame, ratio)
        `ratio` is the jump against the pair's usual ratio; the camera is the one of the pair that
        jumps against most others (the first of two where only two see the frame).
    """
    votes: dict[tuple[str, str], list[float]] = {}
    for a, b in combinations(white_levels, 2):
        shared = [frame for frame in white_levels[a] if frame in white_levels[b]]
        if len(shared) < _MIN_FRAMES:
            continue
        logs = np.log([white_levels[a][frame] / white_levels[b][frame] for frame in shared])
        for frame, jump in zip(shared, logs - np.median(logs), strict=True):
            if abs(jump) > np.log(1 + _JUMP):
                votes.setdefault((a, frame), []).append(float(jump))
                votes.setdefault((b, frame), []).append(-float(jump))
    worst: dict[str, tuple[str, list[float]]] = {}
    for (camera, frame), jumps in votes.items():
        if frame not in worst or len(jumps) > len(worst[frame][1]):
            worst[frame] = (camera, jumps)
    return [
        (camera, frame, float(np.exp(np.median(jumps)))) for frame, (camera, jumps) in worst.items()
    ]

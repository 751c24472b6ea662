"""Frames corrected step by step in double precision."""

import numpy as np
from benchmarks.apply.calibrations import colour_of

from calichrome.apply import SourceMap
from calichrome.colorimetry.encoding import encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.imaging import Pixels
from calichrome.rig import Camera

__all__ = ["corrected_in_floats"]


def corrected_in_floats(
    camera: Camera, source_map: SourceMap, frame: Pixels
) -> tuple[FloatArray, BoolArray]:
    """Return encoded sRGB (H, W, 3), 0..1, and where all four neighbours lie in the picture."""
    colour = colour_of(camera)
    if colour.encoding is None:
        raise ValueError("camera: has no encoding")
    x, y = (source_map[..., axis].astype(np.float64) for axis in range(2))
    width, height = camera.size_wh
    inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    left = np.clip(np.floor(x), 0, width - 2).astype(int)
    top = np.clip(np.floor(y), 0, height - 2).astype(int)
    right_share, low_share = (x - left)[..., None], (y - top)[..., None]
    values = frame / np.iinfo(frame.dtype).max
    upper = values[top, left] * (1 - right_share) + values[top, left + 1] * right_share
    lower = values[top + 1, left] * (1 - right_share) + values[top + 1, left + 1] * right_share
    stored = np.clip(upper * (1 - low_share) + lower * low_share, 0, 1)
    linear = linearise(stored, colour.encoding)
    if camera.vignetting is not None:
        linear = linear / camera.vignetting.gain(np.stack([x, y], axis=-1))
    rgb = colour.xyz_from_rgb(linear) @ RGB_FROM_XYZ["srgb"].T
    return encode(np.clip(rgb, 0, 1), "srgb"), inside

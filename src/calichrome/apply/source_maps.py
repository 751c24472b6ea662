"""Where each pixel of a corrected picture comes from."""

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import Lens

__all__ = ["NOWHERE_PX", "SourceMap", "rectifying_map", "undistorting_map"]

NOWHERE_PX = -1e4
SourceMap = NDArray[np.float32]
_BAND = 64  # rows at a time: in one go, 1080p took 340 MB of intermediate results


def undistorting_map(lens: Lens, size_wh: tuple[int, int]) -> SourceMap:
    """Source pixel of every pixel of the distortion-free picture with the same K, (H, W, 2)."""
    return _map_through(lens, np.asarray(np.linalg.inv(lens.matrix)), size_wh)


def rectifying_map(
    lens: Lens, rotation: FloatArray, matrix: FloatArray, size_wh: tuple[int, int]
) -> SourceMap:
    """Source pixel of every pixel of a rectified picture, (H, W, 2).

    Parameters
    ----------
    lens
        Of the camera.
    rotation : (3, 3) float
        rect_from_cam.
    matrix : (3, 3) float
        Pinhole of the rectified camera.
    size_wh
        Of the rectified picture.
    """
    return _map_through(lens, rotation.T @ np.linalg.inv(matrix), size_wh)


def _map_through(lens: Lens, rays_from_pixels: FloatArray, size_wh: tuple[int, int]) -> SourceMap:
    width, height = size_wh
    source_map = np.empty((height, width, 2), dtype=np.float32)
    for first in range(0, height, _BAND):
        x, y = np.meshgrid(np.arange(width), np.arange(first, min(first + _BAND, height)))
        pixels = np.stack([x, y, np.ones(x.shape)], axis=-1).astype(np.float64)
        rays = pixels @ rays_from_pixels.T
        # what the camera cannot see comes from nowhere: outside the picture, so black
        source = np.where(lens.sees(rays)[..., None], lens.project(rays), NOWHERE_PX)
        source_map[first : first + _BAND] = source.clip(NOWHERE_PX, 1e5)
    return source_map

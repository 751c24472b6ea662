"""The pinhole camera of pictures without distortion: what it shows and how large it is."""

from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rectified_area import Framing, TurnedCamera, ValidArea, framed

__all__ = ["Pinhole", "undistorted_pinhole"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pinhole:
    """A camera without distortion; pixels, (0, 0) is the centre of the top-left one."""

    size_wh: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> FloatArray:
        """K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


def undistorted_pinhole(
    lens: Lens, size_wh: tuple[int, int], area: ValidArea, *, keep_size: bool
) -> Pinhole:
    """Choose the pinhole that shows all of a camera's picture, or only what has no border.

    Parameters
    ----------
    lens, size_wh
        As calibrated.
    area
        "all": every pixel of the picture is shown, but for those further than 75 degrees from the
        axis; "valid": every pixel shown comes from inside the picture.
    keep_size
        Keep the size and choose the scale; else keep the scale in the middle of the picture (the
        smaller of fx, fy) and choose the size, of the same shape and even as videos want it.

    Notes
    -----
    Pixels become square. The frame is that of a rectified pair of the camera with itself.
    """
    camera = TurnedCamera(lens, size_wh, np.eye(3))
    focal, centres = framed((camera, camera), size_wh, 0, Framing(area=area))
    half_wh = (np.array(size_wh, dtype=np.float64) - 1) / 2
    middle = (half_wh - centres[0]) / focal
    if not keep_size:
        kept = min(lens.fx, lens.fy)
        n_pixels = 2 * half_wh * kept / focal + 1
        rounded = np.ceil(n_pixels / 2) if area == "all" else np.floor(n_pixels / 2)
        size_wh = int(2 * rounded[0]), int(2 * rounded[1])
        focal, half_wh = kept, (2 * rounded - 1) / 2
    cx, cy = half_wh - focal * middle
    return Pinhole(size_wh=size_wh, fx=focal, fy=focal, cx=float(cx), cy=float(cy))

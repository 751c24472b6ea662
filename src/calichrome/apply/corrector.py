"""One camera's correction, compiled once: geometry, then colour."""

from functools import cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.colorimetry.encoding import EncodingName, ToneCurve, encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray
from calichrome.errors import CalichromeError
from calichrome.geometry.lenses import Lens
from calichrome.imaging import Image, Pixels
from calichrome.rig import Camera

__all__ = [
    "OUTPUT_SPACES",
    "Corrector",
    "OutputSpace",
    "SourceMap",
    "rectifying_map",
    "undistorting_map",
]

OutputSpace = Literal["srgb", "display-p3", "linear-srgb", "xyz-d65", "none"]
OUTPUT_SPACES: tuple[OutputSpace, ...] = ("srgb", "display-p3", "linear-srgb", "xyz-d65", "none")
_ENCODED = {"srgb", "display-p3"}  # both store the sRGB transfer function
_NOWHERE_PX = -1e4
_ENTRIES = 65_536  # of the tables: one for every 16-bit value
SourceMap = NDArray[np.float32]


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
    x, y = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1).astype(np.float64)
    rays = pixels @ rays_from_pixels.T
    # what the camera cannot see comes from nowhere: outside the picture, so black
    source = np.where(lens.sees(rays)[:, None], lens.project(rays), _NOWHERE_PX)
    return source.reshape(size_wh[1], size_wh[0], 2).clip(_NOWHERE_PX, 1e5).astype(np.float32)


class Corrector:
    """Correct pictures of one camera.

    Parameters
    ----------
    camera
        From a rig.
    space
        Colour space of the output; "none" leaves colours as they are.
    source_map : (H, W, 2) float32 or None
        Where each output pixel comes from; None leaves the geometry as it is.

    Raises
    ------
    CalichromeError
        If colours are asked for and the rig has none for this camera.

    Notes
    -----
    8-bit pictures are widened to 16 bit before they are resampled, so that rounding comes last.
    Immutable after construction and safe to share between threads.
    """

    def __init__(
        self, camera: Camera, space: OutputSpace = "srgb", source_map: SourceMap | None = None
    ) -> None:
        if space != "none" and camera.colour is None:
            raise CalichromeError(
                "this camera has no colour calibration; use --colour none, or calibrate with the "
                "colour target"
            )
        self._space: OutputSpace = space
        self._source_map = source_map
        self._colour = camera.colour
        self._size_wh = camera.size_wh
        self._gain = None if space == "none" else _gain(camera, source_map)

    def apply(self, image: Image) -> Pixels:
        """Return the corrected pixels.

        8-bit pictures stay 8 bit in the encoded spaces and become 16 bit in "linear-srgb"; 16-bit
        ones stay 16 bit; "xyz-d65" and float pictures give float32.

        Raises
        ------
        CalichromeError
            If the picture has another size than the camera, or is grey while colour is asked for.
        """
        if image.size_wh != self._size_wh:
            raise CalichromeError(
                f"the picture is {image.size_wh[0]}x{image.size_wh[1]}, the camera was calibrated "
                f"at {self._size_wh[0]}x{self._size_wh[1]}; record at that size"
            )
        pixels = image.pixels
        if self._space == "none":
            return self._resample(pixels)
        if not image.is_colour:
            raise CalichromeError("the picture is grey; use --colour none")
        assert self._colour is not None  # noqa: S101 (checked at construction)
        curve = self._colour.encoding
        if isinstance(curve, ToneCurve):
            full_scale = 1.0 if pixels.dtype == np.float32 else image.full_scale
            linear = curve.linearise(self._resample(pixels.astype(np.float32)) / full_scale)
        elif pixels.dtype == np.float32:
            linear = linearise(self._resample(pixels).astype(np.float64), image.encoding)
        else:
            widened = _widen(pixels, image.full_scale)
            table = _linear_table(image.encoding)
            linear = table[self._resample(widened)].astype(np.float64)
        if self._gain is not None:
            linear /= self._gain
        xyz = self._colour.xyz_from_rgb(linear)
        return self._store(xyz, pixels.dtype)

    def _resample(self, pixels: Pixels) -> Pixels:
        if self._source_map is None:
            return pixels
        resampled: Pixels = cv2.remap(
            pixels, self._source_map, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
        )
        return resampled

    def _store(self, xyz: FloatArray, dtype: np.dtype[np.generic]) -> Pixels:
        if self._space == "xyz-d65":
            return xyz.astype(np.float32)
        name = "display-p3" if self._space == "display-p3" else "srgb"
        rgb = np.clip(xyz @ RGB_FROM_XYZ[name].T, 0, 1)
        if self._space in _ENCODED:
            rgb = encode(rgb, "srgb")
        if dtype == np.float32:
            return rgb.astype(np.float32)
        if dtype == np.uint8 and self._space in _ENCODED:
            return np.rint(rgb * 255).astype(np.uint8)
        return np.rint(rgb * 65535).astype(np.uint16)


def _gain(camera: Camera, source_map: SourceMap | None) -> SourceMap | None:
    """Share of light that reaches each output pixel, (H, W, 3); None: not known."""
    if camera.vignetting is None:
        return None
    if source_map is None:
        return camera.vignetting.gain_map(camera.size_wh).astype(np.float32)
    size_wh = np.array(camera.size_wh, dtype=np.float64)
    # what comes from nowhere is black whatever it is divided by
    inside = np.clip(source_map.astype(np.float64), 0, size_wh - 1)
    return camera.vignetting.gain(inside).astype(np.float32)


def _widen(pixels: Pixels, full_scale: float) -> NDArray[np.uint16]:
    """Stretch integers to 0..65535 of full scale."""
    if pixels.dtype == np.uint8:
        return np.asarray(pixels.astype(np.uint16) * np.uint16(257))
    if full_scale == 65535:
        return np.asarray(pixels, dtype=np.uint16)
    stretched = np.minimum(pixels / full_scale, 1) * 65535
    return np.asarray(np.rint(stretched), dtype=np.uint16)


@cache
def _linear_table(encoding: EncodingName) -> SourceMap:
    return linearise(np.arange(_ENTRIES) / (_ENTRIES - 1), encoding).astype(np.float32)

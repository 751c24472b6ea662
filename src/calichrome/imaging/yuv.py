"""RGB of video frames and back, by the matrix, range and depth that a file states.

4:2:0 of 8 bits, which most videos are, is converted by the C kernels: 1.6 ms CPU of a 1080p frame
to RGB and 1.2 ms back. OpenCV, which converts other planar YUV, takes 3.0 and 1.8 ms; libswscale 15
and 7 ms at full accuracy, and its fast way to RGB (0.6 ms) is 1 to 1.5 codes too dark.
"""

from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, Scratch
from calichrome.imaging.image import Pixels
from calichrome.imaging.pyav import av
from calichrome.kernels import native

if TYPE_CHECKING:
    from av import VideoFrame
    from av.video.plane import VideoPlane

__all__ = ["BT709", "FULL", "LIMITED", "frame_of_rgb", "rgb_of_frame", "stated_matrix"]

BT709, _BT601 = 1, 6
LIMITED, FULL = 1, 2  # as libavutil counts ranges
_HD_LINES = 720  # from this height on, an unnamed matrix is that of BT.709, as players take it

_KR_KB = MappingProxyType({1: (0.2126, 0.0722), 4: (0.30, 0.11), 5: (0.299, 0.114),
                           6: (0.299, 0.114), 7: (0.212, 0.087), 9: (0.2627, 0.0593),
                           10: (0.2627, 0.0593)})  # fmt: skip
"""ITU-T H.273, table 4 (matrix coefficients): the weights of red and blue in luma."""

_HALF_CHROMA = "yuv420p", "yuvj420p"
"""Layouts of the C kernels."""

_SWSCALE = MappingProxyType({1: 1, 4: 4, 5: 5, 6: 5, 7: 7, 9: 9, 10: 9})
"""The same codes -> the matrices of libswscale."""


def stated_matrix(code: int, height: int) -> int:
    """Return the code (H.273) of the matrix of a video, or of the one that players assume."""
    return code if code in _KR_KB else BT709 if height >= _HD_LINES else _BT601


def rgb_of_frame(frame: "VideoFrame", scratch: Scratch | None = None) -> Pixels:
    """Return RGB of full range (H, W, 3), or grey (H, W); more than 8 bits become 16.

    Parameters
    ----------
    frame
        As decoded.
    scratch
        Arrays to work in: the answer is one of them, until the next call with the same.

    Notes
    -----
    Chroma is taken to lie in the middle of the pixels that it belongs to, and is interpolated
    between them.
    """
    layout = frame.format
    bits = max(part.bits for part in layout.components)
    is_full = frame.color_range == FULL or layout.name.startswith("yuvj")
    matrix = stated_matrix(frame.colorspace, frame.height)
    is_plain = layout.name.startswith("yuv") and layout.is_planar and len(frame.planes) == 3
    if not is_plain or layout.is_big_endian:
        return _by_swscale(frame, matrix, is_full=is_full, deep=bits > 8)
    scratch = scratch or Scratch()
    back = _rgb_from_codes(matrix, bits, is_full)
    luma, *chroma = (_array_of(plane, bits) for plane in frame.planes)
    height, width = luma.shape
    pixels = scratch.array("pixels", (height, width, 3), luma.dtype)
    if native is not None and layout.name in _HALF_CHROMA:
        native.rgb_of_yuv(luma, *chroma, pixels, back.astype(np.float32))
        return pixels
    for index, plane in enumerate(chroma):
        if plane.shape != luma.shape:
            times_x, times_y = -(-width // plane.shape[1]), -(-height // plane.shape[0])
            size_wh = plane.shape[1] * times_x, plane.shape[0] * times_y
            wide = scratch.array(f"chroma {index}", size_wh[::-1], plane.dtype)
            chroma[index] = cv2.resize(plane, size_wh, dst=wide)[:height, :width]
    codes = scratch.array("codes", pixels.shape, luma.dtype)
    cv2.merge([luma, *chroma], dst=codes)
    return np.asarray(cv2.transform(codes, back, dst=pixels))


def frame_of_rgb(
    pixels: Pixels,
    layout: str,
    matrix: int,
    *,
    full_range: bool,
    scratch: Scratch | None = None,
) -> "VideoFrame":
    """Return a frame of planar YUV.

    Parameters
    ----------
    pixels : (H, W, 3) or (H, W), uint8 or uint16
        RGB or grey of full range.
    layout
        Name of libavutil, like yuv420p or yuv444p10le.
    matrix
        Code of ITU-T H.273.
    full_range
        Whether codes use all values.
    scratch
        Arrays to work in; `pixels` may be what `rgb_of_frame` returned of the same.

    Raises
    ------
    ValueError
        If one of `pixels` and `layout` has 8 bits, and the other has more.
    """
    scratch = scratch or Scratch()
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    height, width = pixels.shape[:2]
    frame: VideoFrame = av().VideoFrame(width, height, layout)
    bits = frame.format.components[0].bits
    if (bits > 8) != (pixels.dtype.itemsize > 1):
        raise ValueError(f"pixels: {pixels.dtype} does not fit {layout}")
    forth = _codes_from_rgb(matrix, bits, full_range, pixels.dtype.itemsize)
    planes = [_array_of(plane, bits) for plane in frame.planes]
    if native is not None and layout in _HALF_CHROMA and width % 2 == height % 2 == 0:
        native.yuv_of_rgb(*planes, np.ascontiguousarray(pixels), forth.astype(np.float32))
    else:
        _write_planes(planes, pixels, forth, scratch)
    frame.colorspace, frame.color_range = matrix, FULL if full_range else LIMITED
    return frame


def _write_planes(
    planes: list[Pixels], pixels: Pixels, forth: FloatArray, scratch: Scratch
) -> None:
    shape = pixels.shape[:2]
    codes = cv2.transform(pixels, forth, dst=scratch.array("codes", pixels.shape, pixels.dtype))
    whole = [
        plane if plane.shape == shape else scratch.array(f"channel {index}", shape, codes.dtype)
        for index, plane in enumerate(planes)
    ]
    cv2.split(codes, whole)  # in one pass: a third of the time of one channel after the other
    for plane, channel in zip(planes, whole, strict=True):
        if plane is not channel:
            cv2.resize(channel, plane.shape[::-1], dst=plane, interpolation=cv2.INTER_AREA)


def _array_of(plane: "VideoPlane", bits: int) -> Pixels:
    rows: Pixels = np.frombuffer(
        memoryview(plane),
        np.uint8 if bits == 8 else np.uint16,
    )
    return rows.reshape(plane.height, -1)[:, : plane.width]


@cache
def _codes_from_unit(matrix: int, bits: int, full: bool) -> FloatArray:  # noqa: FBT001 (cached)
    """Codes (3, 4) of (R, G, B, 1), 0..1; ITU-T H.273, equations 24 to 42."""
    kr, kb = _KR_KB[matrix]
    luma = np.array([kr, 1 - kr - kb, kb])
    colours = np.stack(
        [luma, (np.eye(3)[2] - luma) / (2 * (1 - kb)), (np.eye(3)[0] - luma) / (2 * (1 - kr))]
    )
    step, top = 2 ** (bits - 8), 2**bits - 1
    scale = np.full(3, float(top)) if full else np.array([219.0, 224, 224]) * step
    offset = np.array([0 if full else 16 * step, 128 * step, 128 * step])
    return np.column_stack([scale[:, None] * colours, offset])


@cache
def _codes_from_rgb(matrix: int, bits: int, full: bool, n_bytes: int) -> FloatArray:  # noqa: FBT001
    return _codes_from_unit(matrix, bits, full) / [*[256.0**n_bytes - 1] * 3, 1]


@cache
def _rgb_from_codes(matrix: int, bits: int, full: bool) -> FloatArray:  # noqa: FBT001 (cached)
    forth = _codes_from_unit(matrix, bits, full)
    back = np.linalg.inv(forth[:, :3])
    top = 255 if bits == 8 else 65535
    return np.column_stack([back, -back @ forth[:, 3]]) * top


def _by_swscale(frame: "VideoFrame", matrix: int, *, is_full: bool, deep: bool) -> Pixels:
    """Convert what is not planar YUV."""
    layout = frame.format
    is_grey = len([part for part in layout.components if not part.is_alpha]) == 1
    if layout.is_rgb:
        return frame.to_ndarray(format="rgb48le" if deep else "rgb24")
    converted = frame.reformat(
        format=("gray16le" if deep else "gray") if is_grey else "rgb48le" if deep else "rgb24",
        src_colorspace=_SWSCALE[matrix],
        src_color_range=FULL if is_full else LIMITED,
        dst_color_range=FULL,
        interpolation=_scaling(),
    )
    pixels = np.ascontiguousarray(converted.to_ndarray())
    return _stretched(pixels) if deep and not is_grey else pixels


def _stretched(pixels: Pixels) -> NDArray[np.uint16]:
    """Take libswscale's white of 255 * 256 to 65535."""
    return np.minimum(pixels.astype(np.uint32) * 257 // 256, 65535).astype(np.uint16)


@cache
def _scaling() -> int:
    """Chroma between its samples by cubics, at full accuracy: the default drops bits."""
    kinds = av().video.reformatter.Interpolation
    return int(kinds.BICUBIC | kinds.ACCURATE_RND | kinds.FULL_CHR_H_INT)

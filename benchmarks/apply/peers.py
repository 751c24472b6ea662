"""Other ways to correct a frame: a matrix or a table instead of the model, and no fall-off."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from benchmarks.apply.calibrations import colour_of

from calichrome.apply import PixelType, SourceMap
from calichrome.colorimetry.encoding import EncodingName, encode, linearise
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import FloatArray
from calichrome.imaging import Pixels
from calichrome.rig import Camera

__all__ = ["OPENCOLORIO", "TWO_PASSES", "Peer", "Setup", "peers"]

TWO_PASSES = "OpenCV, two passes, preallocated: matrix, map"
OPENCOLORIO = "OpenCV map, OpenColorIO table 33"

_TABLE = 33  # nodes along an edge, the usual size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setup:
    """What is corrected."""

    camera: Camera
    matrix_camera: Camera
    source_map: SourceMap
    frame: Pixels
    dtype: PixelType

    @property
    def encoding(self) -> EncodingName:
        """How the frame is stored."""
        return "srgb" if self.dtype == "uint8" else "linear"

    @property
    def top(self) -> int:
        """The largest stored number."""
        return int(np.iinfo(self.dtype).max)

    @property
    def matrix(self) -> FloatArray:
        """From linear camera RGB to linear sRGB."""
        colour = colour_of(self.matrix_camera)
        return np.asarray(RGB_FROM_XYZ["srgb"] @ colour.model.jacobian(colour.white_rgb))


@dataclass(frozen=True, slots=True)
class Peer:
    """One way; `run` is None where what it needs is not installed."""

    name: str
    run: Callable[[], object] | None


def peers(setup: Setup) -> Iterator[Peer]:
    """Yield all others."""
    yield Peer(TWO_PASSES, _two_passes(setup))
    yield Peer("OpenCV as usually written: floats, matrix, map", _usual(setup))
    yield Peer(OPENCOLORIO, _opencolorio(setup))
    yield Peer("OpenCV map, colour-science: matrix", _colour_science(setup))
    yield Peer("OpenCV map, numpy: matrix", _numpy(setup))


def _two_passes(setup: Setup) -> Callable[[], object]:
    """Do it in the best way: tables, and fixed-point maps at 8 bits (at 16 floats are faster)."""
    frame, top = setup.frame, setup.top
    stored = np.arange(top + 1) / top
    to_linear = np.rint(65535 * linearise(stored, setup.encoding)).astype(np.uint16)
    to_stored = np.rint(top * encode(np.arange(65536) / 65535, "srgb")).astype(setup.dtype)
    matrix = setup.matrix.astype(np.float32)
    maps = (setup.source_map, None)
    if setup.dtype == "uint8":
        maps = cv2.convertMaps(setup.source_map, None, cv2.CV_16SC2)
    mapped, out = np.empty_like(frame), np.empty_like(frame)
    linear, mixed = np.empty(frame.shape, np.uint16), np.empty(frame.shape, np.uint16)

    def run() -> Pixels:
        cv2.remap(frame, *maps, cv2.INTER_LINEAR, dst=mapped)
        cv2.LUT(mapped, to_linear, dst=linear)
        cv2.transform(linear, matrix, dst=mixed)
        cv2.LUT(mixed, to_stored, dst=out)
        return out

    return run


def _usual(setup: Setup) -> Callable[[], object]:
    frame, top = setup.frame, setup.top
    x, y = setup.source_map[..., 0].copy(), setup.source_map[..., 1].copy()
    to_linear = linearise(np.arange(top + 1) / top, setup.encoding).astype(np.float32)
    to_stored = np.rint(top * encode(np.arange(4096) / 4095, "srgb")).astype(setup.dtype)
    matrix = setup.matrix.astype(np.float32)

    def run() -> Pixels:
        mapped = cv2.remap(frame, x, y, cv2.INTER_LINEAR)
        mixed = cv2.transform(cv2.LUT(mapped, to_linear), matrix)
        return np.asarray(to_stored[(np.clip(mixed, 0, 1) * 4095).astype(np.uint16)])

    return run


def _colours(setup: Setup, stored: FloatArray) -> FloatArray:
    """Corrected and encoded colours (M, 3) of stored ones, by the model itself."""
    linear = linearise(stored, setup.encoding)
    rgb = colour_of(setup.camera).xyz_from_rgb(linear) @ RGB_FROM_XYZ["srgb"].T
    return encode(np.clip(rgb, 0, 1), "srgb")


def _opencolorio(setup: Setup) -> Callable[[], object] | None:
    try:
        import PyOpenColorIO as ocio  # type: ignore[import-not-found]  # noqa: N813
    except ImportError:
        return None
    nodes = np.arange(_TABLE) / (_TABLE - 1)
    lattice = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1)
    table = ocio.Lut3DTransform(_TABLE)
    table.setInterpolation(ocio.INTERP_TETRAHEDRAL)
    table.setData(_colours(setup, lattice.reshape(-1, 3)).astype(np.float32).ravel())
    depth = ocio.BIT_DEPTH_UINT8 if setup.dtype == "uint8" else ocio.BIT_DEPTH_UINT16
    processor = ocio.Config.CreateRaw().getProcessor(table)
    cpu = processor.getOptimizedCPUProcessor(depth, depth, ocio.OPTIMIZATION_DEFAULT)
    frame = setup.frame
    mapped, out = np.empty_like(frame), np.empty_like(frame)
    height, width = frame.shape[:2]
    size = frame.itemsize
    sizes = (width, height, 3, depth, size, 3 * size, 3 * size * width)
    source, target = (ocio.PackedImageDesc(data, *sizes) for data in (mapped, out))
    maps = (setup.source_map, None)
    if setup.dtype == "uint8":
        maps = cv2.convertMaps(setup.source_map, None, cv2.CV_16SC2)

    def run() -> Pixels:
        cv2.remap(frame, *maps, cv2.INTER_LINEAR, dst=mapped)
        cpu.apply(source, target)
        return out

    return run


def _colour_science(setup: Setup) -> Callable[[], object]:
    import colour

    frame, top = setup.frame, setup.top

    def run() -> Pixels:
        mapped = cv2.remap(frame, setup.source_map, None, cv2.INTER_LINEAR) / top
        linear = colour.cctf_decoding(mapped, "sRGB") if setup.encoding == "srgb" else mapped
        mixed = np.clip(colour.algebra.vecmul(setup.matrix, linear), 0, 1)
        return np.asarray(np.rint(colour.cctf_encoding(mixed, "sRGB") * top), dtype=setup.dtype)

    return run


def _numpy(setup: Setup) -> Callable[[], object]:
    frame, top, matrix = setup.frame, setup.top, setup.matrix

    def run() -> Pixels:
        mapped = cv2.remap(frame, setup.source_map, None, cv2.INTER_LINEAR) / top
        mixed = np.clip(linearise(mapped, setup.encoding) @ matrix.T, 0, 1)
        return np.asarray(np.rint(encode(mixed, "srgb") * top), dtype=setup.dtype)

    return run

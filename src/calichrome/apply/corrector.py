"""One camera's correction, compiled once and applied to any number of frames."""

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np

from calichrome.apply.correction import Correction, colour_of, map_grid, out_scale_of
from calichrome.apply.frame_format import FrameFormat, PixelType
from calichrome.apply.native_rows import NativeRows
from calichrome.apply.opencv_rows import OpenCVRows
from calichrome.apply.source_maps import SourceMap
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.errors import CalichromeError
from calichrome.imaging import Pixels
from calichrome.kernels import native
from calichrome.rig import Camera

__all__ = ["OUTPUT_SPACES", "Corrector", "Kernel", "OutputSpace"]

OutputSpace = Literal["srgb", "display-p3", "linear-srgb", "xyz-d65", "none"]
OUTPUT_SPACES: tuple[OutputSpace, ...] = ("srgb", "display-p3", "linear-srgb", "xyz-d65", "none")
Kernel = Literal["native", "opencv"]
_ENCODED = {"srgb", "display-p3"}  # both store the sRGB transfer function
_BAND = 32
"""Rows that a thread takes at a time: a 1080p frame makes 34 shares, so threads end together."""


class Corrector:
    """Correct frames of one camera.

    Parameters
    ----------
    camera
        From a rig.
    space
        Colour space of the output; "none" leaves colours as they are.
    source_map : (H, W, 2) float32 or None
        Where each output pixel comes from; None leaves the geometry as it is.
    frames
        How frames are stored; the output has the same order of channels.
    output
        Numbers of the output; None: 8-bit frames stay 8 bit in the encoded spaces and become 16 bit
        in "linear-srgb", 16-bit ones stay 16 bit, "xyz-d65" and float frames give float32.
    n_threads
        Threads that share the rows of each frame.
    kernel
        "native": the C extension; "opencv": OpenCV and numpy, many times slower; "auto": the first
        that there is.

    Raises
    ------
    CalichromeError
        If colours are asked for and the rig has none for this camera, or frames are grey; or if
        there is no C extension for "native".
    ValueError
        If `source_map` has another shape, `output` cannot hold `space`, or `n_threads` is below 1.

    Notes
    -----
    Immutable, and safe to share between threads. Nothing is allocated per frame where `apply` is
    given `out` and the kernel is "native".

    Both kernels do the same: resample stored values bilinearly, remove the encoding, make up for
    the fall-off of the lens, evaluate the colour model, encode, round. Models without closed form
    (splines, tetrahedra, subspaces, local regression) are tabulated at 33^3 colours.
    """

    __slots__ = ("_correction", "_executor", "_kernel", "_n_threads", "_rows")

    def __init__(
        self,
        camera: Camera,
        space: OutputSpace = "srgb",
        source_map: SourceMap | None = None,
        *,
        frames: FrameFormat = FrameFormat(),  # noqa: B008 (immutable)
        output: PixelType | None = None,
        n_threads: int = 1,
        kernel: Literal["auto"] | Kernel = "auto",
    ) -> None:
        if n_threads < 1:
            raise ValueError(f"n_threads={n_threads}: expected 1 or more")
        if kernel == "native" and native is None:
            raise CalichromeError(
                "the C kernels are not installed; install calichrome again where there is a C "
                "compiler, or leave the choice of the kernel to it"
            )
        self._correction = _correction(camera, space, source_map, frames, output)
        uses_native = native is not None and kernel != "opencv"
        self._kernel: Kernel = "native" if uses_native else "opencv"
        self._rows = (NativeRows if uses_native else OpenCVRows)(self._correction)
        self._n_threads = n_threads
        self._executor = ThreadPoolExecutor(n_threads - 1) if n_threads > 1 else None

    @property
    def kernel(self) -> Kernel:
        """Which code runs."""
        return self._kernel

    @property
    def output_shape(self) -> tuple[int, ...]:
        """Of what `apply` returns: (H, W, 3), or (H, W) of grey frames."""
        return _shape(self._correction.out_size_wh, self._correction.frames)

    @property
    def output_dtype(self) -> np.dtype[np.generic]:
        """Of what `apply` returns."""
        return np.dtype(self._correction.out_type)

    def apply(self, frame: Pixels, out: Pixels | None = None) -> Pixels:
        """Return the corrected frame.

        Parameters
        ----------
        frame : (H, W, 3), or (H, W) if grey
            As `frames` says; any strides.
        out : `output_shape`, optional
            Written and returned; pixels of a row lie side by side. It shares no memory with
            `frame`.

        Raises
        ------
        CalichromeError
            If the frame has another size than the camera.
        ValueError
            If the frame is not stored as said, or `out` does not fit.
        """
        frame = self._checked(frame)
        if out is None:
            out = np.empty(self.output_shape, self.output_dtype)
        else:
            self._check_out(out, frame)
        if self._executor is None:
            self._rows.run(frame, out, 0, len(out))
        else:
            self._share(self._executor, frame, out)
        return out

    def _share(self, executor: ThreadPoolExecutor, frame: Pixels, out: Pixels) -> None:
        """Let the threads take bands until none is left."""
        bands = deque(range(0, len(out), _BAND))

        def work() -> None:
            while True:
                try:
                    first = bands.popleft()
                except IndexError:
                    return
                self._rows.run(frame, out, first, min(first + _BAND, len(out)))

        helpers = [executor.submit(work) for _ in range(self._n_threads - 1)]
        try:
            work()
        finally:
            bands.clear()
            for helper in helpers:
                if not helper.cancel():  # it may not have begun: others use the threads as well
                    helper.result()

    def _checked(self, frame: Pixels) -> Pixels:
        frames, size_wh = self._correction.frames, self._correction.size_wh
        if frame.dtype != np.dtype(frames.dtype):
            raise ValueError(f"frame: expected {frames.dtype}, got {frame.dtype}")
        if frame.ndim != (2 if frames.order == "grey" else 3) or frame.shape[2:] not in ((), (3,)):
            wanted = "(H, W)" if frames.order == "grey" else "(H, W, 3)"
            raise ValueError(f"frame: expected {wanted} for {frames.order}, got {frame.shape}")
        if frame.shape[:2] != size_wh[::-1]:
            raise CalichromeError(
                f"the picture is {frame.shape[1]}x{frame.shape[0]}, the camera was calibrated at "
                f"{size_wh[0]}x{size_wh[1]}; record at that size"
            )
        return frame if _has_whole_pixels(frame) else np.ascontiguousarray(frame)

    def _check_out(self, out: Pixels, frame: Pixels) -> None:
        if out.shape != self.output_shape or out.dtype != self.output_dtype:
            raise ValueError(
                f"out: expected {self.output_shape} {self.output_dtype}, got {out.shape} "
                f"{out.dtype}"
            )
        if not (out.flags.writeable and _has_whole_pixels(out)):
            raise ValueError("out: expected a writeable array whose pixels lie side by side")
        if np.may_share_memory(out, frame):
            raise ValueError("out: shares memory with frame")


def _has_whole_pixels(pixels: Pixels) -> bool:
    """Whether the pixels of each row lie side by side; rows may be anywhere."""
    return bool(pixels.flags.aligned and pixels[0].flags.c_contiguous)


def _shape(size_wh: tuple[int, int], frames: FrameFormat) -> tuple[int, ...]:
    return (*size_wh[::-1], *(() if frames.order == "grey" else (3,)))


def _correction(
    camera: Camera,
    space: OutputSpace,
    source_map: SourceMap | None,
    frames: FrameFormat,
    output: PixelType | None,
) -> Correction:
    if source_map is not None and (
        source_map.ndim != 3 or source_map.shape[2] != 2 or source_map.size == 0
    ):
        raise ValueError(f"source_map: expected shape (H, W, 2), got {source_map.shape}")
    colour = None
    if space != "none":
        if camera.colour is None:
            raise CalichromeError(
                "this camera has no colour calibration; use --colour none, or calibrate with the "
                "colour target"
            )
        if frames.order == "grey":
            raise CalichromeError("the picture is grey; use --colour none")
        if space == "xyz-d65" and output not in (None, "float32"):
            raise ValueError(f"output={output!r}: XYZ needs float32")
        colour = colour_of(
            camera,
            camera.colour,
            frames,
            source_map,
            np.eye(3)
            if space == "xyz-d65"
            else RGB_FROM_XYZ["display-p3" if space == "display-p3" else "srgb"],
            is_encoded=space in _ENCODED,
            clips=space != "xyz-d65",
        )
    out_type = output or _usual_type(space, frames.dtype)
    return Correction(
        size_wh=camera.size_wh,
        out_size_wh=camera.size_wh
        if source_map is None
        else (source_map.shape[1], source_map.shape[0]),
        frames=frames,
        out_type=out_type,
        out_scale=out_scale_of(frames, out_type, has_colour=colour is not None),
        map=None if source_map is None else map_grid(source_map, camera.size_wh),
        colour=colour,
    )


def _usual_type(space: OutputSpace, dtype: PixelType) -> PixelType:
    if space == "none":
        return dtype
    if space == "xyz-d65" or dtype == "float32":
        return "float32"
    return "uint8" if dtype == "uint8" and space in _ENCODED else "uint16"

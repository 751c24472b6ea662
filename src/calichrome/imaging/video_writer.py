"""Frames into an MP4 file: H.264 with the times and colour tags that they have."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calichrome.core.arrays import Scratch
from calichrome.errors import OutputError
from calichrome.imaging.image import Pixels
from calichrome.imaging.pyav import av
from calichrome.imaging.video_stream import StreamFormat
from calichrome.imaging.yuv import FULL, LIMITED, frame_of_rgb, stated_matrix

if TYPE_CHECKING:
    from av import VideoFrame

__all__ = ["Preset", "VideoSettings", "VideoWriter"]

Preset = Literal[
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"
]
_UNSPECIFIED = 2
_FRAGMENTS = "hybrid_fragmented+frag_keyframe+delay_moov+negative_cts_offsets"
_KEY_S = 2  # between key frames: what a killed run loses, and what a player decodes to seek


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSettings:
    """How videos are encoded."""

    preset: Preset = "veryfast"
    """How much work x264 puts into small files."""
    crf: int = 18
    """Quality, 0 (best) to 51; 18 is hardly told from the original."""


class VideoWriter:
    """An MP4 file that can be played whenever it is cut off.

    Parameters
    ----------
    path
        Of the file.
    size_wh
        Of its frames, pixels. An odd size is stored without subsampled chroma.
    form
        Its times, tags and depth: more than 8 bits become 10.
    settings
        How it is encoded.

    Raises
    ------
    OutputError
        If there is no such quality, or the encoder or the disk refuses.

    Notes
    -----
    While it grows the file consists of fragments of two seconds that can be played; `close` makes
    one of them. MP4 knows no time before 0: if the first is, all are moved until it is 0.
    """

    def __init__(
        self, path: Path, size_wh: tuple[int, int], form: StreamFormat, settings: VideoSettings
    ) -> None:
        if not 0 <= settings.crf <= 51:
            raise OutputError(f"--crf {settings.crf} is no quality of x264; choose 0 (best) to 51")
        self._path, self._form = path, form
        self._matrix = stated_matrix(form.matrix, size_wh[1])
        is_odd = any(side % 2 for side in size_wh)
        self._layout = f"yuv{'444' if is_odd else '420'}p{'10le' if form.is_deep else ''}"
        self._shift: int | None = None
        self._n_frames = 0
        with self._explained():
            self._container = av().open(
                str(path),
                "w",
                format="mp4",
                options={
                    # a fragment that ends between key frames may lose the last frame of the file
                    "movflags": _FRAGMENTS,
                    # without these the first time is lost, or rounded to 1 ms
                    "use_editlist": "1",
                    "movie_timescale": str(form.time_base.denominator),
                },
            )
            self._stream = self._container.add_stream(
                "libx264",
                options={
                    "preset": settings.preset,
                    "crf": str(settings.crf),
                    "g": str(max(1, round(_KEY_S * form.rate))),
                },
            )
        self._stream.width, self._stream.height = size_wh
        self._stream.pix_fmt = self._layout
        self._stream.time_base = form.time_base
        codec = self._stream.codec_context
        codec.time_base, codec.framerate = form.time_base, form.rate
        codec.thread_type = "FRAME"
        if form.pixel_aspect is not None:
            codec.sample_aspect_ratio = form.pixel_aspect
        codec.color_primaries, codec.color_trc = form.primaries, form.transfer
        codec.colorspace = _UNSPECIFIED if form.matrix == _UNSPECIFIED else self._matrix
        codec.color_range = FULL if form.full_range else LIMITED

    @property
    def n_frames(self) -> int:
        """How many frames were written."""
        return self._n_frames

    def frame(self, pixels: Pixels, stamp: int, scratch: Scratch | None = None) -> "VideoFrame":
        """Return what `write` wants of (H, W, 3) RGB or (H, W) grey; may run in any thread.

        Pixels are uint16 where the form is deep, else uint8.
        `stamp` is when it is shown, in units of the stream; `scratch` as in `frame_of_rgb`.
        """
        frame = frame_of_rgb(
            pixels,
            self._layout,
            self._matrix,
            full_range=self._form.full_range,
            scratch=scratch,
        )
        frame.pts, frame.time_base = stamp, self._form.time_base
        return frame

    def write(self, frame: "VideoFrame") -> None:
        """Encode the next frame.

        Raises
        ------
        OutputError
            If the encoder or the disk refuses.
        """
        stamp = frame.pts or 0
        if self._shift is None:
            self._shift = max(0, -stamp)
        frame.pts = stamp + self._shift
        with self._explained():
            self._container.mux(self._stream.encode(frame))
        self._n_frames += 1

    def close(self) -> None:
        """Encode what the encoder still holds and finish the file.

        Raises
        ------
        OutputError
            If the encoder or the disk refuses.
        """
        with self._explained():
            try:
                if self._shift is not None:
                    self._container.mux(self._stream.encode())
            finally:
                self._container.close()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except (av().error.FFmpegError, OSError) as error:
            reason = error.strerror or str(error)
            raise OutputError(
                f"{self._path.name} cannot be written as H.264 ({reason}); check the space on the "
                f"disk"
            ) from error

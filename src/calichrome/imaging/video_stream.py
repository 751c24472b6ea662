"""A whole video, frame by frame with its times, and what its copy has to say of itself."""

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from calichrome.errors import RecordingError
from calichrome.imaging.video import Video, numbered, opened
from calichrome.imaging.yuv import FULL

if TYPE_CHECKING:
    from av import VideoFrame

__all__ = ["StreamFormat", "TimedFrame", "stream_format", "timed_frames"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamFormat:
    """How a video counts time and what its numbers mean.

    Parameters
    ----------
    time_base
        Seconds per unit of its time stamps.
    rate
        Frames per second, in the mean.
    pixel_aspect
        Width of a pixel over its height; None: not said.
    primaries, transfer, matrix
        Codes of ITU-T H.273, tables 2 to 4; 2 is unspecified.
    full_range
        Whether codes use all values.
    is_deep
        More than 8 bits.
    is_grey
        No chroma.
    """

    time_base: Fraction
    rate: Fraction
    pixel_aspect: Fraction | None = None
    primaries: int = 2
    transfer: int = 2
    matrix: int = 2
    full_range: bool = False
    is_deep: bool = False
    is_grey: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class TimedFrame:
    """A decoded frame and when it is shown, in units of the stream.

    `is_stand_in` if it was lost: then it shows the next one that was not, or a damaged one.
    """

    frame: "VideoFrame"
    stamp: int
    is_stand_in: bool = False


def stream_format(video: Video) -> StreamFormat:
    """Read what a video says of itself.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    with opened(video.path) as container:
        stream = container.streams.video[0]
        codec = stream.codec_context
        layout = codec.format
        if layout is None:
            raise RecordingError(
                f"{video.path}: does not say how its pixels are stored; copy it again"
            )
        colours = [part for part in layout.components if not part.is_alpha]
        return StreamFormat(
            time_base=stream.time_base or Fraction(1, 1000),
            rate=_rate(stream),
            pixel_aspect=stream.sample_aspect_ratio or None,
            primaries=codec.color_primaries,
            transfer=codec.color_trc,
            matrix=codec.colorspace,
            full_range=codec.color_range == FULL or layout.name.startswith("yuvj"),
            is_deep=max(part.bits for part in colours) > 8,
            is_grey=len(colours) == 1,
        )


def timed_frames(video: Video) -> Generator[TimedFrame]:
    """Decode all frames in order, each with its time; numbers stay those of the file.

    A frame that cannot be decoded is replaced by the next one, so that frame n of several cameras
    remains one instant. Frames behind the end of a cut-off file are missing.

    Raises
    ------
    RecordingError
        If the file cannot be decoded, is interlaced, or changes its size.

    Notes
    -----
    One thread decodes: it is the least of the work (6 to 8 ms of 1080p, to 20 to 40 of encoding),
    and its time can be told from that of others.
    """
    with opened(video.path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "NONE"
        step = max(1, round(1 / (_rate(stream) * (stream.time_base or Fraction(1, 1000)))))
        stamp, expected = -step, 0
        with closing(numbered(video, container, 0)) as frames:
            for number, frame in frames:
                _check(video, frame)
                for missing in range(expected, number):
                    assert video.timestamps is not None  # noqa: S101 (else counted: none is missing)
                    yield TimedFrame(frame, video.timestamps[missing], is_stand_in=True)
                # AVI has no times, only an order
                known = frame.pts is not None and (expected == 0 or frame.pts > stamp)
                stamp = frame.pts if known and frame.pts is not None else stamp + step
                yield TimedFrame(frame, stamp, is_stand_in=frame.is_corrupt)
                expected = number + 1


def _rate(stream: Any) -> Fraction:  # noqa: ANN401 (a type of PyAV)
    return Fraction(stream.average_rate or stream.guessed_rate or 25)


def _check(video: Video, frame: "VideoFrame") -> None:
    if frame.interlaced_frame:
        raise RecordingError(
            f"{video.path}: is interlaced, so that a frame mixes two instants; deinterlace it to "
            f"progressive frames first"
        )
    if (frame.width, frame.height) != video.size_wh:
        raise RecordingError(
            f"{video.path}: changes from {video.size_wh[0]}x{video.size_wh[1]} to "
            f"{frame.width}x{frame.height} on its way; cut it there into two videos"
        )

"""Frames of videos, read through PyAV: one after the other, or any one by its number.

A frame's number is its place in the order of display. Packets are counted without decoding, so a
video of an hour opens in seconds; frames are decoded where they are needed, from the last key frame
before them, and never more than one is kept.
"""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from calichrome.colorimetry.encoding import EncodingName
from calichrome.core.arrays import UInt8Array
from calichrome.errors import RecordingError
from calichrome.imaging.header import Unreadable
from calichrome.imaging.image import Image
from calichrome.imaging.pyav import av
from calichrome.imaging.yuv import rgb_of_frame

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

__all__ = [
    "VIDEO_SUFFIXES",
    "Video",
    "grey_frames",
    "numbered",
    "open_video",
    "opened",
    "read_frame",
]

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".mts", ".m2ts")

_TRANSFERS = MappingProxyType({1: "rec709", 2: "rec709", 6: "rec709", 14: "rec709", 15: "rec709",
                               13: "srgb", 4: "gamma2.2", 8: "linear"})  # fmt: skip
"""ITU-T H.273, table 3 (transfer characteristics) -> encoding. 2 is unspecified: cameras then mean
BT.709. BT.601 (6) and BT.2020 (14, 15) share its curve."""

_SOUGHT = ("mp4", "matroska")
"""Containers (libavformat's names) in which frames are sought by time. AVI, MPEG and MTS came back
with other frames than asked for in 7 of 8 jumps (a test picture that holds its number)."""

_KEPT_OPEN = 4  # decoders per thread: about one per camera
_ROTATION_TAGS = MappingProxyType({0: 1, 90: 8, 180: 3, 270: 6})  # counter-clockwise -> EXIF's


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Video:
    """What a video file says of itself.

    Parameters
    ----------
    path
        The file.
    size_wh
        Width and height of its frames, pixels.
    timestamps
        Time of each frame in units of the stream, in order of display; None where the file does not
        find a frame by its time, so that frames are counted from the start.
    n_frames
        Number of frames.
    encoding
        How light became numbers.
    sha256
        Sum of the file.
    """

    path: Path
    size_wh: tuple[int, int]
    timestamps: tuple[int, ...] | None
    n_frames: int
    encoding: EncodingName
    sha256: str

    def frame_sum(self, index: int) -> str:
        """Return what stands for the sum of a frame: that of the file's sum and its number."""
        return hashlib.sha256(f"{self.sha256} {index}".encode()).hexdigest()


def open_video(path: Path, *, max_megapixels: float) -> Video:
    """Count the frames of a video without decoding them.

    Raises
    ------
    RecordingError
        If the file is no video that can be read, too large, interlaced, or of high dynamic range.
    """
    with opened(path) as container:
        if not container.streams.video:
            raise RecordingError(f"{path}: holds no video; remove it")
        stream = container.streams.video[0]
        codec = stream.codec_context
        if codec.width * codec.height > max_megapixels * 1e6:
            raise RecordingError(
                f"{path}: has more than {max_megapixels:.0f} megapixels (--max-megapixels); scale "
                f"it down"
            )
        encoding = _TRANSFERS.get(codec.color_trc)
        if encoding is None:
            raise RecordingError(
                f"{path}: its transfer function (code {codec.color_trc} of ITU-T H.273, such as PQ "
                f"and HLG) is not read; export it with that of BT.709"
            )
        stamps = [
            packet.pts
            for packet in container.demux(stream)
            if packet.size and not packet.is_discard
        ]
        is_sought = any(name in container.format.name for name in _SOUGHT)
        size_wh = codec.width, codec.height
    if not stamps:
        raise RecordingError(f"{path}: holds no frames; copy it again")
    known = [stamp for stamp in stamps if stamp is not None]
    ordered = tuple(sorted(set(known)))
    return Video(
        path=path,
        size_wh=size_wh,
        timestamps=ordered if is_sought and len(ordered) == len(stamps) else None,
        n_frames=len(stamps),
        encoding=encoding,  # type: ignore[arg-type]
        sha256=_sum_of(path),
    )


def _sum_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def opened(path: Path) -> Iterator["InputContainer"]:
    """Open a video for reading.

    Raises
    ------
    RecordingError
        If it cannot be opened, or whatever is done with it inside fails.
    """
    try:
        with av().open(str(path)) as container:
            _use_threads(container)
            yield container
    except (av().error.FFmpegError, OSError) as error:
        raise RecordingError(
            f"{path}: cannot be read as a video ({error.strerror}); copy it again"
        ) from error


def _use_threads(container: "InputContainer") -> None:
    for stream in container.streams.video:
        stream.thread_type = "AUTO"


def grey_frames(video: Video) -> Iterator[tuple[int, UInt8Array]]:
    """Decode all frames in order; yield the number of each and its luma, (H, W).

    Frames that are damaged are left out.

    Raises
    ------
    RecordingError
        If the file cannot be decoded, or is interlaced.
    """
    with opened(video.path) as container:
        for index, frame in numbered(video, container, 0):
            if frame.interlaced_frame:
                raise RecordingError(
                    f"{video.path}: is interlaced, so that a frame mixes two instants; "
                    f"deinterlace it to progressive frames first"
                )
            if not frame.is_corrupt:
                yield index, frame.to_ndarray(format="gray").astype(np.uint8, copy=False)


def numbered(
    video: Video, container: "InputContainer", first: int
) -> Generator[tuple[int, "VideoFrame"]]:
    """Decode on; number frames by their time, or count them from `first`."""
    stream = container.streams.video[0]
    numbers = _numbers(video)
    frames = _decoded(container, stream, skips_damage=numbers is not None)
    for count, frame in enumerate(frames, first):
        if numbers is None:
            yield count, frame
        elif frame.pts in numbers:
            yield numbers[frame.pts], frame


def _decoded(
    container: "InputContainer",
    stream: Any,  # noqa: ANN401 (a type of PyAV)
    *,
    skips_damage: bool,
) -> Iterator["VideoFrame"]:
    """Decode until the end, or until the file is found cut off: what came before is good.

    Behind a damaged packet it goes on only if frames are not numbered by counting them.
    """
    damage = av().error.InvalidDataError
    failure = None
    n_decoded = 0
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
            frames = [] if packet is None else packet.decode()
        except damage as error:
            failure = error
            if packet is None or not skips_damage:
                break
            continue
        if packet is None:
            break
        n_decoded += len(frames)
        yield from frames
    if failure is not None and n_decoded == 0:
        raise failure


@lru_cache(maxsize=_KEPT_OPEN)
def _numbers(video: Video) -> dict[int, int] | None:
    if video.timestamps is None:
        return None
    return {stamp: index for index, stamp in enumerate(video.timestamps)}


class _Reader:
    """One open video that goes on where it stopped, or jumps to a key frame."""

    def __init__(self, video: Video) -> None:
        self.video = video
        self._open()

    def _open(self) -> None:
        self._container: InputContainer = av().open(str(self.video.path))
        _use_threads(self._container)
        self._frames = numbered(self.video, self._container, 0)
        self._next = 0

    def read(self, index: int) -> "VideoFrame | None":
        """Return frame `index`, or None if it cannot be decoded."""
        if index < self._next or index > self._next + _STEPS:
            self._jump(index)
        for number, frame in self._frames:
            self._next = number + 1
            if number == index:
                return frame
            if number > index:
                return None
        return None

    def _jump(self, index: int) -> None:
        stamps = self.video.timestamps
        if stamps is not None:
            self._container.seek(stamps[index], stream=self._container.streams.video[0])
            self._frames = numbered(self.video, self._container, 0)
            self._next = index
        elif index < self._next:
            self.close()
            self._open()

    def close(self) -> None:
        """Close the file."""
        self._container.close()


_STEPS = 8
"""Frames to go on rather than to jump: a jump decodes from the key frame before, mostly more."""

_LOCAL = threading.local()


def _reader(video: Video) -> _Reader:
    """Return the open reader of this thread; the longest unused ones are closed."""
    readers: OrderedDict[Video, _Reader] = _LOCAL.__dict__.setdefault("readers", OrderedDict())
    if video not in readers:
        readers[video] = _Reader(video)
    readers.move_to_end(video)
    while len(readers) > _KEPT_OPEN:
        readers.popitem(last=False)[1].close()
    return readers[video]


def read_frame(
    video: Video, index: int, *, encoding: EncodingName | None = None, bits: int | None = None
) -> Image | Unreadable:
    """Read one frame; a frame that cannot be decoded is an answer, not an exception.

    Parameters
    ----------
    video
        From `open_video`.
    index
        Number of the frame in the order of display, from 0.
    encoding, bits
        Over what the file says.

    Notes
    -----
    More than 8 bits come as 16-bit pixels that use the whole range. A rotation that the file asks
    players for is not applied: it would change the pixel frame of the lens.
    """
    try:
        frame = _reader(video).read(index)
    except (av().error.FFmpegError, OSError) as error:
        return Unreadable(f"cannot be decoded ({error.strerror}); copy the video again")
    if frame is None or frame.is_corrupt:
        return Unreadable("cannot be decoded, the video is damaged there; copy it again")
    if (frame.width, frame.height) != video.size_wh:
        return Unreadable(f"is {frame.width}x{frame.height}, unlike the start of the video")
    pixels = rgb_of_frame(frame)
    full_bits = 8 * pixels.dtype.itemsize
    return Image(
        pixels=pixels,
        encoding=encoding or video.encoding,
        bits=min(bits or full_bits, full_bits),
        sha256=video.frame_sum(index),
        rotation_tag=_ROTATION_TAGS.get(int(frame.rotation) % 360, 1),
    )

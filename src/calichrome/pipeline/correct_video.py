"""Videos corrected: decoded, corrected and encoded at the same time."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import repeat
from pathlib import Path
from threading import Lock, local
from typing import TYPE_CHECKING

from calichrome.apply import Corrector, OutputSpace
from calichrome.core.arrays import Scratch
from calichrome.errors import InterruptedOutputError, RecordingError
from calichrome.imaging import (
    BT709,
    StreamFormat,
    TimedFrame,
    Video,
    VideoSettings,
    VideoWriter,
    rgb_of_frame,
    stream_format,
    timed_frames,
)
from calichrome.pipeline.correctors import CameraCorrectors
from calichrome.pipeline.detect import Progress
from calichrome.pipeline.stages import ahead
from calichrome.pipeline.workers import n_cores

if TYPE_CHECKING:
    from av import VideoFrame

__all__ = ["VideoJob", "VideoOutcome", "check_complete", "correct_videos", "video_job"]

_PRIMARIES = {"srgb": 1, "display-p3": 12}
_SRGB_TRANSFER = 13
"""Codes of ITU-T H.273, tables 2 and 3: BT.709 and SMPTE EG 432-1; IEC 61966-2-1."""

_AHEAD = 2
"""Frames that a stage has ready beyond those in work, so that none waits for a slow key frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VideoJob:
    """What to do with a video.

    Parameters
    ----------
    video, form
        The source.
    corrector
        Of its camera and format.
    space
        Colour space of the corrected frames.
    keeps_pixel_shape
        Whether corrected pixels are as wide and high as recorded; else they are square.
    settings
        How to encode.
    """

    video: Video
    form: StreamFormat
    corrector: Corrector
    space: OutputSpace
    keeps_pixel_shape: bool
    settings: VideoSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoOutcome:
    """What became of a video.

    Parameters
    ----------
    name
        Of the file.
    n_frames
        Frames written.
    n_expected
        Frames that the source says it has.
    n_stand_ins
        Of those written: frames that could not be decoded and show the next one, or are damaged.
    wall_s
        Seconds that passed.
    cpu_s
        Seconds of all cores for "decode", "convert" (YUV to RGB and back), "correct" and "encode".
    is_partial
        Whether it was interrupted.
    """

    name: str
    n_frames: int
    n_expected: int
    n_stand_ins: int
    wall_s: float
    cpu_s: Mapping[str, float]
    is_partial: bool = False


def video_job(
    video: Video,
    correctors: CameraCorrectors,
    space: OutputSpace,
    *,
    keeps_pixel_shape: bool,
    settings: VideoSettings | None,
) -> VideoJob:
    """Prepare the correction of a video.

    Parameters
    ----------
    video
        The source.
    correctors
        Of its camera.
    space
        Their colour space.
    keeps_pixel_shape, settings
        As in `VideoJob`.

    Raises
    ------
    CalichromeError
        If the video cannot be read or does not fit the camera, or `space` is linear.
    """
    if space in ("linear-srgb", "xyz-d65"):
        raise RecordingError(
            f"--colour {space} is linear light, for which the 8 or 10 bits of videos are too few; "
            f"use srgb, display-p3 or none, or extract the frames as PNG"
        )
    form = stream_format(video)
    return VideoJob(
        video=video,
        form=form,
        corrector=correctors.of_video(video, form),
        space=space,
        keeps_pixel_shape=keeps_pixel_shape,
        settings=settings or VideoSettings(),
    )


def correct_videos(
    jobs: Mapping[str, VideoJob], folder: Path, what: str, progress: Progress
) -> dict[str, VideoOutcome]:
    """Correct the videos of cameras, one after the other, until Ctrl-C.

    Parameters
    ----------
    jobs
        By camera.
    folder
        Where ``<camera>.mp4`` is written; after Ctrl-C ``<camera>.partial.mp4``, which holds what
        was encoded until then and can be played.
    what
        Is being done, for `progress`.
    progress
        Called after each frame.

    Returns
    -------
    dict
        By camera; after Ctrl-C without those that were not begun.

    Raises
    ------
    CalichromeError
        If a video cannot be read, corrected or written.
    KeyboardInterrupt
        If no frame was done.
    """
    outcomes: dict[str, VideoOutcome] = {}
    for name, job in jobs.items():
        path = folder / f"{name}.mp4"
        count = partial(_count, progress, f"{what} {name}", job.video.n_frames)
        try:
            outcomes[name] = _correct_video(job, path, count)
        except KeyboardInterrupt:
            if not outcomes:
                raise
            path.unlink(missing_ok=True)
            break
        if outcomes[name].is_partial:
            path.rename(folder / outcomes[name].name)
            break
    return outcomes


def _count(progress: Progress, what: str, total: int, done: int) -> None:
    progress(what, done, total)


def check_complete(
    outcomes: Mapping[str, VideoOutcome], jobs: Mapping[str, VideoJob], output: Path
) -> None:
    """Raise `InterruptedOutputError` that says what is in `output`, if it is not everything."""
    if len(outcomes) == len(jobs) and not any(item.is_partial for item in outcomes.values()):
        return
    kept = [
        f"{output / item.name} "
        + (f"with {item.n_frames} of {item.n_expected} frames" if item.is_partial else "whole")
        for item in outcomes.values()
    ]
    raise InterruptedOutputError(f"interrupted; kept {' and '.join(kept)}; run again with --force")


def _correct_video(job: VideoJob, output: Path, progress: Callable[[int], None]) -> VideoOutcome:
    """Correct one video; after Ctrl-C the outcome is partial, or without any frame it is raised."""
    clock = _Clock()
    start_wall_s, start_cpu_s = time.monotonic(), time.process_time()
    n_done = n_stand_ins = 0
    is_partial = False
    height, width = job.corrector.output_shape[:2]
    writer = VideoWriter(output, (width, height), _output_format(job), job.settings)
    with closing(writer):
        try:
            with closing(_written(job, writer, clock)) as done:
                for timed in done:
                    n_done += 1
                    n_stand_ins += timed.is_stand_in
                    progress(n_done)
        except KeyboardInterrupt:
            if writer.n_frames == 0:
                raise
            is_partial = True
    used_s = time.process_time() - start_cpu_s
    clock.spent_s["encode"] = used_s - sum(clock.spent_s.values())  # x264 has threads of its own
    return VideoOutcome(
        name=f"{output.stem}.partial.mp4" if is_partial else output.name,
        n_frames=writer.n_frames,
        n_expected=job.video.n_frames,
        n_stand_ins=n_stand_ins,
        wall_s=time.monotonic() - start_wall_s,
        cpu_s=clock.spent_s,
        is_partial=is_partial,
    )


def _output_format(job: VideoJob) -> StreamFormat:
    form = job.form
    if not job.keeps_pixel_shape:
        form = replace(form, pixel_aspect=Fraction(1))
    if job.space == "none":
        return form
    return replace(
        form,
        primaries=_PRIMARIES[job.space],
        transfer=_SRGB_TRANSFER,
        matrix=BT709,
        full_range=False,
    )


class _Clock:
    """CPU time of threads by what they do."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = dict.fromkeys(("decode", "convert", "correct"), 0.0)
        self._lock = Lock()

    @contextmanager
    def measures(self, what: str) -> Iterator[None]:
        start_s = time.thread_time()
        try:
            yield
        finally:
            with self._lock:
                self.spent_s[what] += time.thread_time() - start_s


def _written(job: VideoJob, writer: VideoWriter, clock: _Clock) -> Generator[TimedFrame]:
    """Yield each frame once it is encoded.

    The caller's thread only waits: Ctrl-C, which reaches it alone, never tears a frame apart.
    """

    def decode(frames: Iterator[TimedFrame]) -> TimedFrame | None:
        with clock.measures("decode"):
            return next(frames, None)

    by_thread = local()

    def correct(timed: TimedFrame) -> tuple[TimedFrame, "VideoFrame"]:
        scratch = by_thread.__dict__.setdefault("scratch", Scratch())
        corrector = job.corrector
        out = scratch.array("corrected", corrector.output_shape, corrector.output_dtype)
        with clock.measures("convert"):
            pixels = rgb_of_frame(timed.frame, scratch)
        with clock.measures("correct"):
            corrected = corrector.apply(pixels, out)
        with clock.measures("convert"):
            return timed, writer.frame(corrected, timed.stamp, scratch)

    def write(item: tuple[TimedFrame, "VideoFrame"]) -> TimedFrame:
        timed, frame = item
        writer.write(frame)
        return timed

    n_workers = n_cores()
    with (
        closing(timed_frames(job.video)) as frames,
        _threads(1) as decoder,
        _threads(n_workers) as workers,
        _threads(1) as encoder,
    ):
        decoded = _until_none(ahead(decoder, decode, repeat(frames), _AHEAD))
        corrected = ahead(workers, correct, decoded, n_workers + _AHEAD)
        yield from ahead(encoder, write, corrected, _AHEAD)


@contextmanager
def _threads(count: int) -> Iterator[Executor]:
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _until_none(items: Iterable[TimedFrame | None]) -> Iterator[TimedFrame]:
    for item in items:
        if item is None:
            return
        yield item

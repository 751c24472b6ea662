"""Which frames of videos are looked at: sharp, still and different ones, the same of all cameras.

A minute of video holds thousands of frames, most of them blurred by motion or twins of others, and
many without a board. A board of any kind is a field of saddle points (black and white squares that
meet corner to corner); hardly anything else in a room is, and the strength of a saddle falls with
every blur. So the strongest saddles of a frame tell at once whether a board is there and how sharp.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, IntArray, UInt8Array
from calichrome.errors import RecordingError
from calichrome.imaging.recording import Recording
from calichrome.imaging.video import Video, grey_frames

__all__ = ["MAX_FRAMES", "choose_frames"]

MAX_FRAMES = 80
"""Frames of each camera that are looked at, unless asked otherwise."""

Progress = Callable[[str, int, int], None]

_THUMB_WH = (16, 9)  # tiles of a frame whose means are compared with those of other frames
_SADDLES = 24  # strongest saddles that count: about those of a 4x5 board with its codes
_CELL_PX = 16  # one saddle counts per cell, so that one strong corner does not count twice
_SEARCH_WH = 1280  # frames are halved until no side is longer, as for finding boards
_MAX_CANDIDATES = 4000  # frames that are compared with each other; the best of equal spans of time
_NOTHING = 0.5  # grey levels between tiles: below, two frames are twins


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """What one camera's frames look like: `saddles` (N,), `motion` (N,), `thumbs` (N, T).

    N are the frames of the recording; `saddles` is nan where this camera has none.
    """

    saddles: FloatArray
    motion: FloatArray
    thumbs: NDArray[np.float32]


def choose_frames(
    recording: Recording, max_frames: int = MAX_FRAMES, *, progress: Progress | None = None
) -> Recording:
    """Keep at most `max_frames` frames of each video, the same of all cameras.

    Parameters
    ----------
    recording
        A recording of pictures is returned as it is.
    max_frames
        How many frames to keep, 1 or more.
    progress
        Called with what is being done, how many frames are done, and of how many.

    Raises
    ------
    RecordingError
        If a video cannot be decoded, or is interlaced, or `max_frames` is not positive.
    """
    if max_frames < 1:
        raise RecordingError(f"--max-frames {max_frames}: give 1 or more")
    if not recording.videos.videos or _most_frames(recording) <= max_frames:
        return recording
    frames = list(dict.fromkeys(frame for own in recording.files.values() for frame in own))
    tracks = _look_at(recording, frames, progress)
    chosen = {frames[index] for index in _choose(tracks, max_frames)}
    return replace(
        recording,
        files={
            camera: {frame: path for frame, path in own.items() if frame in chosen}
            for camera, own in recording.files.items()
        },
        reading=f"{recording.reading}; {len(chosen)} of {len(frames)} frames chosen (--max-frames)",
    )


def _most_frames(recording: Recording) -> int:
    return len({frame for own in recording.files.values() for frame in own})


def _look_at(recording: Recording, frames: list[str], progress: Progress | None) -> list[_Track]:
    places = {frame: place for place, frame in enumerate(frames)}
    total = sum(recording.videos.videos[camera].n_frames for camera in recording.cameras)
    tracks: list[_Track] = []
    done = 0
    for camera in recording.cameras:
        numbers = recording.videos.table.numbers[camera]
        wanted = {numbers[frame]: places[frame] for frame in recording.files[camera]}
        video = recording.videos.videos[camera]

        def report(seen: int, before: int = done) -> None:
            if progress is not None:
                progress("choosing frames", before + seen, total)

        tracks.append(_look_at_video(video, wanted, len(frames), report))
        done += video.n_frames
    if progress is not None:
        progress("choosing frames", total, total)
    return tracks


def _look_at_video(
    video: Video, wanted: dict[int, int], n_frames: int, report: Callable[[int], None]
) -> _Track:
    saddles = np.full(n_frames, np.nan)
    motion = np.zeros(n_frames)
    thumbs = np.zeros((n_frames, _THUMB_WH[0] * _THUMB_WH[1]), dtype=np.float32)
    last_place, last_thumb = -1, thumbs[0]
    for number, grey in grey_frames(video):
        report(number)
        thumb = cv2.resize(grey, _THUMB_WH, interpolation=cv2.INTER_AREA).ravel()
        thumb = thumb.astype(np.float32)
        step = float(np.abs(thumb - last_thumb).max()) if last_place >= -1 and number else 0.0
        if last_place >= 0:  # a frame is still if neither neighbour differs from it
            motion[last_place] = max(motion[last_place], step)
        last_place, last_thumb = wanted.get(number, -1), thumb
        if last_place >= 0:
            motion[last_place] = step
            thumbs[last_place] = thumb
            saddles[last_place] = _saddle_strength(grey)
    return _Track(saddles, motion, thumbs)


def _saddle_strength(grey: UInt8Array) -> float:
    """Return the mean strength of the strongest saddles, grey levels per px^2.

    The strength is sqrt(-det H) of the Hessian after slight smoothing.
    """
    while max(grey.shape) > _SEARCH_WH:
        grey = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(grey, (5, 5), 1.0).astype(np.float32)
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3, scale=0.25)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3, scale=0.25)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=0.25)
    saddle = cv2.subtract(cv2.multiply(xy, xy, dst=xy), cv2.multiply(xx, yy, dst=xx), dst=xy)
    rows, columns = (length // _CELL_PX * _CELL_PX for length in saddle.shape)
    of_rows = saddle[:rows, :columns].reshape(rows // _CELL_PX, _CELL_PX, -1).max(axis=1)
    best = of_rows.reshape(len(of_rows), -1, _CELL_PX).max(axis=2).ravel()
    strongest = np.partition(best, -_SADDLES)[-_SADDLES:] if best.size > _SADDLES else best
    return float(np.sqrt(np.maximum(strongest, 0)).mean()) if strongest.size else 0.0


def _choose(tracks: list[_Track], max_frames: int) -> IntArray:
    """Take the best frame, then always the one that is best and most unlike those taken."""
    quality = np.mean([_quality(track) for track in tracks], axis=0)
    candidates = _best_of_spans(quality, _MAX_CANDIDATES)
    thumbs = np.concatenate([track.thumbs[candidates] for track in tracks], axis=1)
    good = quality[candidates]
    chosen = [int(np.argmax(good))]
    distance = np.full(len(candidates), np.inf)
    while len(chosen) < min(max_frames, len(candidates)):
        step = np.sqrt(((thumbs - thumbs[chosen[-1]]) ** 2).mean(axis=1))
        distance = np.minimum(distance, step)
        gain = np.where(distance > _NOTHING / thumbs.shape[1] ** 0.5, good * distance, 0)
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        chosen.append(best)
    return np.sort(candidates[chosen])


def _quality(track: _Track) -> FloatArray:
    """Return how well each frame shows a sharp board at rest, 0..1, (N,).

    Saddles count from what the room has (5 % of the frames show less) to what the best frames have.
    """
    seen = np.isfinite(track.saddles)
    if not seen.any():
        return np.zeros(len(seen))
    low, high = np.quantile(track.saddles[seen], [0.05, 0.95])
    span = max(float(high - low), 1e-9)
    sharp = np.clip((np.nan_to_num(track.saddles, nan=low) - low) / span, 0.02, 1)
    typical = max(float(np.median(track.motion[seen])), _NOTHING)
    return np.where(seen, sharp / (1 + track.motion / typical), 0.0)


def _best_of_spans(quality: FloatArray, n_spans: int) -> IntArray:
    edges = np.linspace(0, len(quality), min(n_spans, len(quality)) + 1).astype(int)
    best = [first + int(np.argmax(quality[first:last]))
            for first, last in pairwise(edges)]  # fmt: skip
    return np.array(best)

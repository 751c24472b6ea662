"""A recording in, observations out."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.findings import Finding, finding
from calichrome.core.units import parse_lengths
from calichrome.detection import detect_board, draw_overlay
from calichrome.errors import DetectionError, RecordingError, TargetError
from calichrome.imaging import Recording, Unreadable, write_picture
from calichrome.observations import BoardView, Dataset, NotFound
from calichrome.pipeline.detection_cache import DetectionCache, Seen, cache_folder, context_of
from calichrome.pipeline.workers import JobLostError, n_cores, spread
from calichrome.target import (
    Target,
    check_target,
    load_target,
    parse_target,
    with_square_size,
)

_USUAL_COV_SCALE = 1.6
"""White noise alone left 0.69 to 1.34 in 70 random scenes of 56 corners, 0.98 in the median."""

__all__ = [
    "Detection",
    "DetectionSettings",
    "Progress",
    "detect_recording",
    "find_target",
    "silent",
]

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many are done, and of how many."""

_WORTH_MP = 60.0
"""Fewer megapixels are searched in this process, unless a number of workers is asked for. To start
a process takes 0.7 s (measured on two cores: most of it imports), in which one core searches 28 MP
at 25 ms each; two cores save half of the search, so they begin to pay at twice that."""


def silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionSettings:
    """How to go about a detection; none of these changes its result.

    Parameters
    ----------
    cache
        Folder where detections are kept, so that no picture is searched twice and an interrupted
        run goes on where it was. Default: the user's cache folder.
    no_cache
        Search every picture, and keep nothing.
    workers
        Pictures that are searched at the same time; each takes a process and its memory.
        Default: the number of cores.
    """

    cache: Path | None = None
    no_cache: bool = False
    workers: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detection:
    """What was seen in a recording.

    Parameters
    ----------
    dataset
        Cameras that see no board hold no views.
    rejected
        (camera, frame, reason) of every picture without a view.
    findings
        About files and pictures.
    n_cached
        Pictures that had been searched before.
    """

    dataset: Dataset
    rejected: tuple[tuple[str, str, str], ...]
    findings: tuple[Finding, ...]
    n_cached: int = 0


_Key = tuple[str, str]  # camera id, frame id


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Look:
    """Searches pictures; sent to every process once.

    `known` are detections that only have to be drawn.
    """

    recording: Recording
    target: Target
    overlay: Path | None
    known: Mapping[_Key, Seen]

    def __call__(self, key: _Key) -> Seen:
        image = self.recording.read(*key)
        if isinstance(image, Unreadable):
            return Seen(found=image)
        known = self.known.get(key)
        found = detect_board(image, self.target) if known is None else known.found
        if self.overlay is not None and not isinstance(found, Unreadable):
            drawn = draw_overlay(image, self.target, found)
            path = self.overlay / key[0] / f"{key[1]}.jpg"
            write_picture(path, drawn, jpeg_quality=90, force=True)
        return Seen(
            found=found,
            size_wh=image.size_wh,
            sha256=image.sha256,
            exposure=image.exposure,
            rotation_tag=image.rotation_tag,
        )


def find_target(recording: Recording | None, target: str | None, square: str | None) -> Target:
    """Take the target from the command line, recording.toml, or target.json of the recording.

    Raises
    ------
    TargetError
        If there is none, or it is wrong.
    """
    found = _load_target(recording, target)
    errors = [item.text for item in check_target(found) if item.severity == "error"]
    if errors:
        raise TargetError(f"the target cannot be used: {errors[0]}")
    size = square or (None if recording is None else recording.settings.square)
    if size is None:
        return found
    try:
        return with_square_size(found, parse_lengths(size))
    except ValueError as error:
        raise TargetError(f"--square {error}") from error


def _load_target(recording: Recording | None, target: str | None) -> Target:
    if target is not None:
        return parse_target(target)
    if recording is None:
        raise TargetError(
            "the target is not known; give --target FILE or --target chessboard:NxM:SIZE"
        )
    beside = recording.folder / "target.json"
    text = recording.settings.target
    if text is not None:
        named = recording.folder / text
        return load_target(named) if named.is_file() else parse_target(text)
    if beside.is_file():
        return load_target(beside)
    raise TargetError(
        f"{recording.folder}: the target is not known; put its target.json there, or give "
        f"--target FILE or --target chessboard:NxM:SIZE"
    )


def detect_recording(
    recording: Recording,
    target: Target,
    *,
    overlay: Path | None = None,
    settings: DetectionSettings | None = None,
    progress: Progress = silent,
) -> Detection:
    """Look for the board in every picture.

    Parameters
    ----------
    recording, target
        What to look at and for.
    overlay
        Folder for pictures with the detections drawn in, ``<camera>/<frame>.jpg``.
    settings
        Where detections are kept, and how many pictures are searched at a time.
    progress
        Called after each picture.

    Raises
    ------
    RecordingError
        If a camera has pictures of several sizes, or none that can be read.
    DetectionError
        If the search of a picture takes more memory than there is.
    """
    settings = settings or DetectionSettings()
    if settings.workers is not None and settings.workers < 1:
        raise DetectionError(f"--workers {settings.workers}: give 1 or more")
    keys = [(camera, frame) for camera in recording.cameras for frame in recording.files[camera]]
    contexts = {camera: context_of(target, recording.entry(camera)) for camera in recording.cameras}
    folder = None if settings.no_cache else cache_folder(settings.cache)
    with DetectionCache(folder) as cache:
        known = _from_cache(recording, keys, contexts, cache, progress)
        seen = dict(known)
        label = "looking for the board"
        if known:
            label += f" ({len(known)} of {len(keys)} from the cache)"
        jobs = [key for key in keys if overlay is not None or key not in known]
        progress(label, len(keys) - len(jobs), len(keys))
        drawn = {} if overlay is None else known
        look = _Look(recording=recording, target=target, overlay=overlay, known=drawn)
        workers = settings.workers or _worthwhile_workers(recording, jobs)
        try:
            with closing(spread(look, jobs, workers=workers)) as results:
                for n_done, (key, result) in enumerate(results, len(keys) - len(jobs) + 1):
                    seen[key] = result
                    if key not in known:
                        cache.put(contexts[key[0]], result)
                    progress(label, n_done, len(keys))
        except JobLostError as error:
            raise _lost(error.job) from error
    return _gathered(recording, {key: seen[key] for key in keys}, len(known))


def _from_cache(
    recording: Recording,
    keys: Sequence[_Key],
    contexts: Mapping[str, str],
    cache: DetectionCache,
    progress: Progress,
) -> dict[_Key, Seen]:
    """Return what was seen before; pictures are summed only if anything was."""
    worth_it = {camera for camera, context in contexts.items() if cache.knows(context)}
    asked = [key for key in keys if key[0] in worth_it]
    known = {}
    for n_done, (camera, frame) in enumerate(asked, 1):
        seen = cache.get(contexts[camera], _sum(recording, (camera, frame)))
        if seen is not None and seen.size_wh is not None:
            width, height = seen.size_wh
            if width * height <= recording.max_megapixels * 1e6:
                known[camera, frame] = seen
        progress("comparing with the cache", n_done, len(asked))
    return known


def _sum(recording: Recording, key: _Key) -> str:
    """SHA-256 of a picture; "" if it cannot be read, which its search will say."""
    try:
        return recording.content_sum(*key)
    except OSError:
        return ""


def _worthwhile_workers(recording: Recording, jobs: Sequence[_Key]) -> int:
    """Return the number of cores, or 1 where to start processes takes longer than it saves."""
    megapixels = 0.0
    for camera, n_jobs in Counter(camera for camera, _ in jobs).items():
        size_wh = recording.read_size(camera)
        if not isinstance(size_wh, Unreadable):
            megapixels += n_jobs * size_wh[0] * size_wh[1] / 1e6
    return n_cores() if megapixels > _WORTH_MP else 1


def _lost(key: _Key) -> DetectionError:
    return DetectionError(
        f"camera {key[0]}: the search of picture {key[1]} was ended from outside (most often: out "
        f"of memory); scale the picture down or leave it out, or close other programs"
    )


def _gathered(recording: Recording, seen: Mapping[_Key, Seen], n_cached: int) -> Detection:
    views: dict[str, dict[str, BoardView]] = {camera: {} for camera in recording.cameras}
    for (camera, frame), result in seen.items():
        if isinstance(result.found, BoardView):
            views[camera][frame] = result.found
    return Detection(
        dataset=Dataset(
            sizes_wh=_sizes(recording, seen),
            views=views,
            sums={key: item.sha256 for key, item in seen.items() if item.sha256},
            exposures={key: item.exposure for key, item in seen.items() if item.exposure},
        ),
        rejected=tuple(
            (*key, item.found.reason)
            for key, item in seen.items()
            if not isinstance(item.found, BoardView)
        ),
        findings=_file_findings(seen),
        n_cached=n_cached,
    )


def require_boards(detection: Detection, recording: Recording) -> None:
    """Raise `DetectionError` when a camera sees no board at all, with the likeliest reason."""
    for camera, views in detection.dataset.views.items():
        if views:
            continue
        frames = list(recording.files[camera])
        reasons = Counter(reason for cam, _, reason in detection.rejected if cam == camera)
        likeliest = reasons.most_common(1)[0][0]
        remedy = "leave it out with --cameras, or record it again"
        if len(detection.dataset.views) == 1:
            remedy = "look at the pictures, and check --target"
        raise DetectionError(
            f"camera {camera}: the board is in none of its {len(frames)} pictures (most often: "
            f"{likeliest}); {remedy}"
        )


def _sizes(recording: Recording, seen: Mapping[_Key, Seen]) -> dict[str, tuple[int, int]]:
    sizes: dict[str, dict[tuple[int, int], list[str]]] = defaultdict(lambda: defaultdict(list))
    for (camera, frame), item in seen.items():
        if item.size_wh is not None:
            sizes[camera][item.size_wh].append(frame)
    for camera in recording.cameras:
        if not sizes[camera]:
            frame, reason = next(
                (frame, item.found.reason)
                for (cam, frame), item in seen.items()
                if cam == camera and isinstance(item.found, Unreadable)
            )
            raise RecordingError(
                f"camera {camera}: none of its pictures can be read; the first, {frame}: {reason}"
            )
        if len(sizes[camera]) > 1:
            described = ", ".join(
                f"{w}x{h} ({len(frames)}, for example {frames[0]})"
                for (w, h), frames in sizes[camera].items()
            )
            raise RecordingError(
                f"camera {camera} has pictures of several sizes: {described}; a lens belongs to "
                f"one size, so remove or separate the others"
            )
    return {camera: next(iter(sizes[camera])) for camera in recording.cameras}


def _file_findings(seen: Mapping[_Key, Seen]) -> tuple[Finding, ...]:
    found: list[Finding] = []
    for (camera, frame), item in seen.items():
        if isinstance(item.found, Unreadable):
            text = f"camera {camera}, frame {frame} is left out: {item.found.reason}."
            found.append(finding("unreadable_frame", text, camera=camera, frame=frame))
    for camera in dict.fromkeys(camera for camera, _ in seen):
        own = {frame: item for (cam, frame), item in seen.items() if cam == camera}
        missed = [frame for frame, item in own.items() if isinstance(item.found, NotFound)]
        if missed:
            reasons = Counter(
                item.found.reason for item in own.values() if isinstance(item.found, NotFound)
            )
            text = (
                f"camera {camera}: no board in {len(missed)} of {len(own)} pictures "
                f"({', '.join(missed[:5])}{', ...' if len(missed) > 5 else ''}): "
                f"{reasons.most_common(1)[0][0]}."
            )
            found.append(finding("no_board_frame", text, camera=camera, frames=missed))
        turned = [frame for frame, item in own.items() if item.rotation_tag > 1]
        if turned:
            text = (
                f"camera {camera}: {len(turned)} pictures carry an EXIF rotation, which is not "
                f"applied; keep it that way for pictures that you correct."
            )
            found.append(finding("rotation_tag_ignored", text, camera=camera, frames=turned))
        scales = [
            item.found.cov_scale for item in own.values() if isinstance(item.found, BoardView)
        ]
        scale = float(np.median(scales)) if scales else 1.0
        if not 1 / _USUAL_COV_SCALE <= scale <= _USUAL_COV_SCALE:
            text = (
                f"camera {camera}: corners differ from a smooth board by {scale**0.5:.1f} times "
                f"what white noise explains (demosaicing, compression, sharpening, or a board that "
                f"is not flat); their stated errors are scaled by that."
            )
            found.append(finding("correlated_noise", text, camera=camera, cov_scale=scale))
    return tuple(found)

"""A recording in, observations out."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.core.findings import Finding, finding
from calichrome.core.units import parse_lengths
from calichrome.detection import detect_board, draw_overlay, no_order_fits, seen_corner_counts
from calichrome.errors import DetectionError, RecordingError, TargetError
from calichrome.imaging import Recording, Unreadable, write_picture
from calichrome.observations import BoardView, Dataset, NotFound
from calichrome.target import Target, check_target, load_target, parse_target, with_square_size

__all__ = ["Detection", "Progress", "detect_recording", "find_target", "silent"]

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many are done, and of how many."""

_WORKERS = 2  # pictures in memory at once; OpenCV already spreads one over the cores
_PROBED = 3  # pictures of a camera that are searched for a board of other corner counts


def silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


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
    """

    dataset: Dataset
    rejected: tuple[tuple[str, str, str], ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    found: BoardView | NotFound | Unreadable
    size_wh: tuple[int, int] | None = None
    sha256: str = ""
    exposure: Mapping[str, float] | None = None
    rotation_tag: int = 1


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
    progress: Progress = silent,
) -> Detection:
    """Look for the board in every picture.

    Parameters
    ----------
    recording, target
        What to look at and for.
    overlay
        Folder for pictures with the detections drawn in, ``<camera>/<frame>.jpg``.
    progress
        Called after each picture.

    Raises
    ------
    RecordingError
        If a camera has pictures of several sizes, or none that can be read.
    """

    def look(camera: str, frame: str) -> _Seen:
        image = recording.read(camera, frame)
        if isinstance(image, Unreadable):
            return _Seen(image)
        found = detect_board(image, target)
        if overlay is not None:
            drawn = draw_overlay(image, target, found)
            write_picture(overlay / camera / f"{frame}.jpg", drawn, jpeg_quality=90, force=True)
        return _Seen(found, image.size_wh, image.sha256, image.exposure, image.rotation_tag)

    keys = [(camera, frame) for camera in recording.cameras for frame in recording.files[camera]]
    seen: dict[tuple[str, str], _Seen] = {}
    with ThreadPoolExecutor(_WORKERS) as pool:
        progress("looking for the board", 0, len(keys))
        for key, result in zip(keys, pool.map(lambda key: look(*key), keys), strict=True):
            seen[key] = result
            progress("looking for the board", len(seen), len(keys))
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
    )


def require_boards(detection: Detection, recording: Recording, target: Target) -> None:
    """Raise `DetectionError` when a camera sees no board at all, with the likeliest reason."""
    for camera, views in detection.dataset.views.items():
        if views:
            continue
        frames = list(recording.files[camera])
        reasons = Counter(reason for cam, _, reason in detection.rejected if cam == camera)
        likeliest = reasons.most_common(1)[0][0]
        other = None
        if likeliest != no_order_fits(target):  # else the counts are right
            other = _other_board(recording, camera, frames[:_PROBED], target)
        if other is not None:
            frame, counts = other
            wanted = f"{target.corners_xy[0]}x{target.corners_xy[1]}"
            raise DetectionError(
                f"camera {camera}: picture {frame} shows a board of {counts[0]}x{counts[1]} inner "
                f"corners, the target has {wanted}; correct --target"
            )
        remedy = "leave it out with --cameras, or record it again"
        if len(detection.dataset.views) == 1:
            remedy = "look at the pictures, and check --target"
        raise DetectionError(
            f"camera {camera}: the board is in none of its {len(frames)} pictures (most often: "
            f"{likeliest}); {remedy}"
        )


def _other_board(
    recording: Recording, camera: str, frames: list[str], target: Target
) -> tuple[str, tuple[int, int]] | None:
    """Find a board of other corner counts that pictures agree on: one alone may show it cut."""
    seen: dict[tuple[int, int], list[str]] = defaultdict(list)
    for frame in frames:
        image = recording.read(camera, frame)
        if isinstance(image, Unreadable):
            continue
        counts = seen_corner_counts(np.rint(np.clip(image.grey(), 0, 255)).astype(np.uint8))
        if counts is not None and sorted(counts) != sorted(target.corners_xy):
            seen[counts].append(frame)
    counts, agreeing = max(seen.items(), key=lambda item: len(item[1]), default=((0, 0), []))
    if not agreeing or (len(agreeing) == 1 and len(frames) > 1):
        return None
    return agreeing[0], counts


def _sizes(
    recording: Recording, seen: Mapping[tuple[str, str], _Seen]
) -> dict[str, tuple[int, int]]:
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


def _file_findings(seen: Mapping[tuple[str, str], _Seen]) -> tuple[Finding, ...]:
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
    return tuple(found)

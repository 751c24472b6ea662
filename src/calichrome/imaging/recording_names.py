"""Names of files read as cameras and frames: by a pattern, or by a layout that is recognised."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from calichrome.errors import RecordingError
from calichrome.imaging.pattern import NamePattern

__all__ = ["Files", "most_shared", "natural_order", "read_names"]

Files = dict[str, dict[str, Path]]
"""camera -> frame -> file."""


def read_names(folder: Path, paths: Sequence[Path], pattern: str | None) -> tuple[Files, str]:
    """Read names of pictures as cameras and frames; say how.

    Parameters
    ----------
    folder
        The folder that the names are relative to.
    paths
        Pictures below it; they need not exist.
    pattern
        See `NamePattern`; None: the layout is recognised.

    Raises
    ------
    RecordingError
        If no name matches, or several readings are possible.
    """
    if pattern is None:
        return _read_layout(folder, paths)
    files = _read_by_pattern(folder, paths, NamePattern.compile(pattern))
    if not files:
        raise RecordingError(
            f"{folder}: none of {len(paths)} pictures matches --pattern {pattern}; names look like "
            f"{_stem(folder, paths[0])}"
        )
    return files, f"read by the pattern {pattern}"


def natural_order(name: str) -> list[tuple[bool, int, str]]:
    """Sort key by which frame 9 comes before frame 10."""
    parts = re.findall(r"\d{1,18}|\D+", name)
    return [(not part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]


def _stem(folder: Path, path: Path) -> str:
    return path.relative_to(folder).with_suffix("").as_posix()


def _insert(files: Files, camera: str, frame: str, path: Path) -> None:
    frames = files.setdefault(camera, {})
    if frame in frames:
        raise RecordingError(
            f"{frames[frame]} and {path} are both frame {frame} of camera {camera}; remove one, or "
            f"tell them apart with --pattern"
        )
    frames[frame] = path


def _read_by_pattern(folder: Path, paths: Iterable[Path], pattern: NamePattern) -> Files:
    files: Files = {}
    for path in paths:
        found = pattern.match(_stem(folder, path))
        if found is not None:
            _insert(files, *found, path)
    return files


def _read_layout(folder: Path, paths: Sequence[Path]) -> tuple[Files, str]:
    """Recognise ``<camera>/<frame>`` or a flat folder; refuse what can be read in two ways."""
    flat = [path for path in paths if path.parent == folder]
    nested = [path for path in paths if path.parent.parent == folder]
    if flat and nested:
        raise RecordingError(
            f"{folder}: holds pictures ({len(flat)}) and folders of pictures ({len(nested)}); say "
            f'which with --pattern "{{frame}}" or --pattern "{{camera}}/{{frame}}"'
        )
    if flat:
        return _read_flat(folder, flat)
    files: Files = {}
    for path in nested:
        _insert(files, path.parent.name, path.stem, path)
    if not files:
        raise RecordingError(
            f"{folder}: its pictures lie deeper than <camera>/<frame>; say how their names are "
            f'built with --pattern, like "{_stem(folder, paths[0])}" with fields'
        )
    return _drop_camera_from_frames(files)


def _read_flat(folder: Path, paths: Sequence[Path]) -> tuple[Files, str]:
    one_camera = {"cam0": {path.stem: path for path in paths}}
    several = _camera_in_name(paths)
    if several is None:
        return one_camera, "a flat folder: one camera, cam0"
    pattern, names = several
    raise RecordingError(
        f"{folder}: can be read as one camera with {len(paths)} frames (--pattern "
        f'"{{frame}}") or as cameras {", ".join(names)} (--pattern "{pattern}"); say which'
    )


def _camera_in_name(paths: Sequence[Path]) -> tuple[str, list[str]] | None:
    """Whether names hold a camera, like left01 or frame_01_left; the pattern and the cameras.

    Cameras have letters in their names, at least two pictures, and share more than one frame:
    dates and times do not.
    """
    readings = (
        (r"(?P<camera>.*?\D)(?P<frame>\d+)", "{{camera:{0}}}{{frame}}"),
        (r"(?P<frame>.*\d)(?P<camera>\D+)", "{{frame}}{{camera:{0}}}"),
    )
    for expression, text in readings:
        frames = defaultdict(set)
        for path in paths:
            found = re.fullmatch(expression, path.stem)
            if found is not None and re.search(r"[^\W\d_]", found["camera"]):
                frames[found["camera"]].add(found["frame"])
        cameras = sorted(camera for camera, own in frames.items() if len(own) > 1)
        shared = Counter(frame for camera in cameras for frame in frames[camera])
        if len(cameras) > 1 and sum(count > 1 for count in shared.values()) > 1:
            return text.format("|".join(cameras)), cameras
    return None


def _drop_camera_from_frames(files: Files) -> tuple[Files, str]:
    """Read ``left/left01`` beside ``right/right01`` as frame 01, if only that gives pairs."""
    plain = f"folders are cameras: {', '.join(sorted(files))}"
    if len(files) < 2 or most_shared(files) > 1:
        return files, plain
    shorter: Files = {}
    for camera, frames in files.items():
        for frame, path in frames.items():
            _insert(shorter, camera, frame.replace(camera, "", 1).strip("_-. ") or frame, path)
    if most_shared(shorter) > 1:
        return shorter, f"{plain}; the camera's name is taken out of the frame's"
    return files, plain


def most_shared(files: Files) -> int:
    """Return how many cameras the most common frame has."""
    return max(Counter(frame for frames in files.values() for frame in frames).values(), default=0)

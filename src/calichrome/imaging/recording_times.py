"""timestamps.csv: when frames of videos were taken, and which of them are one instant."""

import csv
import math
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calichrome.errors import RecordingError

__all__ = [
    "FrameTable",
    "copy_timestamps",
    "plain_frames",
    "read_picture_times",
    "read_timestamps",
]

_OURS = ("camera", "frame", "time_s")
_CALISCOPE = ("sync_index", "cam_id", "frame_index", "frame_time")
_MAX_BYTES = 200_000_000
Row = Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTable:
    """The frames of videos by name.

    Parameters
    ----------
    numbers
        camera id -> frame id -> number of the frame in the video, from 0.
    times_s
        camera id -> frame id -> seconds, where timestamps.csv says it.
    reading
        How the file was understood, in words.
    """

    numbers: Mapping[str, Mapping[str, int]]
    times_s: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    reading: str = ""


def plain_frames(n_frames: Mapping[str, int]) -> FrameTable:
    """Name frames by their numbers: equal numbers are one instant."""
    numbers = {
        camera: {str(index): index for index in range(count)} for camera, count in n_frames.items()
    }
    return FrameTable(numbers=numbers)


def read_timestamps(
    path: Path, n_frames: Mapping[str, int], *, others: Collection[str] = ()
) -> FrameTable:
    """Read timestamps.csv beside videos.

    Parameters
    ----------
    path
        Either the columns camera, frame, time_s, where the frame is the number in the video; or
        caliscope's sync_index, cam_id, frame_index, frame_time, where the n-th row of a camera is
        the n-th frame of its video and equal sync_index is one instant.
    n_frames
        camera id -> number of frames of its video.
    others
        Cameras of the recording that are not asked for; their rows are left out.

    Raises
    ------
    RecordingError
        If the columns are others, or a row does not fit the videos.
    """
    columns, rows = _read(path)
    if set(_CALISCOPE) <= set(columns):
        return _from_caliscope(path, rows, n_frames)
    if set(_OURS) <= set(columns):
        asked = [(line, row) for line, row in rows if row["camera"] not in others]
        return _from_ours(path, asked, n_frames)
    raise _other_columns(path, columns)


def read_picture_times(
    path: Path, frames: Mapping[str, Collection[str]]
) -> dict[str, dict[str, float]]:
    """Read the times of pictures: camera id -> frame id -> seconds.

    Parameters
    ----------
    path
        Columns camera, frame, time_s; rows of other frames, like those of the empty scene, are left
        out. A missing file says nothing.
    frames
        camera id -> its frame ids.

    Raises
    ------
    RecordingError
        If the columns are others, or a time is no number.
    """
    if not path.is_file():
        return {}
    columns, rows = _read(path)
    if not set(_OURS) <= set(columns):
        raise RecordingError(
            f"{path}: has the columns {', '.join(columns) or '(none)'}; wanted are "
            f"{', '.join(_OURS)}"
        )
    times: dict[str, dict[str, float]] = defaultdict(dict)
    for line, row in rows:
        if row["frame"] in frames.get(row["camera"], ()):
            times[row["camera"]][row["frame"]] = _number(path, line, row, "time_s")
    return dict(times)


def copy_timestamps(path: Path, output: Path, names: Mapping[str, str]) -> None:
    """Write the rows of some cameras under new names.

    Parameters
    ----------
    path, output
        timestamps.csv of a recording, and of what is made of it.
    names
        Camera id in the recording -> in the output. Rows of other cameras are left out.

    Raises
    ------
    RecordingError
        If the file cannot be read, or the columns are others.
    """
    columns, rows = _read(path)
    if not {_OURS[0], _CALISCOPE[1]} & set(columns):
        raise _other_columns(path, columns)
    column = _OURS[0] if _OURS[0] in columns else _CALISCOPE[1]
    if column == _CALISCOPE[1]:
        cam_ids = _cameras_of({row[column] for _, row in rows}, tuple(names), path)
        names = {cam_id: names[camera] for cam_id, camera in cam_ids.items()}
    with output.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {**row, column: names[row[column]]} for _, row in rows if row[column] in names
        )


def _other_columns(path: Path, columns: Sequence[str]) -> RecordingError:
    return RecordingError(
        f"{path}: has the columns {', '.join(columns) or '(none)'}; wanted are {', '.join(_OURS)}, "
        f"or caliscope's {', '.join(_CALISCOPE)}"
    )


def _read(path: Path) -> tuple[Sequence[str], list[tuple[int, Row]]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RecordingError(f"{path}: is larger than 200 MB, which no such file is")
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, skipinitialspace=True)
            columns = [(name or "").strip() for name in reader.fieldnames or ()]
            reader.fieldnames = columns
            rows: list[tuple[int, Row]] = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read as CSV ({error}); repair it") from error
    for line, row in rows:
        if None in row or None in row.values():
            raise RecordingError(f"{path}, line {line}: wrong number of cells; repair it")
    return columns, rows


def _from_ours(
    path: Path, rows: Sequence[tuple[int, Row]], n_frames: Mapping[str, int]
) -> FrameTable:
    times: dict[str, dict[str, float]] = defaultdict(dict)
    for line, row in rows:
        camera, number = row["camera"], _number(path, line, row, "frame")
        if camera not in n_frames:
            raise RecordingError(
                f"{path}, line {line}: there is no video of camera {camera}; there are "
                f"{', '.join(n_frames)}"
            )
        if not (number.is_integer() and 0 <= number < n_frames[camera]):
            raise RecordingError(
                f"{path}, line {line}: the video of camera {camera} has the frames 0 to "
                f"{n_frames[camera] - 1}, not {row['frame']}; correct it"
            )
        frame = str(int(number))
        if frame in times[camera]:
            raise RecordingError(f"{path}, line {line}: frame {frame} of {camera} stands twice")
        times[camera][frame] = _number(path, line, row, "time_s")
    table = plain_frames(n_frames)
    return FrameTable(numbers=table.numbers, times_s=dict(times), reading="times: timestamps.csv")


def _from_caliscope(
    path: Path, rows: Sequence[tuple[int, Row]], n_frames: Mapping[str, int]
) -> FrameTable:
    cameras = _cameras_of({row["cam_id"] for _, row in rows}, tuple(n_frames), path)
    numbers: dict[str, dict[str, int]] = {camera: {} for camera in n_frames}
    times: dict[str, dict[str, float]] = {camera: {} for camera in n_frames}
    n_rows = dict.fromkeys(n_frames, 0)
    for line, row in rows:
        camera = cameras.get(row["cam_id"])
        if camera is None:
            continue
        sync = _number(path, line, row, "sync_index")
        frame = str(int(sync)) if sync.is_integer() else row["sync_index"]
        if frame in times[camera]:
            raise RecordingError(
                f"{path}, line {line}: sync_index {frame} of cam_id {row['cam_id']} stands twice"
            )
        times[camera][frame] = _number(path, line, row, "frame_time")
        if n_rows[camera] < n_frames[camera]:
            numbers[camera][frame] = n_rows[camera]
        n_rows[camera] += 1
    unequal = [
        f"{camera} has {n_frames[camera]} frames and {n_rows[camera]} rows"
        for camera in n_frames
        if n_frames[camera] != n_rows[camera]
    ]
    doubt = f"; {', '.join(unequal)}, the rest is not used" if unequal else ""
    return FrameTable(
        numbers=numbers,
        times_s=times,
        reading=f"caliscope's timestamps.csv: frames are named by sync_index{doubt}",
    )


def _cameras_of(cam_ids: set[str], cameras: Sequence[str], path: Path) -> dict[str, str]:
    """Take caliscope's numbers to videos: 0 is cam_0.mp4, port_0.mp4 or 0.mp4.

    Rows of cameras without a video are left out; a video without rows is not.
    """
    found: dict[str, str] = {}
    for camera in cameras:
        digits = re.search(r"\d+$", camera)
        named = {cam_id for cam_id in cam_ids
                 if cam_id == camera or (digits and _same_number(cam_id, digits[0]))}  # fmt: skip
        taken = named & set(found)
        if len(named) != 1 or taken:
            known = ", ".join(sorted(cam_ids)[:20])
            raise RecordingError(
                f"{path}: it is not clear which cam_id ({known}) is the video {camera}; name the "
                f"videos cam_0, cam_1 and so on, by their cam_id"
            )
        found[named.pop()] = camera
    return found


def _same_number(first: str, second: str) -> bool:
    return first.strip().isdecimal() and int(first) == int(second)


def _number(path: Path, line: int, row: Row, column: str) -> float:
    try:
        number = float(row[column])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise RecordingError(f"{path}, line {line}: {column} {row[column]!r} is no number")
    return number

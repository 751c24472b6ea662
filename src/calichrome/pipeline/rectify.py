"""The pictures or videos of two cameras, rectified."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.apply import OutputSpace, rectified_sheet, rectifying_map
from calichrome.colorimetry.icc_profile import icc_profile
from calichrome.core.files import check_folder, check_output, writing_folder
from calichrome.errors import OutputError, RecordingError
from calichrome.geometry.rectification import Rectification
from calichrome.geometry.rectified_area import Framing
from calichrome.imaging import (
    PICTURE_SUFFIXES,
    Pixels,
    Recording,
    Unreadable,
    VideoSettings,
    copy_timestamps,
    open_recording,
    read_frame,
    write_picture,
)
from calichrome.pipeline.correct_video import (
    VideoOutcome,
    check_complete,
    correct_videos,
    video_job,
)
from calichrome.pipeline.correctors import CameraCorrectors, read_picture
from calichrome.pipeline.detect import Progress, silent
from calichrome.pipeline.rectified_pair import rectified_pair
from calichrome.rig import Camera, Rig

__all__ = ["Rectified", "rectify"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectified:
    """How a pair was rectified, and what became of each of its videos."""

    rectification: Rectification
    videos: Mapping[str, VideoOutcome]


def rectify(  # noqa: PLR0913 (the options of a command)
    rig: Rig,
    pair: tuple[str, str],
    source: Path,
    output: Path,
    *,
    pattern: str | None = None,
    space: OutputSpace = "srgb",
    framing: Framing | None = None,
    sheet: Path | None = None,
    settings: VideoSettings | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Rectified:
    """Rectify the pictures or videos of two cameras and write rectification.json beside them.

    Parameters
    ----------
    rig, source, output, pattern, space, settings, force, progress
        As in `correct`; a rig without colour uses "none".
    pair
        The two cameras, in the order wanted.
    framing
        Which part of the pictures is shown; None: all of both.
    sheet
        Also write the first common frame side by side, with lines along which points correspond.

    Raises
    ------
    CalichromeError
        If something cannot be read, rectified or written; nothing is written then.
    InterruptedOutputError
        On Ctrl-C while a video is written: what is done is kept.
    """
    if space == "xyz-d65":
        raise RecordingError("rectify writes PNG, which holds no XYZ; use --colour linear-srgb")
    check_folder(output, force=force, inputs=[source])
    if sheet is not None:
        check_output(sheet, force=force)
        if sheet.suffix.lower() not in PICTURE_SUFFIXES:
            raise OutputError(f"{sheet}: --sheet wants the name of a picture, like rectified.png")
    rectification = rectified_pair(rig, pair, framing)
    cameras = {name: rig.cameras[name] for name in pair}
    spaces = {name: space if cameras[name].colour is not None else "none" for name in pair}
    correctors = {
        name: CameraCorrectors(
            name,
            cameras[name],
            spaces[name],
            rectifying_map(
                cameras[name].lens, half.rect_from_cam, half.matrix, rectification.size_wh
            ),
        )
        for name, half in zip(pair, (rectification.a, rectification.b), strict=True)
    }
    recording = open_recording(source, pattern=pattern, cameras=pair)
    jobs = {
        name: video_job(
            video,
            correctors[name],
            spaces[name],
            keeps_pixel_shape=False,
            settings=settings,
        )
        for name, video in recording.videos.videos.items()
    }
    frames = [frame for frame in recording.files[pair[0]] if frame in recording.files[pair[1]]]
    stale = ["timestamps.csv", *(f"{name}.partial.mp4" for name in jobs)]
    with writing_folder(output, force=force, inputs=[source], stale=stale) as folder:
        if (recording.folder / "timestamps.csv").is_file():
            names = {name: name for name in pair}
            copy_timestamps(recording.folder / "timestamps.csv", folder / "timestamps.csv", names)
        text = json.dumps(_rectification_json(rectification, pair), indent=1)
        (folder / "rectification.json").write_text(text + "\n", encoding="utf-8")
        for done, frame in enumerate(() if jobs else frames):
            for name in pair:
                picture = _rectified(recording, cameras[name], correctors[name], name, frame)
                write_picture(
                    folder / name / f"{frame}.png",
                    _for_png(picture),
                    profile=icc_profile(spaces[name]),
                )
            progress("rectifying", done + 1, len(frames))
        if sheet is not None:
            first, second = (
                (
                    f"{name}, frame {frames[0]}",
                    _rgb8(_rectified(recording, cameras[name], correctors[name], name, frames[0])),
                )
                for name in pair
            )
            drawn = rectified_sheet(first, second, vertical=rectification.vertical)
            inside = sheet.resolve().is_relative_to(output.resolve())
            place = folder / sheet.resolve().relative_to(output.resolve()) if inside else sheet
            write_picture(place, drawn, force=force)
        outcomes = correct_videos(jobs, folder, "rectifying", progress)
    check_complete(outcomes, jobs, output)
    return Rectified(rectification=rectification, videos=outcomes)


def _rectified(
    recording: Recording, camera: Camera, correctors: CameraCorrectors, name: str, frame: str
) -> Pixels:
    path = recording.files[name][frame]
    video = recording.videos.videos.get(name)
    image = (
        read_picture(camera, path, recording.entry(name).bits)
        if video is None
        else read_frame(video, recording.videos.table.numbers[name][frame])
    )
    if isinstance(image, Unreadable):
        raise RecordingError(f"{path}: {image.reason}; remove the frame")
    return correctors.apply(image, path)


def _for_png(picture: Pixels) -> Pixels:
    if picture.dtype == np.float32:
        picture = np.rint(np.clip(picture, 0, 1) * 65535).astype(np.uint16)
    return picture


def _rgb8(picture: Pixels) -> Pixels:
    picture = _for_png(picture)
    if picture.dtype == np.uint16:
        picture = (picture // 257).astype(np.uint8)
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def _rectification_json(item: Rectification, pair: tuple[str, str]) -> dict[str, object]:
    return {
        "format": "calichrome.rectification",
        "format_version": 1,
        "cameras": list(pair),
        "size_wh": list(item.size_wh),
        "vertical": item.vertical,
        "R1": item.a.rect_from_cam.tolist(),
        "R2": item.b.rect_from_cam.tolist(),
        "P1": item.a.projection.tolist(),
        "P2": item.b.projection.tolist(),
        "Q": item.disparity_to_depth.tolist(),
    }

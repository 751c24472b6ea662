"""Whole recordings corrected: pictures and videos."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.apply import Kernel, OutputSpace
from calichrome.colorimetry.icc_profile import icc_profile
from calichrome.core.files import check_folder, writing_folder
from calichrome.errors import RecordingError
from calichrome.geometry.undistortion import Pinhole
from calichrome.imaging import Pixels, Unreadable, VideoSettings, copy_timestamps, write_picture
from calichrome.pipeline.correct_inputs import Picture, correct_inputs
from calichrome.pipeline.correct_video import (
    VideoOutcome,
    check_complete,
    correct_videos,
    video_job,
)
from calichrome.pipeline.correctors import CameraCorrectors, read_picture
from calichrome.pipeline.detect import Progress, silent
from calichrome.pipeline.new_view import NewView, cameras_json, new_pinhole, source_map_of
from calichrome.rig import Rig

__all__ = ["Corrected", "correct"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """What was corrected.

    Parameters
    ----------
    written
        Pictures and videos.
    skipped
        Pictures that could not be read, and why.
    videos
        What became of each video, by camera.
    kernel
        Which code ran: "native", or "opencv" where the C kernels are not installed.
    """

    written: tuple[Path, ...]
    skipped: tuple[tuple[Path, str], ...]
    videos: Mapping[str, VideoOutcome]
    kernel: Kernel


def correct(
    rig: Rig,
    source: Path,
    output: Path,
    *,
    camera: str | None = None,
    pattern: str | None = None,
    space: OutputSpace = "srgb",
    view: NewView | None = None,
    settings: VideoSettings | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Corrected:
    """Correct a file, a folder or a recording.

    Parameters
    ----------
    rig
        The calibration.
    source
        A picture or video (with `camera`), or a recording whose cameras are those of the rig.
    output
        Folder for ``<camera>/<frame>.<ext>`` (8 bit gives PNG, JPEG gives JPEG, 16 bit TIFF) and
        ``<camera>.mp4``; cameras.json if the geometry changes, timestamps.csv if the recording has
        one. Frames of the empty scene (``background...``) are left out.
    camera
        Which camera took a single file or a flat folder.
    pattern
        As for `calibrate`.
    space
        Output colour space; "none" leaves the colours.
    view
        What the pictures show; None: what the recorded ones do.
    settings
        How videos are encoded.
    force
        Write into an existing `output`: what is written again is replaced, the rest stays.
    progress
        Called after each picture or frame.

    Raises
    ------
    CalichromeError
        If something cannot be read, corrected or written; nothing is written then.
    InterruptedOutputError
        On Ctrl-C while a video is written: what is done is kept.
    """
    check_folder(output, force=force, inputs=[source])
    inputs = correct_inputs(rig, source, camera, pattern)
    view = view or NewView()
    pinholes: dict[str, Pinhole] = {}
    correctors: dict[str, CameraCorrectors] = {}
    for name in inputs.cameras:
        pinhole = new_pinhole(view, rig, name)
        source_map = source_map_of(rig.cameras[name].lens, pinhole)
        correctors[name] = CameraCorrectors(name, rig.cameras[name], space, source_map)
        if pinhole is not None:
            pinholes[name] = pinhole
    jobs = {
        name: video_job(
            video,
            correctors[name],
            space,
            keeps_pixel_shape=view.keeps_pixel_shape,
            settings=settings,
        )
        for name, video in inputs.videos.items()
    }
    stale = [f"{name}.partial.mp4" for name in jobs]
    others = (name for name in rig.cameras if name not in inputs.cameras)
    if not any((output / item).exists() for name in others for item in (name, f"{name}.mp4")):
        stale += ["cameras.json", "timestamps.csv"]  # of other cameras they would still be true
    with writing_folder(output, force=force, inputs=[source], stale=stale) as folder:
        if inputs.timestamps is not None:
            copy_timestamps(inputs.timestamps, folder / "timestamps.csv", inputs.names)
        paths, skipped = _correct_pictures(
            rig, inputs.pictures, correctors, space, folder, progress
        )
        if pinholes:
            (folder / "cameras.json").write_text(cameras_json(pinholes), encoding="utf-8")
        outcomes = correct_videos(jobs, folder, "correcting", progress)
    check_complete(outcomes, jobs, output)
    names = [path.relative_to(folder) for path in paths]
    names += [Path(outcome.name) for outcome in outcomes.values()]
    written = tuple(output / name for name in names)
    kernel = next(own.kernel for own in correctors.values() if own.kernel is not None)
    return Corrected(written=written, skipped=tuple(skipped), videos=outcomes, kernel=kernel)


def _correct_pictures(
    rig: Rig,
    pictures: Sequence[Picture],
    correctors: Mapping[str, CameraCorrectors],
    space: OutputSpace,
    folder: Path,
    progress: Progress,
) -> tuple[list[Path], list[tuple[Path, str]]]:
    """Return the files written and those that could not be read, with the reason."""
    written: list[Path] = []
    skipped: list[tuple[Path, str]] = []
    for done, picture in enumerate(pictures):
        progress("correcting", done, len(pictures))
        name, path = picture.camera, picture.path
        image = read_picture(rig.cameras[name], path, picture.bits)
        if isinstance(image, Unreadable):
            skipped.append((path, image.reason))
            continue
        corrected = correctors[name].apply(image, path)
        written.append(folder / name / f"{picture.frame}{_suffix(path, corrected)}")
        write_picture(written[-1], corrected, profile=icc_profile(space))
    if pictures:
        progress("correcting", len(pictures), len(pictures))
    if skipped and not written:
        raise RecordingError(f"{skipped[0][0]}: {skipped[0][1]}; nothing was corrected")
    return written, skipped


def _suffix(path: Path, corrected: Pixels) -> str:
    if corrected.dtype != np.uint8:
        return ".tif"
    return ".jpg" if path.suffix.lower() in (".jpg", ".jpeg") else ".png"

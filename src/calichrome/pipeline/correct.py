"""Whole recordings corrected or rectified."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.apply import (
    Corrector,
    OutputSpace,
    SourceMap,
    rectified_sheet,
    rectifying_map,
    undistorting_map,
)
from calichrome.colorimetry.encoding import ToneCurve
from calichrome.core.files import check_folder, check_output, writing_folder
from calichrome.errors import CalichromeError, OutputError, RecordingError, SolveError
from calichrome.geometry.rectification import Rectification, rectify_pair
from calichrome.geometry.rectified_area import Framing
from calichrome.imaging import (
    PICTURE_SUFFIXES,
    Image,
    Pixels,
    Recording,
    Unreadable,
    open_recording,
    read_image,
    write_picture,
)
from calichrome.pipeline.detect import Progress, silent
from calichrome.rig import Camera, Rig

__all__ = ["correct", "rectify"]

_PICTURES = f"a picture ({', '.join(PICTURE_SUFFIXES)})"


@dataclass(frozen=True, slots=True)
class _Picture:
    """One picture to correct; `bits` as recording.toml says, else None."""

    camera: str
    frame: str
    path: Path
    bits: int | None = None


def correct(
    rig: Rig,
    source: Path,
    output: Path,
    *,
    camera: str | None = None,
    pattern: str | None = None,
    space: OutputSpace = "srgb",
    undistort: bool = False,
    force: bool = False,
    progress: Progress = silent,
) -> tuple[list[Path], list[tuple[Path, str]]]:
    """Correct a file, a folder or a recording.

    Parameters
    ----------
    rig
        The calibration.
    source
        A picture (with `camera`), or a recording whose cameras are those of the rig.
    output
        Folder for ``<camera>/<frame>.<ext>``: 8 bit gives PNG, JPEG gives JPEG, 16 bit TIFF.
    camera
        Which camera took a single picture or a flat folder.
    pattern
        As for `calibrate`.
    space
        Output colour space; "none" leaves the colours.
    undistort
        Remove lens distortion, keeping size and K.
    force
        Replace `output`.
    progress
        Called after each picture.

    Returns
    -------
    written : list of Path
    skipped : list of (Path, str)
        Files that could not be read, and why.
    """
    check_folder(output, force=force, inputs=[source])
    pictures = list(_pictures(rig, source, camera, pattern))
    correctors = {}
    for name in dict.fromkeys(picture.camera for picture in pictures):
        entry = rig.cameras[name]
        source_map = undistorting_map(entry.lens, entry.size_wh) if undistort else None
        correctors[name] = _named(name, entry, space, source_map)
    written: list[Path] = []
    skipped: list[tuple[Path, str]] = []
    with writing_folder(output, force=force, inputs=[source]) as folder:
        for done, picture in enumerate(pictures):
            progress("correcting", done, len(pictures))
            name, path = picture.camera, picture.path
            image = _read(rig.cameras[name], path, picture.bits)
            if isinstance(image, Unreadable):
                skipped.append((path, image.reason))
                continue
            corrected = _apply(correctors[name], image, path)
            place = Path(name) / f"{picture.frame}{_suffix(path, corrected)}"
            write_picture(folder / place, corrected)
            written.append(output / place)
        progress("correcting", len(pictures), len(pictures))
        if not written:
            raise RecordingError(f"{skipped[0][0]}: {skipped[0][1]}; nothing was corrected")
    return written, skipped


def rectify(
    rig: Rig,
    pair: tuple[str, str],
    source: Path,
    output: Path,
    *,
    pattern: str | None = None,
    space: OutputSpace = "srgb",
    framing: Framing | None = None,
    sheet: Path | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Rectification:
    """Rectify the pictures of two cameras and write rectification.json beside them.

    Parameters
    ----------
    rig, source, output, pattern, space, force, progress
        As in `correct`; a rig without colour uses "none".
    pair
        The two cameras, in the order wanted.
    framing
        Which part of the pictures is shown; None: all of both.
    sheet
        Also write the first common frame side by side, with lines along which points correspond.

    Returns
    -------
    Rectification
        As written.
    """
    _check_pair(rig, pair)
    if space == "xyz-d65":
        raise RecordingError("rectify writes PNG, which holds no XYZ; use --colour linear-srgb")
    check_folder(output, force=force, inputs=[source])
    if sheet is not None:
        check_output(sheet, force=force)
        if sheet.suffix.lower() not in PICTURE_SUFFIXES:
            raise OutputError(f"{sheet}: --sheet wants the name of a picture, like rectified.png")
    cameras = {name: rig.cameras[name] for name in pair}
    a, b = (cameras[name] for name in pair)
    b_from_a = b.cam_from_ref @ a.cam_from_ref.inverse()
    try:
        rectification = rectify_pair(
            a.lens, b.lens, b_from_a, a.size_wh, b.size_wh, framing or Framing()
        )
    except SolveError as error:
        raise SolveError(f"{pair[0]} and {pair[1]}: {error}") from error
    correctors = {
        name: _named(
            name,
            camera,
            space if camera.colour is not None else "none",
            rectifying_map(
                camera.lens,
                half.rect_from_cam,
                half.matrix,
                rectification.size_wh,
            ),
        )
        for (name, camera), half in zip(
            cameras.items(), (rectification.a, rectification.b), strict=True
        )
    }
    recording = open_recording(source, pattern=pattern, cameras=pair)
    _refuse_videos(recording)
    frames = [frame for frame in recording.files[pair[0]] if frame in recording.files[pair[1]]]
    shown: list[tuple[str, Pixels]] = []
    with writing_folder(output, force=force, inputs=[source]) as folder:
        for done, frame in enumerate(frames):
            progress("rectifying", done, len(frames))
            for name in pair:
                path = recording.files[name][frame]
                image = _read(cameras[name], path, recording.entry(name).bits)
                if isinstance(image, Unreadable):
                    raise RecordingError(f"{path}: {image.reason}; remove the frame")
                picture = _apply(correctors[name], image, path)
                write_picture(folder / name / f"{frame}.png", _for_png(picture))
                if len(shown) < 2:
                    shown.append((f"{name}, frame {frame}", picture))
        progress("rectifying", len(frames), len(frames))
        text = json.dumps(_rectification_json(rectification, pair), indent=1)
        (folder / "rectification.json").write_text(text + "\n", encoding="utf-8")
        if sheet is not None:
            first, second = ((name, _rgb8(picture)) for name, picture in shown)
            drawn = rectified_sheet(first, second, vertical=rectification.vertical)
            inside = sheet.resolve().is_relative_to(output.resolve())
            place = folder / sheet.resolve().relative_to(output.resolve()) if inside else sheet
            write_picture(place, drawn, force=force)
    return rectification


def _refuse_videos(recording: Recording) -> None:
    if recording.videos.videos:
        raise RecordingError(
            f"{recording.folder}: holds videos, and pictures are corrected; extract their frames "
            f"as PNG"
        )


def _check_pair(rig: Rig, pair: tuple[str, str]) -> None:
    for name in pair:
        if name not in rig.cameras:
            raise RecordingError(f"the rig has no camera {name}; it has {', '.join(rig.cameras)}")
    if pair[0] == pair[1]:
        raise RecordingError(f"--pair {pair[0]},{pair[1]} names one camera twice; name two")


def _named(
    name: str, camera: Camera, space: OutputSpace, source_map: SourceMap | None
) -> Corrector:
    if name == ".." or Path(name).name != name:  # it becomes a folder, and must stay inside OUT
        raise RecordingError(f"camera {name!r} is no name for a folder; rename it in rig.json")
    try:
        return Corrector(camera, space, source_map)
    except CalichromeError as error:
        raise CalichromeError(f"camera {name}: {error}") from error


def _apply(corrector: Corrector, image: Image, path: Path) -> Pixels:
    try:
        return corrector.apply(image)
    except CalichromeError as error:
        raise CalichromeError(f"{path}: {error}") from error


def _read(camera: Camera, path: Path, bits: int | None) -> Image | Unreadable:
    colour = camera.colour
    return read_image(
        path,
        # a curve of its own is removed by the corrector
        encoding=None
        if colour is None or isinstance(colour.encoding, ToneCurve)
        else colour.encoding,
        bits=bits or (None if colour is None else colour.bits),
    )


def _pictures(
    rig: Rig, source: Path, camera: str | None, pattern: str | None
) -> Iterator[_Picture]:
    if camera is not None and camera not in rig.cameras:
        raise RecordingError(f"the rig has no camera {camera}; it has {', '.join(rig.cameras)}")
    if source.is_file():
        if source.suffix.lower() not in PICTURE_SUFFIXES:
            raise RecordingError(f"{source}: is not {_PICTURES}; give one, or a folder of them")
        yield _Picture(camera or _only_camera(rig, source), source.stem, source)
        return
    recording, files = _open(rig, source, camera, pattern)
    for name, frames in files.items():
        if name not in rig.cameras:
            raise RecordingError(
                f"{source}: camera {name} is not in the rig ({', '.join(rig.cameras)}); rename its "
                f"folder, or say with --camera which one it is"
            )
        for frame, path in frames.items():
            yield _Picture(name, frame, path, recording.entry(name).bits)


def _open(
    rig: Rig, source: Path, camera: str | None, pattern: str | None
) -> tuple[Recording, Mapping[str, Mapping[str, Path]]]:
    if camera is not None and pattern is None:
        recording = open_recording(source, pattern="{frame}")
        return recording, {camera: recording.files["cam0"]}
    recording = open_recording(source, pattern=pattern, synchronous=False)
    _refuse_videos(recording)
    if recording.cameras == ("cam0",) and "cam0" not in rig.cameras:
        return recording, {camera or _only_camera(rig, source): recording.files["cam0"]}
    return recording, recording.files


def _only_camera(rig: Rig, source: Path) -> str:
    if len(rig.cameras) > 1:
        raise RecordingError(
            f"{source}: say with --camera which one took it ({', '.join(rig.cameras)})"
        )
    return next(iter(rig.cameras))


def _suffix(path: Path, corrected: Pixels) -> str:
    if corrected.dtype != np.uint8:
        return ".tif"
    return ".jpg" if path.suffix.lower() in (".jpg", ".jpeg") else ".png"


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

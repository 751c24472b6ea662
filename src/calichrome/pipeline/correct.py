"""Whole recordings corrected or rectified."""

import json
from collections.abc import Iterator, Mapping
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
from calichrome.core.files import refuse_existing, writing_folder
from calichrome.errors import CalichromeError, RecordingError
from calichrome.geometry.rectification import Rectification, rectify_pair
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

Picture = tuple[str, str, Path]


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
) -> list[Path]:
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
    list of Path
        What was written.
    """
    pictures = list(_pictures(rig, source, camera, pattern))
    correctors = {}
    for name in dict.fromkeys(name for name, _, _ in pictures):
        entry = rig.cameras[name]
        source_map = undistorting_map(entry.lens, entry.size_wh) if undistort else None
        correctors[name] = _named(name, entry, space, source_map)
    written = []
    with writing_folder(output, force=force) as folder:
        for done, (name, frame, path) in enumerate(pictures):
            progress("correcting", done, len(pictures))
            image = _read(rig.cameras[name], path)
            corrected = _apply(correctors[name], image, path)
            place = Path(name) / f"{frame}{_suffix(path, corrected)}"
            write_picture(folder / place, corrected)
            written.append(output / place)
        progress("correcting", len(pictures), len(pictures))
    return written


def rectify(
    rig: Rig,
    pair: tuple[str, str],
    source: Path,
    output: Path,
    *,
    pattern: str | None = None,
    space: OutputSpace = "srgb",
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
    sheet
        Also write the first common frame side by side, with lines along which points correspond.

    Returns
    -------
    Rectification
        As written.
    """
    for name in pair:
        if name not in rig.cameras:
            raise RecordingError(f"the rig has no camera {name}; it has {', '.join(rig.cameras)}")
    if pair[0] == pair[1]:
        raise RecordingError("--pair wants two different cameras")
    if sheet is not None:
        refuse_existing(sheet, force=force)
    cameras = {name: rig.cameras[name] for name in pair}
    a, b = (cameras[name] for name in pair)
    b_from_a = b.cam_from_ref @ a.cam_from_ref.inverse()
    rectification = rectify_pair(a.lens, b.lens, b_from_a, a.size_wh, b.size_wh)
    turns = dict(zip(pair, (rectification.rotation_a, rectification.rotation_b), strict=True))
    spaces = {name: space if item.colour is not None else "none" for name, item in cameras.items()}
    correctors = {
        name: _named(
            name,
            item,
            spaces[name],
            rectifying_map(item.lens, turns[name], rectification.matrix, rectification.size_wh),
        )
        for name, item in cameras.items()
    }
    recording = open_recording(source, pattern=pattern, cameras=pair)
    frames = [frame for frame in recording.files[pair[0]] if frame in recording.files[pair[1]]]
    shown: list[tuple[str, Pixels]] = []
    with writing_folder(output, force=force) as folder:
        for done, frame in enumerate(frames):
            progress("rectifying", done, len(frames))
            for name in pair:
                path = recording.files[name][frame]
                picture = _apply(correctors[name], _read(cameras[name], path), path)
                write_picture(folder / name / f"{frame}.png", picture)
                if len(shown) < 2:
                    shown.append((f"{name}, frame {frame}", picture))
        progress("rectifying", len(frames), len(frames))
        text = json.dumps(_rectification_json(rectification, pair), indent=1)
        (folder / "rectification.json").write_text(text + "\n", encoding="utf-8")
    if sheet is not None:
        first, second = ((name, _rgb8(picture)) for name, picture in shown)
        drawn = rectified_sheet(first, second, vertical=rectification.vertical)
        write_picture(sheet, drawn, force=force)
    return rectification


def _named(
    name: str, camera: Camera, space: OutputSpace, source_map: SourceMap | None
) -> Corrector:
    try:
        return Corrector(camera, space, source_map)
    except CalichromeError as error:
        raise CalichromeError(f"camera {name}: {error}") from error


def _apply(corrector: Corrector, image: Image, path: Path) -> Pixels:
    try:
        return corrector.apply(image)
    except CalichromeError as error:
        raise CalichromeError(f"{path}: {error}") from error


def _read(camera: Camera, path: Path) -> Image:
    encoding = None if camera.colour is None else camera.colour.encoding
    image = read_image(path, encoding=encoding)
    if isinstance(image, Unreadable):
        raise RecordingError(f"{path}: {image.reason}")
    return image


def _pictures(rig: Rig, source: Path, camera: str | None, pattern: str | None) -> Iterator[Picture]:
    if camera is not None and camera not in rig.cameras:
        raise RecordingError(f"the rig has no camera {camera}; it has {', '.join(rig.cameras)}")
    if source.is_file():
        if source.suffix.lower() not in PICTURE_SUFFIXES:
            raise RecordingError(f"{source}: is not a picture ({', '.join(PICTURE_SUFFIXES)})")
        name = camera or _only_camera(rig, source)
        yield name, source.stem, source
        return
    recording = _open(rig, source, camera, pattern)
    for name, frames in recording.items():
        if name not in rig.cameras:
            raise RecordingError(
                f"{source}: camera {name} is not in the rig ({', '.join(rig.cameras)}); rename its "
                f"folder, or say with --camera which one it is"
            )
        for frame, path in frames.items():
            yield name, frame, path


def _open(
    rig: Rig, source: Path, camera: str | None, pattern: str | None
) -> Mapping[str, Mapping[str, Path]]:
    if camera is not None and pattern is None:
        flat: Recording = open_recording(source, pattern="{frame}")
        return {camera: flat.files["cam0"]}
    recording = open_recording(source, pattern=pattern)
    if recording.cameras == ("cam0",) and "cam0" not in rig.cameras:
        return {camera or _only_camera(rig, source): recording.files["cam0"]}
    return recording.files


def _only_camera(rig: Rig, source: Path) -> str:
    if len(rig.cameras) > 1:
        raise RecordingError(
            f"{source}: say with --camera which one took it ({', '.join(rig.cameras)})"
        )
    return next(iter(rig.cameras))


def _suffix(path: Path, corrected: Pixels) -> str:
    if corrected.dtype == np.float32:
        return ".tif"
    if corrected.dtype == np.uint16:
        return ".png" if path.suffix.lower() == ".png" and corrected.ndim == 3 else ".tif"
    return ".jpg" if path.suffix.lower() in (".jpg", ".jpeg") else ".png"


def _rgb8(picture: Pixels) -> Pixels:
    if picture.dtype == np.float32:
        picture = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)
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
        "R1": item.rotation_a.tolist(),
        "R2": item.rotation_b.tolist(),
        "P1": item.projection_a.tolist(),
        "P2": item.projection_b.tolist(),
        "Q": item.disparity_to_depth.tolist(),
    }

"""A rig written for other programs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from calichrome.colorimetry.encoding import EncodingName
from calichrome.core.files import check_folder, check_output, writing_file, writing_folder
from calichrome.core.findings import Finding
from calichrome.errors import CalichromeError, OutputError, RecordingError
from calichrome.export import (
    CubeSpace,
    bake_cube,
    cube_text,
    opencv_camera,
    opencv_pair,
    ros_camera,
    ros_pair,
)
from calichrome.geometry.rectified_area import Framing
from calichrome.pipeline.rectified_pair import rectified_pair
from calichrome.rig import Camera, Rig

__all__ = ["CubeSettings", "ExportFormat", "export_rig"]

ExportFormat = Literal["opencv", "ros", "cube"]
_SUFFIXES: Mapping[ExportFormat, tuple[str, ...]] = {
    "opencv": (".yaml", ".yml"),
    "ros": (".yaml", ".yml"),
    "cube": (".cube",),
}
Texts = dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class CubeSettings:
    """What a .cube is to hold; see `bake_cube`."""

    size: int = 65
    """Of --to cube: nodes along each axis, 33 or 65."""
    colour: CubeSpace = "srgb"
    """Of --to cube: colour space of the output."""
    input: EncodingName | None = None
    """Of --to cube: encoding of the pictures that it will be applied to. Default: the camera's."""


def export_rig(
    rig: Rig,
    kind: ExportFormat,
    output: Path,
    *,
    cameras: Sequence[str] = (),
    pair: tuple[str, str] | None = None,
    framing: Framing | None = None,
    cube: CubeSettings | None = None,
    force: bool = False,
) -> tuple[list[Path], list[Finding]]:
    """Write a rig in a format of other programs.

    Parameters
    ----------
    rig
        The calibration.
    kind
        "opencv" and "ros" hold lenses and places, "cube" colours.
    output
        Folder for ``<camera>.yaml`` or ``<camera>.cube``, of an OpenCV pair ``<a>-<b>.yaml``; or,
        if there is one file only, its name.
    cameras
        Only these; none: all.
    pair
        Export these two as a rectified pair, in this order.
    framing
        Of the rectified pictures; None: all of both.
    cube
        Settings of "cube".
    force
        Replace existing files.

    Returns
    -------
    written : list of Path
    findings : list of Finding
        Doubts about what was written.
    """
    named_file = output.suffix.lower() in _SUFFIXES[kind]
    (check_output if named_file else check_folder)(output, force=force)
    findings: list[Finding] = []
    if pair is not None:
        texts = _pair_texts(rig, kind, pair, framing)
    else:
        texts = {}
        for name, camera in _chosen(rig, kind, cameras).items():
            texts[name], doubts = _camera_text(name, camera, kind, cube or CubeSettings())
            findings += doubts
    if named_file:
        if len(texts) > 1:
            raise OutputError(
                f"{output} is one file, and {', '.join(texts)} are {len(texts)}; give a folder "
                f"with -o, or one camera with --cameras"
            )
        with writing_file(output, force=force) as temporary:
            temporary.write_text(next(iter(texts.values())), encoding="utf-8")
        return [output], findings
    names = {f"{name}{_SUFFIXES[kind][0]}": text for name, text in texts.items()}
    with writing_folder(output, force=force) as folder:
        for name, text in names.items():
            if Path(name).name != name:  # it must stay inside the folder
                raise OutputError(f"camera {name!r} is no name for a file; rename it in rig.json")
            (folder / name).write_text(text, encoding="utf-8")
    return [output / name for name in names], findings


def _chosen(rig: Rig, kind: ExportFormat, cameras: Sequence[str]) -> dict[str, Camera]:
    missing = [name for name in cameras if name not in rig.cameras]
    if missing:
        raise RecordingError(f"the rig has no camera {missing[0]}; it has {', '.join(rig.cameras)}")
    if cameras:
        return {name: rig.cameras[name] for name in cameras}
    if kind != "cube":
        return dict(rig.cameras)
    coloured = {name: item for name, item in rig.cameras.items() if item.colour is not None}
    if not coloured:
        raise CalichromeError(
            "the rig has no colour calibration, and a .cube holds nothing else; calibrate with the "
            "colour target"
        )
    return coloured


def _camera_text(
    name: str, camera: Camera, kind: ExportFormat, settings: CubeSettings
) -> tuple[str, tuple[Finding, ...]]:
    if kind == "opencv":
        return opencv_camera(name, camera), ()
    if kind == "ros":
        return ros_camera(name, camera), ()
    try:
        cube = bake_cube(camera, settings.size, settings.colour, settings.input)
    except CalichromeError as error:
        raise CalichromeError(f"camera {name}: {error}") from error
    text = cube_text(cube, name, vignetting=camera.vignetting is not None)
    return text, cube.doubts(name)


def _pair_texts(
    rig: Rig, kind: ExportFormat, pair: tuple[str, str], framing: Framing | None
) -> Texts:
    if kind == "cube":
        raise OutputError("--pair belongs to opencv and ros: a .cube holds one camera's colours")
    rectification = rectified_pair(rig, pair, framing)
    cameras = rig.cameras[pair[0]], rig.cameras[pair[1]]
    if kind == "opencv":
        return {"-".join(pair): opencv_pair(pair, cameras, rectification)}
    return dict(zip(pair, ros_pair(pair, cameras, rectification), strict=True))

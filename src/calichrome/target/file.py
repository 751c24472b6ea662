"""target.json, and targets named on the command line.

The file's keys are part of the contract (docs/file-format.md); XYZ has Y = 100 there and Y = 1 in
code. Keys that are not known are kept.
"""

import json
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.core.arrays import FloatArray
from calichrome.core.units import parse_length, parse_lengths
from calichrome.errors import TargetError
from calichrome.target.board import Marker, Paper, Target, chessboard
from calichrome.target.fiducial import (
    ARUCO_DICTIONARIES,
    AprilGridTarget,
    CharucoTarget,
    CodedTarget,
    april_grid,
    charuco_board,
)

__all__ = ["load_target", "parse_target", "target_from_json", "target_to_json", "with_square_size"]

FORMAT: Literal["calichrome.target"] = "calichrome.target"
FORMAT_VERSION = 1
_MAX_BYTES = 10_000_000
_DERIVED = ("Lab_D65", "XYZ_D50", "Lab_D50")  # of a disc: written for readers, never read
Triple = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _MarkerFile(_Strict):
    square: tuple[int, int]
    name: str = Field(max_length=200)
    diameter_m: float = Field(gt=0)
    background: Literal["black", "white"]
    XYZ_D65: Triple


class _PaperFile(_Strict):
    white_XYZ_D65: Triple | None = None  # noqa: N815 (the key in the file)
    black_XYZ_D65: Triple | None = None  # noqa: N815


class _CharucoFile(_Strict):
    kind: Literal["charuco"]
    dictionary: str = Field(max_length=100)
    marker_size_m: float = Field(gt=0)
    inverted: bool = False
    legacy: bool | None = None


class _AprilGridFile(_Strict):
    kind: Literal["aprilgrid"]
    dictionary: str = Field(max_length=100)
    spacing: float
    inverted: bool = False


class _TargetFile(_Strict):
    format: Literal["calichrome.target"] = FORMAT
    format_version: Literal[1] = 1
    squares: tuple[int, int]
    square_size_m: float | tuple[float, float]
    top_left_square: Literal["black", "white"]
    white_margin_m: float | None = Field(default=None, ge=0)
    paper: _PaperFile | None = None
    markers: list[_MarkerFile] = Field(default_factory=list, max_length=10_000)
    codes: _CharucoFile | _AprilGridFile | None = Field(default=None, discriminator="kind")
    square_size_measured: bool = False
    colours_measured: bool = False


def load_target(path: Path) -> Target:
    """Read target.json.

    Raises
    ------
    TargetError
        If the file is missing, is not JSON, or says something impossible.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise TargetError(f"{path}: {path.stat().st_size / 1e6:.0f} MB is no target file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise TargetError(f"{path}: cannot be read ({error.strerror}); check --target") from error
    except UnicodeDecodeError as error:
        raise TargetError(f"{path}: is not a text file; --target wants target.json") from error
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise TargetError(f"{path}: is not valid JSON ({error}); repair it") from error
    try:
        return target_from_json(data)
    except TargetError as error:
        raise TargetError(f"{path}: {error}") from error


def _refuse_constant(name: str) -> float:
    raise ValueError(f"holds {name}, which is not a number that can be used")


def target_from_json(data: object) -> Target:
    """Build a target from the content of target.json (XYZ with Y = 100)."""
    try:
        file = _TargetFile.model_validate(data)
    except ValidationError as error:
        problems = [
            f"{'.'.join(str(part) for part in problem['loc'])}: {problem['msg']}"
            for problem in error.errors()[:3]
        ]
        raise TargetError(f"{'; '.join(problems)}; see docs/file-format.md") from error
    size = file.square_size_m
    paper = file.paper or _PaperFile()
    target = Target(
        squares=file.squares,
        square_m=(size, size) if isinstance(size, float) else size,
        top_left=file.top_left_square,
        white_margin_m=file.white_margin_m,
        markers=tuple(
            Marker(
                square=marker.square,
                name=marker.name,
                diameter_m=marker.diameter_m,
                background=marker.background,
                xyz_d65=_scaled(marker.XYZ_D65, 0.01),
                extra=_unknown(marker, _DERIVED),
            )
            for marker in file.markers
        ),
        paper=Paper(
            white_xyz_d65=paper.white_XYZ_D65 and _scaled(paper.white_XYZ_D65, 0.01),
            black_xyz_d65=paper.black_XYZ_D65 and _scaled(paper.black_XYZ_D65, 0.01),
            extra=_unknown(paper),
        ),
        square_size_measured=file.square_size_measured,
        colours_measured=file.colours_measured,
        extra=_unknown(file),
    )
    return target if file.codes is None else _with_codes(target, file.codes)


def _with_codes(target: Target, codes: _CharucoFile | _AprilGridFile) -> CodedTarget:
    plain = {item.name: getattr(target, item.name) for item in fields(target)}
    plain |= {"dictionary": codes.dictionary, "inverted": codes.inverted}
    if isinstance(codes, _AprilGridFile):
        return AprilGridTarget(**plain, spacing=codes.spacing)
    share = codes.marker_size_m / min(target.square_m)
    return CharucoTarget(**plain, marker_share=share, legacy=codes.legacy)


def _codes_to_json(target: CodedTarget) -> dict[str, Any]:
    data = {"dictionary": target.dictionary, "inverted": target.inverted}
    if isinstance(target, CharucoTarget):
        size = round(target.marker_share * min(target.square_m), 9)
        return {"kind": "charuco", **data, "marker_size_m": size, "legacy": target.legacy}
    if isinstance(target, AprilGridTarget):
        return {"kind": "aprilgrid", **data, "spacing": target.spacing}
    raise TypeError(f"target: expected a board with codes, got {type(target).__name__}")


def _unknown(part: _Strict, known: Collection[str] = ()) -> dict[str, Any]:
    return {key: value for key, value in (part.model_extra or {}).items() if key not in known}


def target_to_json(target: Target) -> dict[str, Any]:
    """Return the content of target.json (XYZ with Y = 100)."""
    same = target.square_m[0] == target.square_m[1]
    data: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "squares": list(target.squares),
        "square_size_m": target.square_m[0] if same else list(target.square_m),
        "square_size_measured": target.square_size_measured,
        "top_left_square": target.top_left,
        "white_margin_m": target.white_margin_m,
        "colours_measured": target.colours_measured,
    }
    if isinstance(target, CodedTarget):
        data["codes"] = _codes_to_json(target)
    paper_xyz = {
        "white_XYZ_D65": target.paper.white_xyz_d65,
        "black_XYZ_D65": target.paper.black_xyz_d65,
    }
    paper = {key: _listed(xyz, 100) for key, xyz in paper_xyz.items() if xyz}
    if paper or target.paper.extra:
        data["paper"] = paper | dict(target.paper.extra)
    xyz_d65 = target.marker_xyz_d65
    xyz_d50 = adapt(xyz_d65, D65, D50)
    lab_d65, lab_d50 = lab_from_xyz(xyz_d65, D65), lab_from_xyz(xyz_d50, D50)
    data["markers"] = [
        {
            "square": list(marker.square),
            "name": marker.name,
            "diameter_m": marker.diameter_m,
            "background": marker.background,
            "XYZ_D65": _listed(xyz_d65[index], 100),
            "Lab_D65": _listed(lab_d65[index], 1),
            "XYZ_D50": _listed(xyz_d50[index], 100),
            "Lab_D50": _listed(lab_d50[index], 1),
            **marker.extra,
        }
        for index, marker in enumerate(target.markers)
    ]
    return data | dict(target.extra)


def parse_target(text: str) -> Target:
    """Read ``--target``: a file, or a board described in one word.

    Parameters
    ----------
    text
        A path, ``chessboard:NxM:SIZE`` (NxM inner corners),
        ``charuco:COLSxROWS:DICT:SQUARE:MARKER[:inverted][:legacy|:current]`` (counts are squares),
        or ``aprilgrid:COLSxROWS:FAMILY:SIZE:SPACING`` (counts are tags; kalibr's convention).

    Raises
    ------
    TargetError
        If it is none of these.
    """
    kind, colon, _ = text.partition(":")
    parse = _PARSERS.get(kind) if colon else None
    if parse is None:
        return load_target(Path(text))
    try:
        return parse(text)
    except (TargetError, ValueError) as error:
        raise TargetError(f"--target {text}: {error}") from error


def _parse_chessboard(text: str) -> Target:
    match = re.fullmatch(r"chessboard:(\d{1,3})x(\d{1,3}):(.+)", text)
    if match is None:
        raise TargetError(
            "write chessboard:NxM:SIZE with N x M inner corners and the size of a square with its "
            "unit, like chessboard:9x6:30mm"
        )
    square_m = parse_lengths(match[3])
    return chessboard((int(match[1]), int(match[2])), square_m)


_CHARUCO_OPTIONS = ("inverted", "legacy", "current")


def _parse_charuco(text: str) -> CharucoTarget:
    match = re.fullmatch(
        r"charuco:(\d{1,3})x(\d{1,3}):(\w+):([^:]+):([^:]+)((?::\w+)*)", text, re.ASCII
    )
    options = match[6].split(":")[1:] if match is not None else []
    both = {"legacy", "current"} <= set(options)
    if match is None or both or not set(options) <= set(_CHARUCO_OPTIONS):
        raise TargetError(
            "write charuco:COLSxROWS:DICT:SQUARE:MARKER with the number of squares, the dictionary "
            "and the sizes of a square and of a code with their units, like "
            "charuco:7x5:4X4_50:30mm:22mm; then :inverted if black and white are exchanged, and "
            ":legacy or :current if you know the layout of a board with an even number of rows"
        )
    return charuco_board(
        (int(match[1]), int(match[2])),
        _dictionary(match[3]),
        parse_lengths(match[4]),
        parse_length(match[5]),
        inverted="inverted" in options,
        legacy="legacy" in options if {"legacy", "current"} & set(options) else None,
    )


def _dictionary(name: str) -> str:
    """Return the name as we write it; people write DICT_4X4_50 and 4x4_50, too."""
    plain = name.upper().removeprefix("DICT_")
    return next((known for known in ARUCO_DICTIONARIES if known.upper() == plain), name)


def _parse_aprilgrid(text: str) -> AprilGridTarget:
    match = re.fullmatch(
        r"aprilgrid:(\d{1,3})x(\d{1,3}):(?:tag|t)?(\w+):([^:]+):(\d*\.?\d+)", text, re.ASCII
    )
    if match is None:
        raise TargetError(
            "write aprilgrid:COLSxROWS:FAMILY:SIZE:SPACING with the number of tags, the size of a "
            "tag with its unit, and the gap between tags over their size, like "
            "aprilgrid:6x6:36h11:88mm:0.3"
        )
    tags_xy = int(match[1]), int(match[2])
    return april_grid(tags_xy, match[3], parse_lengths(match[4]), float(match[5]))


_PARSERS: Mapping[str, Callable[[str], Target]] = MappingProxyType(
    {"chessboard": _parse_chessboard, "charuco": _parse_charuco, "aprilgrid": _parse_aprilgrid}
)


def with_square_size(target: Target, square_m: tuple[float, float]) -> Target:
    """Return the same target with squares of a measured size; discs keep their share of it."""
    scale = min(square_m) / min(target.square_m)
    markers = tuple(
        replace(marker, diameter_m=marker.diameter_m * scale) for marker in target.markers
    )
    return replace(target, square_m=square_m, markers=markers, square_size_measured=True)


def _scaled(xyz: Triple, factor: float) -> Triple:
    return xyz[0] * factor, xyz[1] * factor, xyz[2] * factor


def _listed(values: FloatArray | Triple, factor: float) -> list[float]:
    return [round(float(value) * factor, 6) for value in values]

"""Colours from a CSV file: a palette to print, or the measured values of a print.

Files come from instruments, spreadsheets and hands; whatever could be read in two ways is refused.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.difference import xyz_from_lab
from calichrome.core.arrays import FloatArray
from calichrome.errors import TargetError

__all__ = ["PaletteColour", "read_colour_table"]

Triple = tuple[float, float, float]

_MAX_BYTES = 1_000_000
_MAX_ROWS = 10_000
_MAX_NAME = 200  # the limit of target.json
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_WHITES = {"d50": D50, "d65": D65}
_OBSERVER_WORDS = re.compile(r"cie|standard|observer|degrees?|deg|[°\s,/_-]")
_OBSERVER_2, _OBSERVER_10 = {"2", "1931", "19312"}, {"10", "1964", "196410"}
_SPACES = {"XYZ": ("x", "y", "z"), "Lab": ("l", "a", "b")}
# Values outside are typing errors, shifted columns or another scale; fluorescent paper reaches
# Y = 110, saturated prints |a*|, |b*| = 130.
_RANGES = {"XYZ": ((0.0, 200.0),) * 3, "Lab": ((0.0, 130.0), (-200.0, 200.0), (-200.0, 200.0))}


@dataclass(frozen=True, slots=True, kw_only=True)
class PaletteColour:
    """A named colour.

    Parameters
    ----------
    name
        How discs of this colour are called.
    xyz_d65 : (3,) float
        CIE 1931 2 degree tristimulus values under D65, Y = 1 for the perfect diffuser.
    """

    name: str
    xyz_d65: Triple


def read_colour_table(
    path: Path, *, illuminant: str | None = None, observer: str | None = None
) -> tuple[PaletteColour, ...]:
    """Read named colours.

    Parameters
    ----------
    path
        CSV with a header: ``name``, then ``X,Y,Z`` (Y = 100 for the perfect diffuser) or ``L,a,b``
        (if both are there, XYZ counts), and optionally ``illuminant`` and ``observer``. Separated
        by commas, semicolons or tabs; decimal commas only where the comma does not separate.
    illuminant, observer
        What holds for rows that do not say it: "D50" or "D65"; "2". D50 is adapted to D65.

    Raises
    ------
    TargetError
        If a value is missing, impossible or ambiguous (naming line and column), or the values are
        for another light or observer than can be converted.
    """
    lines, separator = _read_lines(path)
    columns = _columns(path, lines[0][1])
    colours: dict[str, PaletteColour] = {}
    n_fields = len(lines[0][1])
    for number, fields in lines[1:]:
        where = f"{path}, line {number}"
        if len(fields) != n_fields:
            hint = (
                "; decimal commas? write points, or separate the columns by semicolons"
                if len(fields) > n_fields and separator == ","
                else "; give every row one value per column, names with a comma in quotes"
            )
            raise TargetError(f"{where}: {len(fields)} values under {n_fields} columns{hint}")
        row = {key: fields[place].strip() for key, place in columns.items()}
        name = row["name"]
        if not name or len(name) > _MAX_NAME or not name.isprintable():
            raise TargetError(
                f"{where}, column name: {name[:40]!r} is no name; write 1 to {_MAX_NAME} characters"
            )
        if name in colours:
            raise TargetError(
                f"{where}, column name: {name} stands there twice; keep one row per name (average "
                f"repeated measurements first)"
            )
        white = _white(
            where,
            _stated(where, "illuminant", row.get("illuminant"), illuminant),
            _stated(where, "observer", row.get("observer"), observer),
        )
        colours[name] = PaletteColour(name=name, xyz_d65=_xyz_d65(where, row, white, separator))
    if not colours:
        raise TargetError(f"{path}: has a header and no colours; add one row per colour")
    brightest = max(colour.xyz_d65[1] for colour in colours.values())
    if brightest <= 0.015:
        raise TargetError(
            f"{path}: no colour reaches Y = 1.5 or L* = 13: the values seem to be on the scale of "
            f"0 to 1; multiply XYZ (or L, a, b) so that the perfect diffuser has Y = 100, L* = 100"
        )
    return tuple(colours.values())


def _read_lines(path: Path) -> tuple[list[tuple[int, list[str]]], str]:
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise TargetError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise TargetError(f"{path}: is not UTF-8 text; save it as CSV in UTF-8") from error
    if len(raw) > _MAX_BYTES:
        raise TargetError(
            f"{path}: more than {_MAX_BYTES // 1_000_000} MB is no table of colours; export the "
            f"columns name, X, Y, Z only"
        )
    header = next((line for line in text.splitlines() if line.strip()), "")
    separator = max(",;\t", key=header.count)
    reader = csv.reader(text.splitlines(), delimiter=separator, strict=True)
    lines: list[tuple[int, list[str]]] = []
    try:
        for fields in reader:
            if any(field.strip() for field in fields):
                lines.append((reader.line_num, fields))
            if len(lines) > _MAX_ROWS:
                raise TargetError(f"{path}: more than {_MAX_ROWS} rows; a board has fewer discs")
    except csv.Error as error:
        raise TargetError(
            f"{path}, line {reader.line_num}: is not CSV ({error}); close every quote"
        ) from error
    if not lines:
        raise TargetError(f"{path}: is empty; write a header (name,X,Y,Z) and one row per colour")
    return lines, separator


def _columns(path: Path, header: Sequence[str]) -> dict[str, int]:
    """Find the columns; instruments write L*, LAB_L or XYZ_X, and further columns are ignored."""
    places: dict[str, int] = {}
    for place, title in enumerate(header):
        key = title.strip().casefold().removesuffix("*")
        key = key.removeprefix("xyz_").removeprefix("lab_")
        if key in {"name", "illuminant", "observer", *"xyzlab"}:
            if key in places:
                raise TargetError(f"{path}: two columns are called {title.strip()!r}; remove one")
            places[key] = place
    found = [space for space, keys in _SPACES.items() if all(key in places for key in keys)]
    if "name" not in places or not found:
        raise TargetError(
            f"{path}: the first line must name the columns name and X, Y, Z or name and L, a, b; "
            f"it says {', '.join(title.strip() for title in header)[:200]!r}"
        )
    wanted = ("name", "illuminant", "observer", *_SPACES[found[0]])
    return {key: place for key, place in places.items() if key in wanted}


def _stated(where: str, what: str, in_row: str | None, given: str | None) -> str:
    if in_row and given and in_row.casefold() != given.casefold():
        raise TargetError(f"{where}: {what} {in_row} here, but {given} was given; keep one of them")
    stated = in_row or given
    if not stated:
        example = "D50 or D65" if what == "illuminant" else "2 (CIE 1931) degrees"
        raise TargetError(
            f"{where}: the {what} is not stated, and the same numbers mean another colour under "
            f"another one; add a column {what} or give it ({example})"
        )
    return stated


def _white(where: str, illuminant: str, observer: str) -> FloatArray:
    plain = _OBSERVER_WORDS.sub("", observer.casefold())
    if plain not in _OBSERVER_2:
        known = "the 10 degree" if plain in _OBSERVER_10 else f"the {observer[:40]!r}"
        raise TargetError(
            f"{where}: values for {known} observer cannot be converted without the spectra; let "
            f"the instrument report the CIE 1931 2 degree observer"
        )
    white = _WHITES.get(illuminant.casefold().removeprefix("cie").strip())
    if white is None:
        raise TargetError(
            f"{where}: values under {illuminant[:40]!r} cannot be converted to D65 without "
            f"the spectra; let the instrument report D50 or D65"
        )
    return white


def _xyz_d65(where: str, row: dict[str, str], white: FloatArray, separator: str) -> Triple:
    space = next(space for space, keys in _SPACES.items() if keys[0] in row)
    values = []
    for key, (low, high) in zip(_SPACES[space], _RANGES[space], strict=True):
        column = key.upper() if key in "xyzl" else key
        value = _number(f"{where}, column {column}", row[key], separator)
        if not low <= value <= high:
            raise TargetError(
                f"{where}, column {column}: {value:g} is not between {low:g} and {high:g}; XYZ has "
                f"Y = 100 for the perfect diffuser, Lab L* = 100"
            )
        values.append(value)
    read = np.array(values)
    xyz = read / 100 if space == "XYZ" else xyz_from_lab(read, white)
    if white is not D65:
        xyz = adapt(xyz, white, D65)
    if xyz.min() < -0.005:
        raise TargetError(
            f"{where}: {space} = {', '.join(f'{value:g}' for value in values)} would be a colour "
            f"of negative light; check the columns and their order"
        )
    # Rounding and adaptation leave deep colours a little below zero.
    x, y, z = (max(float(value), 0.0) for value in xyz)
    return x, y, z


def _number(where: str, text: str, separator: str) -> float:
    if separator != "," and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    if _NUMBER.fullmatch(text) is None:
        what = "is empty" if not text else f"{text[:40]!r} is not a number"
        raise TargetError(f"{where}: {what}; write it like 41.5")
    return float(text)

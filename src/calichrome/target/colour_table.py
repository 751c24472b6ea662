"""Colours from a table in a text file: a palette to print, or the measured values of a print.

Files come from instruments, spreadsheets and hands; whatever could be read in two ways is refused.
"""

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.difference import xyz_from_lab
from calichrome.core.arrays import FloatArray
from calichrome.errors import TargetError
from calichrome.target.cgats import cgats_table, is_cgats
from calichrome.target.spectral_table import spectral_columns, spectral_xyz_d65
from calichrome.target.text_table import TextTable, csv_table, read_number

__all__ = ["PaletteColour", "read_colour_table"]

Triple = tuple[float, float, float]

_MAX_BYTES = 1_000_000
_MAX_NAME = 200  # the limit of target.json
_WHITES = {"d50": D50, "d65": D65}
_OBSERVER_WORDS = re.compile(r"cie|standard|observer|degrees?|deg|[°\s,/_-]")
_OBSERVER_2, _OBSERVER_10 = {"2", "1931", "19312"}, {"10", "1964", "196410"}
_NAMES = {
    "name": "name", "patch": "patch", "samplename": "samplename", "sampleid": "sampleid",
    "sampleloc": "sampleloc",
}  # fmt: skip
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
        CSV with a header, separated by commas, semicolons or tabs (decimal commas only where the
        comma does not separate), or CGATS text (also ArgyllCMS's .ti3). A column of names
        (``name``, ``patch``, ``SAMPLE_NAME``, ``SAMPLE_ID`` or ``SAMPLE_LOC``, the first of these
        that is there), then reflectances (``380``, ``nm380``, ``SPEC_380``, ``SPECTRAL_NM380``),
        ``X,Y,Z`` (Y = 100 for the perfect diffuser) or ``L,a,b``; of several the first kind counts.
        CSV may have columns ``illuminant`` and ``observer``, CGATS says them in its keywords.
    illuminant, observer
        What holds for values that do not say it: "D50" or "D65"; "2". D50 is adapted to D65.
        Reflectances need neither: they are integrated under D65 for 2 degrees.

    Raises
    ------
    TargetError
        If a value is missing, impossible or ambiguous (naming line and column), or the values are
        for another light or observer than can be converted.
    """
    table = _read_table(path)
    columns = _columns(path, table)
    names = [_name(f"{path}, line {number}", fields[columns.name]) for number, fields in table.rows]
    _refuse_repeated(path, table, names)
    if not names:
        raise TargetError(f"{path}: has a header and no colours; add one row per colour")
    if columns.bands_nm:
        values = spectral_xyz_d65(path, table, columns.bands_nm)
    else:
        values = [
            _xyz_of_row(f"{path}, line {number}", fields, columns, table, illuminant, observer)
            for number, fields in table.rows
        ]
    if max(y for _, y, _ in values) <= 0.015:
        raise TargetError(
            f"{path}: no colour reaches Y = 1.5 or L* = 13: the values seem to be on the scale of "
            f"0 to 1; multiply XYZ (or L, a, b) so that the perfect diffuser has Y = 100, L* = 100"
        )
    return tuple(
        PaletteColour(name=name, xyz_d65=xyz) for name, xyz in zip(names, values, strict=True)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Columns:
    """Places of the columns: `values` of a colour space or `bands_nm` of reflectances."""

    name: int
    illuminant: int | None
    observer: int | None
    space: str
    values: tuple[int, ...]
    bands_nm: dict[int, float]


def _read_table(path: Path) -> TextTable:
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise TargetError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    if len(raw) > _MAX_BYTES:
        raise TargetError(
            f"{path}: more than {_MAX_BYTES // 1_000_000} MB is no table of colours; export the "
            f"columns name, X, Y, Z only"
        )
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raw = raw.decode("utf-16", errors="replace").encode()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not is_cgats(raw):
            raise TargetError(f"{path}: is not UTF-8 text; save it as CSV in UTF-8") from error
        text = raw.decode("latin-1")  # the degree sign of Windows programs
    return cgats_table(str(path), text) if is_cgats(raw) else csv_table(str(path), text)


def _columns(path: Path, table: TextTable) -> _Columns:
    """Find the columns; further ones (device values, densities) are ignored."""
    places: dict[str, int] = {}
    for place, title in enumerate(table.header):
        key = title.strip().casefold().removesuffix("*")
        key = key.removeprefix("xyz_").removeprefix("lab_")
        key = _NAMES.get(key.replace("_", ""), key)
        if key in {*_NAMES.values(), "illuminant", "observer", *"xyzlab"}:
            if key in places:
                raise TargetError(f"{path}: two columns are called {title.strip()!r}; remove one")
            places[key] = place
    name = next((places[key] for key in _NAMES.values() if key in places), None)
    found = [space for space, keys in _SPACES.items() if all(key in places for key in keys)]
    bands_nm = spectral_columns(path, table.header, required=not found)
    if name is None or not (found or bands_nm):
        raise TargetError(
            f"{path}: the first line must name the columns name and X, Y, Z, or name and L, a, b, "
            f"or name and wavelengths (CGATS: the data format, like SAMPLE_NAME LAB_L LAB_A LAB_B);"
            f" it says {', '.join(title.strip() for title in table.header)[:200]!r}"
        )
    space = found[0] if found else ""
    return _Columns(
        name=name,
        illuminant=places.get("illuminant"),
        observer=places.get("observer"),
        space=space,
        values=tuple(places[key] for key in _SPACES.get(space, ())),
        bands_nm=bands_nm,
    )


def _name(where: str, name: str) -> str:
    if not name or len(name) > _MAX_NAME or not name.isprintable():
        raise TargetError(
            f"{where}, column name: {name[:40]!r} is no name; write 1 to {_MAX_NAME} characters"
        )
    return name


def _refuse_repeated(path: Path, table: TextTable, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for (number, _), name in zip(table.rows, names, strict=True):
        if name in seen:
            raise TargetError(
                f"{path}, line {number}, column name: {name} stands there twice; keep one row per "
                f"name (average repeated measurements first)"
            )
        seen.add(name)


def _xyz_of_row(
    where: str,
    fields: Sequence[str],
    columns: _Columns,
    table: TextTable,
    illuminant: str | None,
    observer: str | None,
) -> Triple:
    def said(what: str, place: int | None, given: str | None) -> str:
        in_row = "" if place is None else fields[place]
        return _stated(where, what, in_row or table.stated.get(what), given)

    white = _white(
        where,
        said("illuminant", columns.illuminant, illuminant),
        said("observer", columns.observer, observer),
    )
    cells = [fields[place] for place in columns.values]
    return _xyz_d65(where, columns.space, cells, white, decimal_comma=table.decimal_comma)


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


def _xyz_d65(
    where: str, space: str, cells: Sequence[str], white: FloatArray, *, decimal_comma: bool
) -> Triple:
    values = []
    for key, cell, (low, high) in zip(_SPACES[space], cells, _RANGES[space], strict=True):
        column = key.upper() if key in "xyzl" else key
        value = read_number(f"{where}, column {column}", cell, decimal_comma=decimal_comma)
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

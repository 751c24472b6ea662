"""CGATS text, as instruments and ArgyllCMS write it: keywords, a data format, data.

Read leniently: quotes may be missing or doubled, fields may be separated by tabs or blanks, counts
may be wrong. What decides about colours is not guessed.

References
----------
.. [1] ANSI CGATS.17, "Exchange format for colour and process control data using XML or ASCII text".
.. [2] ArgyllCMS, "Description of the .ti3 format".
"""

import re
from collections.abc import Iterator

from calichrome.errors import TargetError
from calichrome.target.text_table import MAX_ROWS, TextTable

__all__ = ["cgats_table", "is_cgats"]

_TOKEN = re.compile(r'"([^"]*)"|(\S+)')
_MAX_FIELDS = 2000  # a spectrum of 1 nm has 401 columns
_SAYS = ("ILLUMINANT", "ILLUMINATION", "OBSERVER", "WEIGHTING_FUNCTION", "MEASUREMENT_SOURCE")
_ILLUMINANT = re.compile(r"illumina(?:nt|tion)(?:_name)?\W+(\w+)", re.IGNORECASE)
_OBSERVER = re.compile(r"observer(?:_?angle)?\W+(?:cie\W+)?(\d+)", re.IGNORECASE)
_BOTH = re.compile(r"\bD\d\d[\s,/;-]+(2|10)\s*(?:°|deg)", re.IGNORECASE)
_EMISSION = ("DISPLAY", "EMISINPUT")

_Lines = Iterator[tuple[int, str]]


def is_cgats(raw: bytes) -> bool:
    """Tell CGATS from CSV by its sections."""
    return re.search(rb"(?:^|[\r\n])\s*BEGIN_DATA_FORMAT\b", raw) is not None


def cgats_table(where: str, text: str) -> TextTable:
    """Read the first table of a file.

    Raises
    ------
    TargetError
        If a section is missing, a row does not fit the format, or the file contradicts itself.
    """
    lines = _content(text)
    keywords = list(_until(where, lines, "BEGIN_DATA_FORMAT"))
    header = tuple(
        token for _, line in _until(where, lines, "END_DATA_FORMAT") for token in _tokens(line)
    )
    if not 0 < len(header) <= _MAX_FIELDS:
        raise TargetError(
            f"{where}: names {len(header)} fields between BEGIN_DATA_FORMAT and END_DATA_FORMAT; "
            f"a table of colours has 1 to {_MAX_FIELDS}"
        )
    keywords += _until(where, lines, "BEGIN_DATA")
    rows = []
    for number, line in _until(where, lines, "END_DATA"):
        rows.append((number, _fields(f"{where}, line {number}", line, len(header))))
        if len(rows) > MAX_ROWS:
            raise TargetError(f"{where}: more than {MAX_ROWS} rows; a board has fewer discs")
    is_ti3 = text.lstrip().startswith("CTI3")
    stated = _stated(where, keywords)
    if is_ti3:
        _refuse_emission(where, keywords)
        # reference 2, COLOR_REP: what a reflecting device connects to is D50, as in ICC profiles
        stated = {"illuminant": "D50", "observer": "2"} | stated
    return TextTable(
        header=header,
        rows=tuple(rows),
        decimal_comma=True,
        stated=stated,
        percent=True if is_ti3 else None,
    )


def _content(text: str) -> _Lines:
    for number, line in enumerate(text.splitlines(), 1):
        # names may hold a "#": only whole lines are taken for comments
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _until(where: str, lines: _Lines, section: str) -> _Lines:
    """Yield lines before the one that says `section`."""
    for number, line in lines:
        if line.split()[0].upper() == section:
            return
        yield number, line
    raise TargetError(f"{where}: ends without {section}; it was cut off, export it again")


def _tokens(line: str) -> list[str]:
    return [quoted or plain for quoted, plain in _TOKEN.findall(line)]


def _fields(where: str, line: str, n_fields: int) -> tuple[str, ...]:
    """Split a row at tabs, where names may hold blanks, or else at blanks."""
    at_tabs = [cell.strip().strip('"').strip() for cell in line.strip("\r\n").split("\t")]
    if len(at_tabs) == n_fields + 1 and not at_tabs[-1]:
        at_tabs.pop()  # rows may end with a tab
    for fields in (at_tabs, _tokens(line)):
        if len(fields) == n_fields:
            return tuple(fields)
    raise TargetError(
        f"{where}: {len(_tokens(line))} values for {n_fields} fields of the data format; separate "
        f"the columns by tabs, or put names that hold blanks in quotes"
    )


def _stated(where: str, keywords: list[tuple[int, str]]) -> dict[str, str]:
    """Find what light and observer the keywords name."""
    said: dict[str, set[str]] = {"illuminant": set(), "observer": set()}
    for _, line in keywords:
        if line.split()[0].upper().startswith(_SAYS):
            said["illuminant"].update(_ILLUMINANT.findall(line))
            said["observer"].update(_OBSERVER.findall(line) + _BOTH.findall(line))
    for what, names in said.items():
        if len({name.casefold() for name in names}) > 1:
            raise TargetError(
                f"{where}: its keywords name more than one {what} ({', '.join(sorted(names))}); "
                f"keep the one that its values are for"
            )
    return {what: names.pop() for what, names in said.items() if names}


def _refuse_emission(where: str, keywords: list[tuple[int, str]]) -> None:
    for number, line in keywords:
        words = _tokens(line)
        if words[0].upper() == "DEVICE_CLASS" and words[-1].upper() in _EMISSION:
            raise TargetError(
                f"{where}, line {number}: holds light of a {words[-1]}, not colours of a print; "
                f"give a file of DEVICE_CLASS OUTPUT or INPUT"
            )

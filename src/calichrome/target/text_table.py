"""A table of text fields, before anybody asks what they mean."""

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from calichrome.errors import TargetError

__all__ = ["MAX_ROWS", "TextTable", "csv_table", "read_number"]

MAX_ROWS = 10_000
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """Rows below a line of titles.

    Parameters
    ----------
    header
        Titles of the columns.
    rows
        Line in the file, and one field for each title.
    decimal_comma
        Whether a comma in a number can only be its decimal point.
    stated
        What the file says for all rows: "illuminant", "observer".
    percent
        Whether its kind of file holds reflectances in per cent; None: it may hold either.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    decimal_comma: bool
    stated: Mapping[str, str] = field(default_factory=dict)
    percent: bool | None = None


def csv_table(where: str, text: str) -> TextTable:
    """Read CSV separated by commas, semicolons or tabs; the first line names the columns.

    Raises
    ------
    TargetError
        If it is no CSV, or a row does not fit the first line.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    separator = max(",;\t", key=first.count)
    reader = csv.reader(text.splitlines(), delimiter=separator, strict=True)
    lines: list[tuple[int, tuple[str, ...]]] = []
    try:
        for fields in reader:
            if any(cell.strip() for cell in fields):
                lines.append((reader.line_num, tuple(cell.strip() for cell in fields)))
            if len(lines) > MAX_ROWS:
                raise TargetError(f"{where}: more than {MAX_ROWS} rows; a board has fewer discs")
    except csv.Error as error:
        raise TargetError(
            f"{where}, line {reader.line_num}: is not CSV ({error}); close every quote"
        ) from error
    if not lines:
        raise TargetError(f"{where}: is empty; write a header (name,X,Y,Z) and one row per colour")
    header, rows = lines[0][1], lines[1:]
    _check_lengths(where, len(header), rows, comma=separator == ",")
    return TextTable(header=header, rows=tuple(rows), decimal_comma=separator != ",")


def _check_lengths(
    where: str, n_fields: int, rows: Iterable[tuple[int, tuple[str, ...]]], *, comma: bool
) -> None:
    for number, fields in rows:
        if len(fields) == n_fields:
            continue
        hint = (
            "; decimal commas? write points, or separate the columns by semicolons"
            if len(fields) > n_fields and comma
            else "; give every row one value per column, names with a comma in quotes"
        )
        raise TargetError(
            f"{where}, line {number}: {len(fields)} values under {n_fields} columns{hint}"
        )


def read_number(where: str, text: str, *, decimal_comma: bool) -> float:
    """Read a number; `where` names it in the error."""
    if decimal_comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    if _NUMBER.fullmatch(text) is None:
        what = "is empty" if not text else f"{text[:40]!r} is not a number"
        raise TargetError(f"{where}: {what}; write it like 41.5")
    return float(text)

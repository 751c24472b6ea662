"""Tables in CSV: read with the line of whatever is wrong, written whole or not at all."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from calichrome.core.files import writing_file
from calichrome.errors import FileFormatError

__all__ = ["Row", "covariance_cells", "float_cell", "integer_cell", "read_table", "write_table"]

_MAX_BYTES = 1_000_000_000
Row = Mapping[str, str]


def write_table(
    path: Path, header: Sequence[str], rows: Iterable[Sequence[object]], *, force: bool
) -> None:
    """Write rows below their header."""
    with (
        writing_file(path, force=force) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def read_table(path: Path, required: Sequence[str]) -> Iterator[tuple[int, Row]]:
    """Yield each row with the number of its line.

    Raises
    ------
    FileFormatError
        If the file cannot be read, lacks a required column, or a row has more or fewer cells.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{path}: is larger than 1 GB, which no such file is")
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = [key for key in required if key not in (reader.fieldnames or ())]
            if missing:
                raise FileFormatError(f"{path}: lacks the columns {', '.join(missing)}")
            for row in reader:
                if None in row or None in row.values():
                    raise FileFormatError(f"{path}, line {reader.line_num}: wrong number of cells")
                yield reader.line_num, row
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: cannot be read as CSV ({error})") from error


def integer_cell(row: Row, key: str, path: Path, line: int) -> int:
    """Return a cell as an integer; `FileFormatError` names its line."""
    try:
        return int(row[key])
    except ValueError as error:
        raise FileFormatError(f"{path}, line {line}: {key} {row[key]!r} is no number") from error


def float_cell(row: Row, key: str, path: Path, line: int) -> float:
    """Return a cell as a number, nan if it is empty or absent; `FileFormatError` names its line."""
    text = row.get(key, "")
    try:
        return float(text) if text else math.nan
    except ValueError as error:
        raise FileFormatError(f"{path}, line {line}: {key} {text!r} is no number") from error


def covariance_cells(row: Row, path: Path, line: int) -> list[float]:
    """Return the variance xx, xy, yy of a position from sxx, sxy, syy or sigma; nan if not said."""
    if row.get("sigma"):
        sigma = float_cell(row, "sigma", path, line)
        if not 0 < sigma < math.inf:
            raise FileFormatError(f"{path}, line {line}: sigma must be positive")
        return [sigma**2, 0.0, sigma**2]
    xx, xy, yy = (float_cell(row, key, path, line) for key in ("sxx", "sxy", "syy"))
    unsaid = [math.isnan(value) for value in (xx, xy, yy)]
    if not all(unsaid) and (any(unsaid) or not (xx > 0 and math.inf > xx * yy > xy * xy)):
        raise FileFormatError(f"{path}, line {line}: sxx, sxy, syy are no covariance")
    return [xx, xy, yy]

"""Measured colours in place of nominal ones."""

import difflib
import re
from collections.abc import Sequence
from dataclasses import replace

from calichrome.errors import TargetError
from calichrome.target.board import Marker, Target
from calichrome.target.colour_table import PaletteColour

__all__ = ["PAPER_BLACK", "PAPER_WHITE", "measured_target"]

PAPER_WHITE = "paper_white"
PAPER_BLACK = "paper_black"


def measured_target(target: Target, values: Sequence[PaletteColour]) -> Target:
    """Return the target with measured colours.

    Parameters
    ----------
    target
        The board as printed.
    values
        What was measured, as `read_colour_table` returns it. A name is that of a colour (all its
        discs), a square "ix,iy" or a marker id (one disc; these win over the name; an id only if
        no colour of the board is named by a number), or "paper_white", "paper_black".

    Raises
    ------
    TargetError
        If a name is not on the board, or if some discs were measured and others not: colours of
        two origins on one board would bend the fit. Values of the paper alone are welcome.
    """
    rows = {value.name: value for value in values}
    white, black = rows.pop(PAPER_WHITE, None), rows.pop(PAPER_BLACK, None)
    paper = replace(
        target.paper,
        white_xyz_d65=white.xyz_d65 if white else target.paper.white_xyz_d65,
        black_xyz_d65=black.xyz_d65 if black else target.paper.black_xyz_d65,
    )
    if paper.white_xyz_d65 and paper.black_xyz_d65:
        y_white, y_black = paper.white_xyz_d65[1], paper.black_xyz_d65[1]
        if y_white <= y_black:
            raise TargetError(
                f"{PAPER_WHITE} (Y = {y_white * 100:.1f}) is not brighter than {PAPER_BLACK} "
                f"(Y = {y_black * 100:.1f}); exchange the two rows"
            )
    if not rows:
        return replace(target, paper=paper)

    names = {marker.name for marker in target.markers}
    unknown = [name for name in rows if name not in names and _disc(target, name) is None]
    if unknown:
        raise TargetError(_unknown(unknown, names))
    by_disc: dict[int, PaletteColour] = {}
    for name, value in rows.items():
        disc = None if name in names else _disc(target, name)
        if disc is None:
            continue
        if disc in by_disc:
            raise TargetError(
                f"{by_disc[disc].name!r} and {name!r} are the same disc; keep one of the rows"
            )
        by_disc[disc] = value
    measured = [
        by_disc.get(index, rows.get(marker.name)) for index, marker in enumerate(target.markers)
    ]
    missing = [
        marker for marker, value in zip(target.markers, measured, strict=True) if value is None
    ]
    if missing:
        raise TargetError(_missing(missing, len(target.markers)))
    markers = tuple(
        replace(marker, xyz_d65=value.xyz_d65) if value else marker
        for marker, value in zip(target.markers, measured, strict=True)
    )
    return replace(target, markers=markers, paper=paper, colours_measured=True)


def _disc(target: Target, name: str) -> int | None:
    """Return the disc meant by "ix,iy" or by its id."""
    if match := re.fullmatch(r"(\d{1,3})\s*,\s*(\d{1,3})", name, re.ASCII):
        square = int(match[1]), int(match[2])
        found = (index for index, marker in enumerate(target.markers) if marker.square == square)
        return next(found, None)
    # Were colours named 1 to 24 and ids 0 to 23, "1" would mean two discs.
    numbered = any(marker.name.isdigit() for marker in target.markers)
    if re.fullmatch(r"\d{1,5}", name, re.ASCII) and not numbered:
        return int(name) if int(name) < len(target.markers) else None
    return None


def _unknown(unknown: Sequence[str], names: set[str]) -> str:
    described = []
    for name in unknown[:5]:
        near = difflib.get_close_matches(name, [*sorted(names), PAPER_WHITE, PAPER_BLACK], n=2)
        described.append(f"{name!r}" + (f" (meant {' or '.join(near)}?)" if near else ""))
    more = f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""
    return (
        f"not on this board: {', '.join(described)}{more}; name a colour of the board, a square "
        f"that holds a disc as ix,iy, {PAPER_WHITE} or {PAPER_BLACK}"
    )


def _missing(missing: Sequence[Marker], n_discs: int) -> str:
    by_name: dict[str, list[str]] = {}
    for marker in missing:
        by_name.setdefault(marker.name, []).append(f"{marker.square[0]},{marker.square[1]}")
    named = [f"{name} (square {' and '.join(squares)})" for name, squares in by_name.items()]
    more = f" and {len(named) - 6} more colours" if len(named) > 6 else ""
    return (
        f"{len(missing)} of {n_discs} discs have no measured value: {', '.join(named[:6])}{more}; "
        f"measure all discs of the board, or only the paper"
    )

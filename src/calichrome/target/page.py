"""The sheet: which paper, which way up, where the board and the ruler go.

Places are in metres from the lower-left corner of the sheet, y up, as PDF has it.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from calichrome.core.units import parse_lengths
from calichrome.errors import TargetError
from calichrome.target.board import Target

__all__ = [
    "PAPERS_M",
    "STRIP_M",
    "Placing",
    "board_wh_m",
    "parse_paper",
    "place_board",
    "size_mm",
    "smallest_white_margin_m",
]

PAPERS_M = {
    "A4": (0.210, 0.297),
    "letter": (0.2159, 0.2794),
    "tabloid": (0.2794, 0.4318),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
"""Papers by name, metres (ISO 216, ANSI/ASME Y14.1)."""

STRIP_M = 0.017
"""Width of the strip beside the board: ruler, figures, two lines of text."""

_LARGEST_PAGE_M = 14_400 * 0.0254 / 72  # ISO 32000-1, annex C.2
_RULERS_M = (0.200, 0.150, 0.100, 0.050)
_BESIDE_RULER_M = 0.014  # half a figure before it; its unit and the arrow behind it
_SMALLEST_MARGIN_M = 0.006
_MARGIN_SQUARES = 1 / 3

Side = Literal["below", "right"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Placing:
    """Where things are on the sheet, metres.

    Parameters
    ----------
    page_wh
        The sheet, turned as it is printed.
    board_xy
        Lower-left corner of the squares.
    side
        Where the strip with ruler and text is.
    strip_from_to
        Its ends, along x (below) or along y (right).
    ruler
        Length of the ruler.
    white_margin
        From the squares to the nearest ink or edge of the sheet.
    """

    page_wh: tuple[float, float]
    board_xy: tuple[float, float]
    side: Side
    strip_from_to: tuple[float, float]
    ruler: float
    white_margin: float


def parse_paper(text: str) -> tuple[float, float]:
    """Return width and height in metres of "A3" or "600x900mm".

    Raises
    ------
    TargetError
        If it is neither the name of a paper nor a size.
    """
    for name, size in PAPERS_M.items():
        if text.strip().casefold() == name.casefold():
            return size
    try:
        width, height = parse_lengths(text)
    except ValueError as error:
        raise TargetError(
            f"paper {text!r}: write {', '.join(PAPERS_M)} or a size like 600x900mm"
        ) from error
    return width, height


def smallest_white_margin_m(square_m: tuple[float, float]) -> float:
    """Return the white that must stay around the squares.

    The outer black squares are found by their outline against white. At the smallest squares that
    a picture should show, 20 px, a third of a square is 6.7 px: the blur of both edges (2 sigma_psf
    each) and the pixels between which a threshold is taken. 6 mm is what a clip or a fingertip at
    the edge of the sheet covers.
    """
    return max(_MARGIN_SQUARES * max(square_m), _SMALLEST_MARGIN_M)


def board_wh_m(target: Target) -> tuple[float, float]:
    """Return width and height of all squares together, metres."""
    return target.squares[0] * target.square_m[0], target.squares[1] * target.square_m[1]


def size_mm(target: Target) -> str:
    """Return the size of a square as text: "30" or "30 x 29.5"."""
    width, height = (f"{side * 1e3:.6g}" for side in target.square_m)
    return width if width == height else f"{width} x {height}"


def place_board(target: Target, paper_wh: tuple[float, float], edge_m: float) -> Placing:
    """Turn the paper and choose the side of the ruler so that the board keeps most white.

    Parameters
    ----------
    target
        The board.
    paper_wh : (2,) float
        Sides of the sheet in any order, metres.
    edge_m
        Edge that the printer cannot reach, metres. It stays white, so it counts as white margin.

    Raises
    ------
    TargetError
        If the board does not fit, naming the squares and the paper that would; or if there is no
        such sheet.
    """
    if not (min(paper_wh) > 0 and max(paper_wh) <= _LARGEST_PAGE_M):
        raise TargetError(
            f"paper of {paper_wh[0]:g} x {paper_wh[1]:g} m: a PDF page may be up to "
            f"{_LARGEST_PAGE_M:.2f} m long; use a smaller one"
        )
    if not 0 <= edge_m < min(paper_wh) / 2:
        raise TargetError(
            f"a printable margin of {edge_m * 1e3:g} mm leaves nothing of the paper; give the edge "
            f"that the printer cannot reach, usually 5 mm"
        )
    placing = _placing(target, paper_wh, edge_m)
    if placing is None:
        raise TargetError(_does_not_fit(target, paper_wh, edge_m))
    return placing


def _placing(target: Target, paper_wh: tuple[float, float], edge: float) -> Placing | None:
    width, height = board_wh_m(target)
    needed = max(smallest_white_margin_m(target.square_m), edge)
    best: Placing | None = None
    sides: tuple[Side, ...] = ("below", "right")
    for page_wh, side in product(dict.fromkeys([paper_wh, paper_wh[::-1]]), sides):
        below = side == "below"
        strip = edge + STRIP_M
        # The board is in the middle of what the strip leaves.
        margin_x = (page_wh[0] - width - (0 if below else strip)) / 2
        margin_y = (page_wh[1] - height - (strip if below else 0)) / 2
        margin = min(margin_x, margin_y)
        page, start, board = (
            (page_wh[0], margin_x, width) if below else (page_wh[1], margin_y, height)
        )
        rulers = [length for length in _RULERS_M if length + _BESIDE_RULER_M <= page - 2 * edge]
        if margin < needed - 1e-9 or not rulers:
            continue
        if best is None or margin > best.white_margin + 1e-9:
            # The strip is as long as the board; on small boards the ruler makes it longer.
            end = max(start + board, edge + rulers[0] + _BESIDE_RULER_M)
            best = Placing(
                page_wh=page_wh,
                board_xy=(margin_x, margin_y + (strip if below else 0)),
                side=side,
                strip_from_to=(min(start, end - rulers[0] - _BESIDE_RULER_M), end),
                ruler=rulers[0],
                white_margin=margin,
            )
    return best


def _does_not_fit(target: Target, paper_wh: tuple[float, float], edge: float) -> str:
    width, height = board_wh_m(target)
    by_area = sorted(PAPERS_M, key=lambda name: PAPERS_M[name][0] * PAPERS_M[name][1])
    name = next((name for name in by_area if _placing(target, PAPERS_M[name], edge)), None)
    largest = _largest_square_mm(target, paper_wh, edge)
    paper = f"paper {name} holds this board" if name else "no listed paper is large enough"
    return (
        f"{target.squares[0]}x{target.squares[1]} squares of {size_mm(target)} mm are "
        f"{width * 1e3:.0f} x {height * 1e3:.0f} mm and do not fit on paper of "
        f"{paper_wh[0] * 1e3:.0f} x {paper_wh[1] * 1e3:.0f} mm with "
        f"{smallest_white_margin_m(target.square_m) * 1e3:.1f} mm of white around them, a ruler "
        f"beside them, and {edge * 1e3:g} mm that the printer cannot reach; "
        + (f"squares of {largest} fit, {paper}" if largest else paper)
    )


def _largest_square_mm(target: Target, paper_wh: tuple[float, float], edge: float) -> str | None:
    """Return the largest squares that fit, in tenths of a millimetre; None if none does."""

    def scaled(share: float) -> Target:
        square_m = target.square_m[0] * share, target.square_m[1] * share
        return replace(target, square_m=square_m, markers=())

    low, high = 0.0, 1.0  # shares of the asked size; the whole does not fit
    for _ in range(40):
        middle = (low + high) / 2
        fits = _placing(scaled(middle), paper_wh, edge) is not None
        low, high = (middle, high) if fits else (low, middle)
    sides = [np.floor(side * low * 1e4 + 1e-6) / 10 for side in target.square_m]
    if min(sides) < 1:
        return None
    return f"{sides[0]:g}mm" if sides[0] == sides[1] else f"{sides[0]:g}x{sides[1]:g}mm"

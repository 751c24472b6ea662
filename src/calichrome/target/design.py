"""The rules for boards that we print."""

from collections.abc import Sequence
from dataclasses import replace

from calichrome.errors import TargetError
from calichrome.target.board import Marker, SquareColour, Target
from calichrome.target.layout import LayoutQuality, arrange_colours, layout_quality
from calichrome.target.palette import PaletteColour, background_of

__all__ = [
    "LARGEST_DISC_RATIO",
    "SMALLEST_DISC_RATIO",
    "SMALLEST_SQUARE_PX",
    "design_target",
    "smallest_square_px",
]

SMALLEST_SQUARE_PX = 20.0
"""Distance of neighbouring corners, as foreshortened in a picture, down to which a board that we
print keeps its discs out of the corner windows: a 10x9 board 200 px wide."""

_SIGMA_PSF_PX = 1.0
"""Blur of a sharp picture."""

_HALF_WINDOW = 0.18
"""Half width of the window in which the detector refines a corner, in units of that distance."""

LARGEST_DISC_RATIO = 0.62
"""Disc diameter by square size. A window aligned with the picture touches the disc if its half
width w exceeds (0.5 - 0.354 ratio) s; blur takes another 1 + sigma_psf pixels. With w = 0.18 s and
s = 20 px this leaves ratio <= 0.621 (`smallest_square_px` is the same rule, solved for s)."""

SMALLEST_DISC_RATIO = 0.42
"""The 3x3 pixels from which a disc is grown reach 2.1 px from its centre, and the blur of its edge
has died away 2 sigma_psf = 2 px further in: a radius of 4.12 px, at s = 20 px a ratio of 0.412."""

_MOST_ATTEMPTS = 12


def smallest_square_px(disc_ratio: float) -> float:
    """Return the corner distance in pixels from which discs stay out of the corner windows.

    Infinite for discs that reach into them at any size (ratio above 0.9).
    """
    clear = 0.5 - 0.354 * disc_ratio - _HALF_WINDOW
    return (1 + _SIGMA_PSF_PX) / clear if clear > 0 else float("inf")


def design_target(
    *,
    squares: tuple[int, int],
    square_m: tuple[float, float],
    palette: Sequence[PaletteColour],
    disc_ratio: float = 0.5,
    top_left: SquareColour = "black",
    seed: int = 0,
) -> Target:
    """Design a board that can be found, turned the right way up and told apart in parts.

    Parameters
    ----------
    squares : (2,) int
        Squares along x and y.
    square_m : (2,) float
        Width and height of a square, metres.
    palette
        The colours; empty for a plain chessboard.
    disc_ratio
        Diameter of the discs by the shorter side of a square.
    top_left
        Colour of square [0, 0].
    seed
        Equal seeds give equal boards.

    Raises
    ------
    TargetError
        If a rule is broken; the message says what to change.
    """
    board = Target(squares=squares, square_m=square_m, top_left=top_left)
    if not board.has_unique_orientation:
        nx, ny = squares
        kind = "even" if board.corners_xy[0] % 2 == 0 else "odd"
        raise TargetError(
            f"{nx}x{ny} squares have {nx - 1}x{ny - 1} inner corners, both {kind}: such a board "
            f"looks the same after half a turn; print {nx + 1}x{ny} or {nx}x{ny + 1} squares"
        )
    if not palette:
        return board
    _check_ratio(disc_ratio)
    names = [colour.name for colour in palette]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise TargetError(f"the palette names {', '.join(twice)} twice; give colours one name each")

    # The search ends in a different arrangement for every seed; where one takes a tenth of a
    # second, some more are worth their time (docs/decisions/0001-layout-of-colours.md).
    n_squares = squares[0] * squares[1]
    n_attempts = min(max(round(10 * (90 / n_squares) ** 2), 1), _MOST_ATTEMPTS)
    attempts = [
        _with_discs(board, palette, disc_ratio * min(square_m), seed * _MOST_ATTEMPTS + attempt)
        for attempt in range(n_attempts)
    ]
    return max(attempts, key=lambda target: _rank(layout_quality(target)))


def _check_ratio(disc_ratio: float) -> None:
    if disc_ratio > LARGEST_DISC_RATIO:
        raise TargetError(
            f"discs of {disc_ratio:g} of a square reach into the windows in which corners are "
            f"measured, where squares show less than {smallest_square_px(disc_ratio):.0f} px; use "
            f"{LARGEST_DISC_RATIO} or less (good down to {SMALLEST_SQUARE_PX:g} px)"
        )
    if not disc_ratio >= SMALLEST_DISC_RATIO:
        raise TargetError(
            f"discs of {disc_ratio:g} of a square hold too few pixels clear of their blurred edge, "
            f"where squares show {SMALLEST_SQUARE_PX:g} px; use {SMALLEST_DISC_RATIO} or more"
        )


def _with_discs(
    board: Target, palette: Sequence[PaletteColour], diameter_m: float, seed: int
) -> Target:
    backgrounds = [background_of(colour) for colour in palette]
    colour_of_square = arrange_colours(board.black_squares, backgrounds, seed=seed)
    markers = tuple(
        Marker(
            square=(ix, iy),
            name=palette[index].name,
            diameter_m=diameter_m,
            background=backgrounds[index],
            xyz_d65=palette[index].xyz_d65,
        )
        for iy, row in enumerate(colour_of_square.tolist())
        for ix, index in enumerate(row)
        if index >= 0
    )
    return replace(board, markers=markers)


def _rank(quality: LayoutQuality | None) -> tuple[float, ...]:
    if quality is None:
        return ()
    return (
        quality.share_with_enough_discs,
        quality.least_differing,
        quality.least_residual,
        quality.least_presence,
    )

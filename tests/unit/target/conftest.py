"""The palette, read once, and boards without the search for a layout."""

from dataclasses import replace

import pytest

from calichrome.target import Marker, PaletteColour, Target, colour_checker_palette
from calichrome.target.palette import background_of


@pytest.fixture(scope="session")
def palette() -> tuple[PaletteColour, ...]:
    return colour_checker_palette()


@pytest.fixture(scope="session")
def board(palette: tuple[PaletteColour, ...]) -> Target:
    """9x6 squares of 28 mm; every colour on the first free square of its kind."""
    target = Target(squares=(9, 6), square_m=(0.028, 0.028), white_margin_m=0.011)
    squares = [(ix, iy) for iy in range(6) for ix in range(9)]
    markers = []
    for colour in palette:
        kind = background_of(colour)
        square = next(place for place in squares if target.square_colour(*place) == kind)
        squares.remove(square)
        markers.append(
            Marker(
                square=square,
                name=colour.name,
                diameter_m=0.014,
                background=kind,
                xyz_d65=colour.xyz_d65,
            )
        )
    return replace(target, markers=tuple(markers))

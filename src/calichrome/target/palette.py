"""The colours of the discs."""

from pathlib import Path

from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.colorimetry.reference import colour_checker_spectra, reflectance_to_xyz_d65
from calichrome.core.arrays import checked
from calichrome.target.board import SquareColour
from calichrome.target.colour_table import PaletteColour, read_colour_table

__all__ = [
    "DARK_BELOW_L",
    "PaletteColour",
    "background_of",
    "colour_checker_palette",
    "read_palette",
]

DARK_BELOW_L = 50.0
"""L* below which a colour goes on white: half-way between black and paper in lightness, so that
every disc stands out from its square by at least a third of the range."""


def colour_checker_palette() -> tuple[PaletteColour, ...]:
    """Return the 24 colours of the ColorChecker under D65, in the order of the chart.

    Mean reflectances of 30 charts (BabelColor, from colour-science), integrated with the CIE 1931
    2 degree observer. Imports colour-science, which takes a second.
    """
    colours = []
    for name, reflectance in colour_checker_spectra().items():
        x, y, z = map(float, reflectance_to_xyz_d65(reflectance))
        colours.append(PaletteColour(name=name, xyz_d65=(x, y, z)))
    return tuple(colours)


def read_palette(
    path: Path, *, illuminant: str | None = None, observer: str | None = None
) -> tuple[PaletteColour, ...]:
    """Read a palette from CSV; the form is that of `read_colour_table`.

    Raises
    ------
    TargetError
        If the file cannot be read in exactly one way.
    """
    return read_colour_table(path, illuminant=illuminant, observer=observer)


def background_of(colour: PaletteColour) -> SquareColour:
    """Return the kind of square a colour goes on: dark on white, bright on black."""
    xyz = checked(colour.xyz_d65, (3,), "xyz_d65")
    return "white" if lab_from_xyz(xyz)[0] < DARK_BELOW_L else "black"

"""Reflectances in a table: which columns they are, their unit, and the colours they make."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from calichrome.colorimetry.reference import reflectance_to_xyz_d65, resampled_reflectance
from calichrome.errors import TargetError
from calichrome.target.text_table import TextTable, read_number

__all__ = ["spectral_columns", "spectral_xyz_d65"]

_BAND = re.compile(
    r"(?:spectral_?|spec_?|r_?)?(?:nm_?)?(\d{3,4}(?:\.\d+)?)(?:_?nm)?", re.IGNORECASE | re.ASCII
)
_FEWEST = 3  # columns named like wavelengths, below which they are something else
_COVERED_NM = (400.0, 700.0)
"""What must be measured: the observer's weights beyond, under D65, sum to at most 0.2 % of each of
X, Y and Z, so that the last measured value will do."""
_WIDEST_NM = 20.0  # between bands: what ASTM E308 has tables for
_FRACTION, _PERCENT = 1.5, 3.0
"""Largest value of a table in fractions (brightened paper under UV reaches 1.3), and least largest
one in per cent: no print reflects so little everywhere."""
_LOW, _HIGH = -0.01, 1.5  # instruments report black a little below zero

_Triple = tuple[float, float, float]


def spectral_columns(path: Path, header: Sequence[str], *, required: bool) -> dict[int, float]:
    """Return the wavelengths of columns by their place; none where there are no usable spectra.

    Parameters
    ----------
    path
        For errors.
    header
        Titles.
    required
        Whether there is nothing else to read: spectra that do not suffice are then an error.

    Raises
    ------
    TargetError
        If two columns are the same wavelength, or a required spectrum has gaps.
    """
    found = {
        place: float(match[1])
        for place, title in enumerate(header)
        if (match := _BAND.fullmatch(title.strip()))
    }
    if len(found) < _FEWEST:
        return {}
    bands = sorted(found.values())
    for band, following in pairwise(bands):
        if band == following:
            raise TargetError(f"{path}: two columns hold {band:g} nm; remove one")
    widest = max(following - band for band, following in pairwise(bands))
    low, high = _COVERED_NM
    if bands[0] <= low and bands[-1] >= high and widest <= _WIDEST_NM:
        return found
    if required:
        raise TargetError(
            f"{path}: its spectra go from {bands[0]:g} to {bands[-1]:g} nm with steps of up to "
            f"{widest:g} nm; colours need {low:g} to {high:g} nm in steps of {_WIDEST_NM:g} nm or "
            f"less, so measure again, or give XYZ or Lab"
        )
    return {}


def spectral_xyz_d65(path: Path, table: TextTable, bands_nm: dict[int, float]) -> list[_Triple]:
    """Integrate the reflectances of each row under D65 for the 2 degree observer, Y = 1.

    Raises
    ------
    TargetError
        If a value is not a number or no reflectance, or the unit could be either.
    """
    places = sorted(bands_nm, key=bands_nm.__getitem__)
    values = np.array(
        [
            [
                read_number(
                    f"{path}, line {number}, column {table.header[place]}",
                    fields[place],
                    decimal_comma=table.decimal_comma,
                )
                for place in places
            ]
            for number, fields in table.rows
        ]
    )
    largest = float(values.max())
    percent = largest >= _PERCENT if table.percent is None else table.percent
    if table.percent is None and _FRACTION < largest < _PERCENT:
        raise TargetError(
            f"{path}: its largest reflectance is {largest:g}, which may be a fraction or per cent; "
            f"write reflectances as 0 to 1 or 0 to 100, and add a row of the paper"
        )
    reflectance = values / 100 if percent else values
    for row, column in np.argwhere((reflectance < _LOW) | (reflectance > _HIGH)):
        number, place = table.rows[row][0], places[column]
        raise TargetError(
            f"{path}, line {number}, column {table.header[place]}: {values[row, column]:g} is no "
            f"reflectance in {'per cent' if percent else 'fractions of 1'}; correct it"
        )
    wavelengths_nm = np.array([bands_nm[place] for place in places])
    found = reflectance_to_xyz_d65(resampled_reflectance(wavelengths_nm, reflectance))
    return [(float(x), float(y), float(z)) for x, y, z in found]

"""CSV files of colours, as instruments, spreadsheets and hands write them."""

from pathlib import Path

import numpy as np
import pytest

from calichrome.errors import TargetError
from calichrome.target import PaletteColour, read_colour_table, read_palette

Xyz = tuple[float, float, float]
RED = (0.2018, 0.1183, 0.0520)


def _read(
    tmp_path: Path, text: str | bytes, illuminant: str | None = None, observer: str | None = None
) -> tuple[PaletteColour, ...]:
    path = tmp_path / "colours.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_colour_table(path, illuminant=illuminant, observer=observer)


@pytest.mark.parametrize(
    "text",
    [
        "name,X,Y,Z,illuminant,observer\nred,20.18,11.83,5.20,D65,2\n",
        "name;X;Y;Z;illuminant;observer\r\nred;20,18;11,83;5,2;d65;2°\r\n",
        "\ufeffName\tXYZ_X\tXYZ_Y\tXYZ_Z\tIlluminant\tObserver\nred\t20,18\t11.83\t5.2\tD65\t2°\n",
        "observer,id,Z,Y,X,name,illuminant\n\nCIE 1931 2 deg,7,5.2,1.183e1,20.18, red ,CIE D65\n",
        'name,X,Y,Z,L,a,b,illuminant,observer\n"red",20.18,11.83,5.2,0,0,0,D65,1931\n',
    ],
    ids=["plain", "decimal commas", "instrument", "other order", "XYZ before Lab"],
)
def test_ways_to_write_the_same_colour(tmp_path: Path, text: str) -> None:
    (colour,) = _read(tmp_path, text)
    assert colour.name == "red"
    assert colour.xyz_d65 == pytest.approx(RED, abs=1e-12)


def test_what_is_stated_once_holds_for_rows_that_do_not_say_it(tmp_path: Path) -> None:
    text = "name,X,Y,Z,illuminant\na,20,21,22,D65\nb,20,21,22,\n"
    a, b = _read(tmp_path, text, "D65", "2")
    assert a.xyz_d65 == b.xyz_d65 == pytest.approx((0.20, 0.21, 0.22))


@pytest.mark.parametrize("white_name", ["D50", "D65"])
def test_lab_against_colour_science(
    tmp_path: Path, rng: np.random.Generator, white_name: str
) -> None:
    import colour

    white = {"D50": [0.96422, 1.0, 0.82521], "D65": [0.95047, 1.0, 1.08883]}
    lab = np.column_stack([rng.uniform(25, 95, 20), rng.uniform(-25, 25, (20, 2))])
    rows = [f"c{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(lab.tolist())]
    read = _read(tmp_path, "name,L*,a*,b*\n" + "\n".join(rows), white_name, "2")
    xyz = colour.Lab_to_XYZ(lab, colour.XYZ_to_xy(white[white_name]))
    xyz = colour.chromatic_adaptation(
        xyz, white[white_name], white["D65"], method="Von Kries", transform="Bradford"
    )
    # their Bradford matrix and whites from chromaticities carry four to five digits
    np.testing.assert_allclose([colour.xyz_d65 for colour in read], xyz, atol=2e-5)


@pytest.mark.parametrize("illuminant", [None, "", "A", "D55", "F11", "TL84"])
def test_other_lights_are_refused(tmp_path: Path, illuminant: str | None) -> None:
    with pytest.raises(
        TargetError, match=r"line 2: .*(not stated.*column|without the spectra.*D50)"
    ):
        _read(tmp_path, "name,X,Y,Z\na,20,21,22\n", illuminant, "2")


@pytest.mark.parametrize("observer", [None, "10", "10°", "CIE 1964", "3", "CIE"])
def test_other_observers_are_refused(tmp_path: Path, observer: str | None) -> None:
    with pytest.raises(TargetError, match=r"line 2: .*observer.*(not stated|without the spectra)"):
        _read(tmp_path, "name,X,Y,Z\na,20,21,22\n", "D65", observer)


def test_a_row_that_contradicts_what_was_given_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match=r"line 2: illuminant D50 here, but D65"):
        _read(tmp_path, "name,X,Y,Z,illuminant\na,20,21,22,D50\n", "D65", "2")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("\n \n", "is empty"),
        ("name,X,Y,Z\n", "no colours"),
        ("name,X,Y\na,1,2\n", "first line must name"),
        ("20.1,21.2,22.3\n", "first line must name"),
        ("name,X,Y,Z,Y\na,20,21,22,21\n", "two columns"),
        ("name,X,Y,Z\na,20,21\n", "line 2: 3 values under 4 columns"),
        ("name,X,Y,Z\na,20,1,21,2,22,3\n", "line 2: 7 values.*decimal commas"),
        ("name,X,Y,Z\na,20,21,22\na,20,21,22\n", "line 3, column name: a stands there twice"),
        ("name,X,Y,Z\n,20,21,22\n", "line 2, column name"),
        (f"name,X,Y,Z\n{'a' * 201},20,21,22\n", "line 2, column name"),
        ("name,X,Y,Z\na,20,,22\n", "line 2, column Y: is empty"),
        ("name,X,Y,Z\na,20,nan,22\n", "line 2, column Y: 'nan' is not a number"),
        ("name,X,Y,Z\na,20,21,inf\n", "line 2, column Z: 'inf' is not a number"),
        ("name,X,Y,Z\na,2_0,21,22\n", "line 2, column X: '2_0' is not a number"),
        ("name,X,Y,Z\na,20,1e999,22\n", "line 2, column Y: inf is not between"),
        ("name;X;Y;Z\na;1.020,5;21;22\n", "line 2, column X: '1.020,5' is not a number"),
        ("name,X,Y,Z\na,-3,21,22\n", "line 2, column X: -3 is not between 0 and 200"),
        ("name,L,a,b\na,150,0,0\n", "line 2, column L: 150 is not between"),
        ("name,L,a,b\na,50,0,300\n", "line 2, column b: 300 is not between"),
        ("name,L,a,b\na,5,0,90\n", "negative light"),
        ("name,X,Y,Z\na,0.2,0.21,0.22\nb,0.9,1,1.1\n", "multiply XYZ"),
        ("name,L,a,b\na,0.5,0,0\n", "multiply XYZ"),
        ('name,X,Y,Z\n"a,20,21,22\n', "line 2: is not CSV"),
        (b"name,X,Y,Z\n\xff,20,21,22\n", "not UTF-8"),
        (b"name,X,Y,Z\na\x00,20,21,22\n", "line 2"),
        ("name,X,Y,Z\n" + "a,20,21,22\n" * 95_000, "no table of colours"),
        ("name,X,Y,Z\n" + "a,2,2,2\n" * 10_001, "more than 10000 rows"),
    ],
)
def test_what_cannot_be_read_in_one_way_is_refused(
    tmp_path: Path, text: str | bytes, says: str
) -> None:
    with pytest.raises(TargetError, match=says):
        _read(tmp_path, text, "D65", "2")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match=r"none\.csv: cannot be read"):
        read_palette(tmp_path / "none.csv")
    with pytest.raises(TargetError, match="cannot be read"):
        read_palette(tmp_path)


def test_the_colour_checker_has_the_values_of_its_makers(
    palette: tuple[PaletteColour, ...],
) -> None:
    import colour

    from calichrome.colorimetry.difference import delta_e_2000, lab_from_xyz

    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    assert len(palette) == len(chart.data) == 24
    published = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
    published = colour.chromatic_adaptation(
        published, colour.xy_to_XYZ(chart.illuminant), [0.95047, 1.0, 1.08883]
    )
    ours = np.array([colour.xyz_d65 for colour in palette])
    differences = delta_e_2000(lab_from_xyz(published), lab_from_xyz(ours))
    # Another production, and adapted from D50 instead of integrated under D65; two patches
    # exchanged would differ by 10 or more.
    assert float(differences.mean()) < 2
    assert float(differences.max()) < 5

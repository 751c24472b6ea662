"""Tables of instruments: CGATS, ArgyllCMS's .ti3, and spectra."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.difference import delta_e_2000_xyz, lab_from_xyz, xyz_from_lab
from calichrome.colorimetry.reference import colour_checker_spectra
from calichrome.core.arrays import FloatArray
from calichrome.errors import TargetError
from calichrome.target import PaletteColour, read_colour_table, read_palette

BANDS = tuple(range(380, 731, 10))
TI3 = """CTI3

DESCRIPTOR "Argyll Calibration Target chart information 3"
ORIGINATOR "Argyll chartread"
KEYWORD "DEVICE_CLASS"
DEVICE_CLASS "OUTPUT"
KEYWORD "COLOR_REP"
COLOR_REP "RGB_XYZ"

NUMBER_OF_FIELDS 8
BEGIN_DATA_FORMAT
SAMPLE_ID SAMPLE_LOC RGB_R RGB_G RGB_B XYZ_X XYZ_Y XYZ_Z
END_DATA_FORMAT

NUMBER_OF_SETS 2
BEGIN_DATA
red "A1" 100.00 0.0000 0.0000 30.50 17.25 4.75
paper_white "A2" 100.00 100.00 100.00 84.50 87.75 71.25
END_DATA
"""
XRITE = (
    'CGATS.17\r\nORIGINATOR\t""\r\nDESCRIPTOR\t"Output Characterisation"\r\n'
    'CREATED\t"10/17/2005"  # Time: 15:24\r\n'
    'MEASUREMENT_SOURCE\t""Illumination=D50\tObserverAngle=2°\tWhiteBase=Abs\tFilter=No""\r\n'
    "KEYWORD\tSAMPLE_NAME\r\nNUMBER_OF_FIELDS\t4\r\n"
    "BEGIN_DATA_FORMAT\r\nSampleID\tSAMPLE_NAME\tLAB_L\tLAB_A\tLAB_B\r\nEND_DATA_FORMAT\r\n"
    "NUMBER_OF_SETS\t1\r\nBEGIN_DATA\r\n"
    "1\tdark skin\t38,02\t11,80\t13,66\t\r\n2\tpaper_white\t95,10\t0,00\t-2,00\t\r\nEND_DATA\r\n"
)


def _read(
    tmp_path: Path,
    text: str | bytes,
    illuminant: str | None = None,
    observer: str | None = None,
    name: str = "values.txt",
) -> dict[str, FloatArray]:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    read = read_colour_table(path, illuminant=illuminant, observer=observer)
    return {colour.name: np.array(colour.xyz_d65) for colour in read}


def _cgats(
    fields: Sequence[str], rows: Sequence[str], keywords: str = "", head: str = "CGATS.17"
) -> str:
    lines = [head, keywords, f"NUMBER_OF_FIELDS {len(fields)}", "BEGIN_DATA_FORMAT"]
    lines += [" ".join(fields), "END_DATA_FORMAT", f"NUMBER_OF_SETS {len(rows)}", "BEGIN_DATA"]
    return "\n".join([*lines, *rows, "END_DATA", ""])


def _spectra() -> Mapping[str, FloatArray]:
    """The ColorChecker at 380, 390 ... 730 nm."""
    return {name: values[:71:2] for name, values in colour_checker_spectra().items()}


def test_a_ti3_is_for_d50_by_its_own_definition(tmp_path: Path) -> None:
    read = _read(tmp_path, TI3, name="print.ti3")
    assert list(read) == ["red", "paper_white"]
    expected = adapt(np.array([[0.305, 0.1725, 0.0475], [0.845, 0.8775, 0.7125]]), D50, D65)
    np.testing.assert_allclose(list(read.values()), expected, atol=1e-12)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_tabs_decimal_commas_and_wrong_counts(tmp_path: Path, encoding: str) -> None:
    read = _read(tmp_path, XRITE.encode(encoding))
    expected = adapt(xyz_from_lab(np.array([38.02, 11.80, 13.66]), D50), D50, D65)
    np.testing.assert_allclose(read["dark skin"], expected, atol=1e-12)
    assert len(read) == 2


@pytest.mark.parametrize(
    ("keywords", "illuminant"),
    [
        ('WEIGHTING_FUNCTION "ILLUMINANT, D50"\nWEIGHTING_FUNCTION "OBSERVER, 2 degree"', "D50"),
        ('ILLUMINATION_NAME "D65"\nOBSERVER_ANGLE "2"', "D65"),
        ('ILLUMINANT "D50 2 degree"', "D50"),
        ("ILLUMINANT D65\nOBSERVER CIE 1931", "D65"),
        ('MEASUREMENT_SOURCE "Illumination=D50 ObserverAngle=2 WhiteBase=Abs"', "D50"),
    ],
)
def test_light_and_observer_by_keyword(tmp_path: Path, keywords: str, illuminant: str) -> None:
    fields = ("SAMPLE_NAME", "LAB_L", "LAB_A", "LAB_B")
    read = _read(tmp_path, _cgats(fields, ["a 50 10 -20"], keywords))
    stated = _read(tmp_path, _cgats(fields, ["a 50 10 -20"]), illuminant, "2")
    np.testing.assert_array_equal(read["a"], stated["a"])


def test_light_and_observer_are_never_guessed(tmp_path: Path) -> None:
    text = _cgats(("SAMPLE_NAME", "LAB_L", "LAB_A", "LAB_B"), ["a 50 10 -20"])
    with pytest.raises(TargetError, match="line 9: the illuminant is not stated"):
        _read(tmp_path, text)
    # in newer files this keyword names the lamp of the instrument, not the one calculated with
    text = text.replace("CGATS.17\n", 'CGATS.17\nMEASUREMENT_SOURCE "D50"\n')
    with pytest.raises(TargetError, match="illuminant is not stated"):
        _read(tmp_path, text, observer="2")


@pytest.mark.parametrize("title", ["SPECTRAL_NM{}", "nm{}", "SPEC_{}", "NM_{}", "R_{}", "{}"])
@pytest.mark.parametrize("unit", [1, 100])
def test_spectra_make_what_colour_science_makes(tmp_path: Path, title: str, unit: int) -> None:
    """Also where Lab stands beside them: of spectra nothing has to be assumed."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(observer.shape)
    spectra = _spectra()
    rows = [
        f'"{name}" 50 0 0 ' + " ".join(f"{unit * value:.6f}" for value in values)
        for name, values in spectra.items()
    ]
    fields = ("SAMPLE_NAME", "LAB_L", "LAB_A", "LAB_B", *(title.format(band) for band in BANDS))
    read = _read(tmp_path, _cgats(fields, rows))
    expected = [
        colour.sd_to_XYZ(
            colour.SpectralDistribution(dict(zip(BANDS, values, strict=True))).align(
                observer.shape
            ),
            observer,
            light,
            method="Integration",
        )
        / 100
        for values in spectra.values()
    ]
    differences = delta_e_2000_xyz(np.array(list(read.values())), np.array(expected))
    # Sprague's interpolation and steps of 1 nm there, a spline and 5 nm here
    assert float(differences.max()) < 0.05


def test_spectra_in_csv_with_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    spectra = _spectra()
    rows = [
        ";".join([name, *(f"{value:.6f}".replace(".", ",") for value in values)])
        for name, values in spectra.items()
    ]
    text = "\n".join([";".join(["patch", *map(str, BANDS)]), *rows])
    path = tmp_path / "palette.csv"
    path.write_text(text, encoding="utf-8")
    read = read_palette(path)
    from_text = _read(
        tmp_path,
        _cgats(
            ("SAMPLE_NAME", *(f"nm{band}" for band in BANDS)),
            [f"{name} " + " ".join(f"{v:.6f}" for v in values) for name, values in spectra.items()],
        ),
    )
    assert isinstance(read[0], PaletteColour)
    np.testing.assert_array_equal([item.xyz_d65 for item in read], list(from_text.values()))


def test_flat_spectra_are_grey(tmp_path: Path) -> None:
    """A law of the integral, whatever the steps and the range: Y is the reflectance."""
    for bands in (range(400, 701, 20), range(360, 831, 5)):
        text = "patch," + ",".join(map(str, bands)) + "\na" + ",0.42" * len(bands)
        xyz = _read(tmp_path, text, name="grey.csv")["a"]
        assert float(xyz[1]) == pytest.approx(0.42, abs=1e-12)
        np.testing.assert_allclose(lab_from_xyz(xyz)[1:], 0, atol=0.02)


@pytest.mark.parametrize("edition", ["ccsg_ref.cie", "ccsg_ref-new.cie"])
def test_a_published_file_agrees_with_itself(data: Path, edition: str, tmp_path: Path) -> None:
    """Its spectra, integrated, against its XYZ under D50, adapted.

    Under D50 the two differ by 0.01 dE at most, so that what is left is the adaptation.
    """
    path = data / "spectral" / "reflectance" / edition
    read = np.array([item.xyz_d65 for item in read_colour_table(path)])
    text = path.read_text(encoding="utf-8").replace("SPEC_", "IGNORED_")
    adapted = np.array(list(_read(tmp_path, text).values()))
    assert len(read) == len(adapted) == 140
    differences = delta_e_2000_xyz(read, adapted)
    assert 0.1 < float(differences.mean()) < 0.7
    assert float(differences.max()) < 2.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (TI3.replace("END_DATA\n", "", 1), "ends without END_DATA; it was cut off"),
        (TI3.partition("END_DATA_FORMAT")[0], "ends without END_DATA_FORMAT"),
        (TI3.replace('red "A1"', "red"), "line 17: 7 values for 8 fields.*tabs"),
        (TI3.replace('red "A1"', "deep red A1"), "line 17: 9 values for 8 fields.*quotes"),
        (TI3.replace("30.50", "abc"), "line 17, column X: 'abc' is not a number"),
        (TI3.replace('"OUTPUT"', '"DISPLAY"'), "line 6: holds light of a DISPLAY"),
        (TI3.replace("paper_white", "red"), "line 18, column name: red stands there twice"),
        (TI3.replace("SAMPLE_ID SAMPLE_LOC", "SAMPLES PLACES"), "must name the columns name"),
        (TI3.replace("XYZ_Z", "XYZ_Y"), "two columns are called 'XYZ_Y'"),
        (TI3.replace("DESCRIPTOR", 'ILLUMINANT "D50"\nILLUMINANT "D65"\nDESCRIPTOR'), "more than"),
        (_cgats((), []), "names 0 fields"),
        (_cgats(("X" * 3,) * 2001, []), "names 2001 fields"),
        (_cgats(("SAMPLE_ID", "XYZ_X", "XYZ_Y", "XYZ_Z"), ["1 2 3 4"] * 10_001), "more than 10000"),
        ("patch,400,410,420\na,0.1,0.1,0.1", "400 to 420 nm.*400 to 700 nm"),
        ("patch,400,500,600,700\na,0.1,0.1,0.1,0.1", "steps of up to 100 nm"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(TargetError, match=says):
        _read(tmp_path, text)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ("2.0", "fraction or per cent"),
        ("180", "line 2, column nm400: 180 is no reflectance in per cent"),
        ("-4 0.5", "line 2, column nm400: -4 is no reflectance in fractions"),
        ("nan", "line 2, column nm400: 'nan' is not a number"),
    ],
)
def test_what_is_no_reflectance_is_named(tmp_path: Path, values: str, says: str) -> None:
    bands = range(400, 701, 10)
    cells = (values.split() * 31)[:31]
    text = "name;" + ";".join(f"nm{band}" for band in bands) + "\na;" + ";".join(cells)
    with pytest.raises(TargetError, match=says):
        _read(tmp_path, text)


def test_spectra_with_gaps_give_way_to_values(tmp_path: Path) -> None:
    read = _read(tmp_path, "name,X,Y,Z,400,500,600\na,20,21,22,0.1,0.1,0.1", "D65", "2")
    np.testing.assert_allclose(read["a"], [0.20, 0.21, 0.22])


def test_the_same_wavelength_twice_is_refused(tmp_path: Path) -> None:
    bands = [*range(400, 701, 10), 700.0]
    text = "name," + ",".join(f"{band}" for band in bands) + "\na" + ",0.1" * len(bands)
    with pytest.raises(TargetError, match="two columns hold 700 nm"):
        _read(tmp_path, text)

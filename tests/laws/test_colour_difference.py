"""CIELAB and CIEDE2000: the published table, symmetry, and colour-science as oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calichrome.colorimetry.adaptation import D50, D65
from calichrome.colorimetry.difference import (
    delta_e_2000,
    delta_e_2000_xyz,
    lab_from_xyz,
    xyz_from_lab,
    xyz_per_lab,
)
from calichrome.colorimetry.reference import _colour
from calichrome.core.arrays import FloatArray

Lab = tuple[float, float, float]

# G. Sharma, W. Wu, E. N. Dalal, "The CIEDE2000 Color-Difference Formula: Implementation Notes,
# Supplementary Test Data, and Mathematical Observations", Color Res. Appl. 30 (1), 2005, table 1
SHARMA_2005: list[tuple[Lab, Lab, float]] = [
    ((50.0000, 2.6772, -79.7751), (50.0000, 0.0000, -82.7485), 2.0425),
    ((50.0000, 3.1571, -77.2803), (50.0000, 0.0000, -82.7485), 2.8615),
    ((50.0000, 2.8361, -74.0200), (50.0000, 0.0000, -82.7485), 3.4412),
    ((50.0000, -1.3802, -84.2814), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, -1.1848, -84.8006), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, -0.9009, -85.5211), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, 0.0000, 0.0000), (50.0000, -1.0000, 2.0000), 2.3669),
    ((50.0000, -1.0000, 2.0000), (50.0000, 0.0000, 0.0000), 2.3669),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0009), 7.1792),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0010), 7.1792),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0011), 7.2195),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0012), 7.2195),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0009, -2.4900), 4.8045),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0010, -2.4900), 4.8045),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0011, -2.4900), 4.7461),
    ((50.0000, 2.5000, 0.0000), (50.0000, 0.0000, -2.5000), 4.3065),
    ((50.0000, 2.5000, 0.0000), (73.0000, 25.0000, -18.0000), 27.1492),
    ((50.0000, 2.5000, 0.0000), (61.0000, -5.0000, 29.0000), 22.8977),
    ((50.0000, 2.5000, 0.0000), (56.0000, -27.0000, -3.0000), 31.9030),
    ((50.0000, 2.5000, 0.0000), (58.0000, 24.0000, 15.0000), 19.4535),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.1736, 0.5854), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.2972, 0.0000), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 1.8634, 0.5757), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.2592, 0.3350), 1.0000),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
    ((61.2901, 3.7196, -5.3901), (61.4292, 2.2480, -4.9620), 1.8731),
    ((35.0831, -44.1164, 3.7933), (35.0232, -40.0716, 1.5901), 1.8645),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((36.4612, 47.8580, 18.3852), (36.2715, 50.5065, 21.2231), 1.4146),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((90.9257, -0.5406, -0.9208), (88.6381, -0.8985, -0.7239), 1.5381),
    ((6.7747, -0.2908, -2.4247), (5.8714, -0.0985, -2.2286), 0.6377),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]

labs = st.tuples(st.floats(0, 100), st.floats(-100, 100), st.floats(-100, 100)).map(np.array)


@pytest.mark.parametrize(("lab_a", "lab_b", "expected"), SHARMA_2005)
def test_delta_e_2000_as_published(lab_a: Lab, lab_b: Lab, expected: float) -> None:
    found = delta_e_2000(np.array(lab_a), np.array(lab_b))
    assert found == pytest.approx(expected, abs=5e-5)  # printed to four decimals


def test_the_table_is_whole() -> None:
    assert len(SHARMA_2005) == 34


@given(lab_a=labs, lab_b=labs)
def test_delta_e_2000_is_symmetric(lab_a: FloatArray, lab_b: FloatArray) -> None:
    hues = np.degrees([np.arctan2(lab[2], lab[1]) for lab in (lab_a, lab_b)])
    if abs(abs(hues[0] - hues[1]) - 180) < 10:
        return  # the formula jumps at opposite hues (Sharma 2005, section "discontinuities")
    there, back = delta_e_2000(lab_a, lab_b), delta_e_2000(lab_b, lab_a)
    assert there == pytest.approx(back, abs=1e-9)


@given(lab=labs)
def test_no_colour_differs_from_itself(lab: FloatArray) -> None:
    assert delta_e_2000(lab, lab) == 0


@pytest.mark.parametrize("spread", [0.5, 5.0, 50.0])
def test_colour_science_agrees_on_delta_e(spread: float, rng: np.random.Generator) -> None:
    lab_a = rng.uniform([0, -100, -100], [100, 100, 100], (20_000, 3))
    lab_b = lab_a + rng.normal(0, spread, lab_a.shape)
    expected = _colour().delta_E(lab_a, lab_b, method="CIE 2000")
    np.testing.assert_allclose(delta_e_2000(lab_a, lab_b), expected, atol=1e-9)


def test_shapes_broadcast() -> None:
    lab = np.full((4, 5, 3), 10.0)
    assert delta_e_2000(lab, np.array([50.0, 10, 12])).shape == (4, 5)


@given(lab=hnp.arrays(np.float64, (5, 3), elements=st.floats(-100, 100)))
@pytest.mark.parametrize("white", [D65, D50], ids=["D65", "D50"])
def test_lab_and_xyz_are_inverse(white: FloatArray, lab: FloatArray) -> None:
    # also beyond real colours: corrected pictures hold some; the cubic loses nothing
    np.testing.assert_allclose(lab_from_xyz(xyz_from_lab(lab, white), white), lab, atol=1e-10)


@pytest.mark.parametrize("white", [D65, D50], ids=["D65", "D50"])
def test_colour_science_agrees_on_lab(white: FloatArray, rng: np.random.Generator) -> None:
    colour = _colour()
    xyz = rng.uniform(0, 1.1, (5000, 3)) ** 3  # many dark ones, on both branches
    white_xy = colour.XYZ_to_xy(white)
    found = lab_from_xyz(xyz, white)
    # it takes the white as chromaticity, scaled to Y = 1, as ours is
    np.testing.assert_allclose(found, colour.XYZ_to_Lab(xyz, white_xy), atol=1e-9)
    np.testing.assert_allclose(xyz, colour.Lab_to_XYZ(found, white_xy), atol=1e-11)


@pytest.mark.parametrize("white", [D65, D50], ids=["D65", "D50"])
def test_slopes_of_xyz_are_finite_differences(white: FloatArray, rng: np.random.Generator) -> None:
    xyz = rng.uniform(0, 1.1, (500, 3)) ** 3
    lab, step = lab_from_xyz(xyz, white), 1e-5
    columns = [
        (xyz_from_lab(lab + axis, white) - xyz_from_lab(lab - axis, white)) / (2 * step)
        for axis in step * np.eye(3)
    ]
    np.testing.assert_allclose(xyz_per_lab(xyz, white), np.stack(columns, axis=-1), atol=1e-8)


def test_white_and_black() -> None:
    np.testing.assert_allclose(lab_from_xyz(D65), [100, 0, 0], atol=1e-12)
    np.testing.assert_allclose(lab_from_xyz(np.zeros(3)), 0, atol=1e-12)
    # CIE 15: Y = 18.42 % is L* = 50 (from (66 / 116)^3)
    assert lab_from_xyz(0.18418651851244416 * D65)[0] == pytest.approx(50, abs=1e-10)


def test_differences_of_xyz_are_taken_under_d65(rng: np.random.Generator) -> None:
    xyz_a, xyz_b = rng.uniform(0.1, 0.9, (2, 10, 3))
    expected = delta_e_2000(lab_from_xyz(xyz_a, D65), lab_from_xyz(xyz_b, D65))
    np.testing.assert_array_equal(delta_e_2000_xyz(xyz_a, xyz_b), expected)

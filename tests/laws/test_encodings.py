"""Transfer functions: exact inverses, no jumps, and the published numbers."""

import json

import numpy as np
import pytest

from calichrome.colorimetry.encoding import (
    ENCODINGS,
    EncodingName,
    ToneCurve,
    encode,
    linear_table,
    linearise,
)
from calichrome.core.arrays import FloatArray

names = pytest.mark.parametrize("name", list(ENCODINGS))


def _stored() -> FloatArray:
    """All 16-bit values, and doubles around the joints of sRGB and Rec. 709."""
    joints = np.array([0.04045, 0.0812428582986315, 0.0031308, 0.018053968510807])
    around = np.add.outer([-1e-6, 0, 1e-6], joints)
    return np.sort(np.concatenate([np.arange(65536) / 65535, around.ravel()]))


# The two joints of sRGB, as printed, do not quite meet: 3e-8 of full scale.
_JOINT = 1e-7


@names
def test_encode_undoes_linearise(name: EncodingName) -> None:
    values = _stored()
    np.testing.assert_allclose(encode(linearise(values, name), name), values, atol=_JOINT)
    away = np.abs(values - 0.04045) > 1e-3
    found = encode(linearise(values[away], name), name)
    np.testing.assert_allclose(found, values[away], atol=1e-14)


@names
def test_linearise_undoes_encode(name: EncodingName) -> None:
    values = _stored()
    np.testing.assert_allclose(linearise(encode(values, name), name), values, atol=_JOINT)
    away = np.abs(values - 0.0031308) > 1e-3
    found = linearise(encode(values[away], name), name)
    np.testing.assert_allclose(found, values[away], atol=1e-14)


@names
def test_no_jumps_and_no_turns(name: EncodingName) -> None:
    values = _stored()
    for curve in (ENCODINGS[name].linearise, ENCODINGS[name].encode):
        assert curve(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=1e-12)
        assert (np.diff(curve(values)) >= 0).all()
    step = np.diff(linearise(np.arange(65536) / 65535, name))
    # the steepest slope is 2.4; a jump of half a 16-bit step more would show
    assert step.max() < 3 / 65535


@pytest.mark.parametrize(
    ("stored", "linear"),
    [
        # IEC 61966-2-1: 1.055 L^(1/2.4) - 0.055 from L = 0.0031308, 12.92 L below
        (0.7353569830524495, 0.5),
        (10 / 255, 10 / 255 / 12.92),
        (0.5, 0.21404114048223255),
        (128 / 255, 0.21586050011389926),
    ],
)
def test_srgb_values(stored: float, linear: float) -> None:
    assert linearise(np.array(stored), "srgb") == pytest.approx(linear, abs=1e-12)
    assert encode(np.array(linear), "srgb") == pytest.approx(stored, abs=1e-12)


@pytest.mark.parametrize(
    ("stored", "linear"),
    [
        # ITU-R BT.709-6, item 1.2: 1.099 L^0.45 - 0.099 from L = 0.018, 4.5 L below
        (1.099 * 0.18**0.45 - 0.099, 0.18),
        (1.099 * 0.5**0.45 - 0.099, 0.5),
        (0.045, 0.01),
        (0.081, 0.018),
        (1.0, 1.0),
    ],
)
def test_rec709_values(stored: float, linear: float) -> None:
    # Its constants are rounded; with the exact ones (BT.2020-2) values move by less than 3e-4,
    # a twelfth of an 8-bit step.
    assert encode(np.array(linear), "rec709") == pytest.approx(stored, abs=3e-4)
    assert linearise(np.array(stored), "rec709") == pytest.approx(linear, abs=3e-4)


def test_negative_light_stays_on_the_foot() -> None:
    values = np.array([-0.01, -1e-4])
    np.testing.assert_allclose(encode(values, "srgb"), 12.92 * values)
    np.testing.assert_allclose(linearise(12.92 * values, "srgb"), values)
    np.testing.assert_allclose(encode(values, "rec709"), 4.5 * values)


def _curve() -> ToneCurve:
    stored = np.arange(65) / 64
    powers = np.stack([stored**1.8, stored**2.2, 0.1 * stored + 0.9 * stored**3], axis=1)
    return ToneCurve.from_table(stored, 5 * powers)


def test_a_table_is_undone_by_its_inverse() -> None:
    curve = _curve()
    values = np.stack([np.arange(1001) / 1000] * 3, axis=-1)
    np.testing.assert_allclose(curve.encode(curve.linearise(values)), values, atol=1e-12)
    np.testing.assert_allclose(linearise(encode(values, curve), curve), values, atol=1e-12)
    assert curve.linearise(np.ones(3)) == pytest.approx([1, 1, 1])


def test_a_table_survives_its_file() -> None:
    curve = _curve()
    again = ToneCurve.from_json(json.loads(json.dumps(curve.to_json())))
    np.testing.assert_array_equal(again.linear, curve.linear)
    np.testing.assert_array_equal(again.sigma, curve.sigma)


@pytest.mark.parametrize("encoding", ["srgb", "linear", _curve()])
def test_linear_tables_hold_every_number(encoding: EncodingName | ToneCurve) -> None:
    table = linear_table(encoding, 255)
    number = np.array([[3, 77, 255], [0, 128, 254]])
    expected = linearise(number / 255, encoding)
    np.testing.assert_allclose(table[number, np.arange(3)], expected, atol=1e-15)


@pytest.mark.parametrize(
    ("stored", "linear"),
    [([0, 0.5, 0.9], [0, 1, 2]), ([0, 0.5, 0.5, 1], [0, 1, 2, 3]), ([0, 0.5, 1], [0, 0, 1])],
    ids=["not up to 1", "not increasing", "flat"],
)
def test_tables_that_are_no_curves_are_refused(stored: list[float], linear: list[float]) -> None:
    with pytest.raises(ValueError, match="increase"):
        ToneCurve.from_table(np.array(stored), np.array(linear))

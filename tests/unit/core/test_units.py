import pytest
from hypothesis import given
from hypothesis import strategies as st

from calichrome.core.units import parse_duration, parse_length, parse_lengths


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("30mm", 0.03), ("3cm", 0.03), ("0.03m", 0.03), ("1.2in", 0.03048), (" 39.7 mm ", 0.0397),
        (".5in", 0.0127), ("3e1mm", 0.03), ("3E-2m", 0.03),
    ],
)  # fmt: skip
def test_lengths_are_read_in_metres(text: str, metres: float) -> None:
    assert parse_length(text) == metres  # as typed, to the last digit


@given(millimetres=st.floats(1e-3, 1e6))
def test_units_agree(millimetres: float) -> None:
    metres = pytest.approx(millimetres * 1e-3, rel=2e-14)  # lengths keep 15 digits
    assert parse_length(f"{millimetres!r}mm") == metres
    assert parse_length(f"{millimetres / 10!r}cm") == metres
    assert parse_length(f"{millimetres / 25.4!r}in") == metres


@pytest.mark.parametrize("text", ["30", "0.03", " 5 "])
def test_bare_numbers_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="has no unit"):
        parse_length(text)


@pytest.mark.parametrize("text", ["", "mm", "-3mm", "3 miles", "3mmm", "3,5mm", "nanmm", "1e5000m"])
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a"):
        parse_length(text)


def test_nothing_is_no_length() -> None:
    with pytest.raises(ValueError, match="not a positive length"):
        parse_length("0mm")


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("39.7mm", (0.0397, 0.0397)),
        ("39.7x39.9mm", (0.0397, 0.0399)),
        ("39.7mmx3.99cm", (0.0397, 0.0399)),
        ("1 x 2in", (0.0254, 0.0508)),
    ],
)
def test_two_lengths(text: str, metres: tuple[float, float]) -> None:
    assert parse_lengths(text) == metres


@pytest.mark.parametrize("text", ["39.7x39.9", "39.7mmx39.9", "3x4x5mm", "xmm"])
def test_two_lengths_need_a_unit_each(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not a|has no unit"):
        parse_lengths(text)


@pytest.mark.parametrize(
    ("text", "seconds"), [("2s", 2.0), ("500 ms", 0.5), (".5s", 0.5), ("1.5min", 90.0), ("0s", 0.0)]
)
def test_durations_are_read_in_seconds(text: str, seconds: float) -> None:
    assert parse_duration(text) == seconds


@pytest.mark.parametrize("text", ["2", "2 h", "s", "-1s", "1e9999s", "nan s", ""])
def test_what_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="like 2s"):
        parse_duration(text)

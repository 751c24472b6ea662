"""Every rule fires on the board that breaks it, and only that rule."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calichrome.target import Marker, Paper, Target, check_target, chessboard

Change = Callable[[Target], Target]
Triple = tuple[float, float, float]


def _markers(target: Target, change: Callable[[Marker], Marker]) -> Target:
    return replace(target, markers=tuple(change(marker) for marker in target.markers))


def _one(target: Target, **values: Any) -> Target:  # noqa: ANN401 (fields of Marker)
    """Change the first disc."""
    return replace(target, markers=(replace(target.markers[0], **values), *target.markers[1:]))


def _recoloured(target: Target, name: str, xyz_d65: Triple) -> Target:
    return _markers(target, lambda m: replace(m, xyz_d65=xyz_d65) if m.name == name else m)


def _exchanged(target: Target) -> Target:
    """A dark and a bright colour change places."""
    xyz = {marker.name: marker.xyz_d65 for marker in target.markers}
    changed = _recoloured(target, "blue", xyz["yellow"])
    return _recoloured(changed, "yellow", xyz["blue"])


def _tinted(target: Target) -> Target:
    def tint(marker: Marker) -> Marker:
        x, y, z = marker.xyz_d65
        grey = marker.name.startswith(("neutral", "black", "white"))
        return replace(marker, xyz_d65=(x, y, z * 0.6)) if grey else marker

    return _markers(target, tint)


def _darkened(marker: Marker) -> Marker:
    x, y, z = marker.xyz_d65
    return replace(marker, xyz_d65=(x / 100, y / 100, z / 100))


def _regular(target: Target) -> Target:
    """One colour on every black square."""
    marker = next(m for m in target.markers if m.background == "black")
    squares = [(ix, iy) for ix in range(10) for iy in range(9) if target.black_squares[iy, ix]]
    return replace(target, markers=tuple(replace(marker, square=square) for square in squares))


RULES: list[tuple[str, str, Change]] = [
    ("equal_parity", "remark", lambda t: replace(t, squares=(10, 10))),
    ("narrow_margin", "remark", lambda t: replace(t, white_margin_m=0.005)),
    ("wrong_scale", "error", lambda t: _markers(t, _darkened)),
    ("impossible_colour", "error", lambda t: _one(t, xyz_d65=(0.1, 0.1, -0.01))),
    ("impossible_colour", "error", lambda t: _one(t, xyz_d65=(1.2, 1.3, 1.4))),
    ("one_name_two_colours", "error", lambda t: _one(t, name=t.markers[1].name)),
    (
        "paper_inverted",
        "error",
        lambda t: replace(t, paper=Paper(white_xyz_d65=(0.1, 0.1, 0.1), black_xyz_d65=(1, 1, 1))),
    ),
    ("large_discs", "remark", lambda t: _one(t, diameter_m=0.0193)),
    ("small_discs", "remark", lambda t: _one(t, diameter_m=0.012)),
    ("dark_on_black", "remark", _exchanged),
    ("bright_on_white", "remark", _exchanged),
    (
        "few_colours",
        "remark",
        lambda t: replace(t, markers=tuple(m for m in t.markers if m.name != "cyan")),
    ),
    ("few_greys", "remark", _tinted),
    (
        "almost_equal_colours",
        "remark",
        lambda t: _recoloured(t, "blue", next(m.xyz_d65 for m in t.markers if m.name == "purple")),
    ),
    ("parts_look_alike", "remark", _regular),
    ("sparse_discs", "remark", lambda t: replace(t, markers=t.markers[::2])),
]


@pytest.mark.parametrize(
    ("code", "severity", "change"), RULES, ids=[f"{i}-{rule[0]}" for i, rule in enumerate(RULES)]
)
def test_a_rule_fires(standard_target: Target, code: str, severity: str, change: Change) -> None:
    problems = {problem.code: problem for problem in check_target(change(standard_target))}
    assert problems[code].severity == severity
    assert problems[code].text.endswith(".")


def test_no_rule_fires_on_a_good_board(standard_target: Target) -> None:
    assert check_target(replace(standard_target, white_margin_m=0.0135)) == []


def test_every_rule_has_a_board_that_breaks_it(standard_target: Target) -> None:
    fired = {p.code for _, _, change in RULES for p in check_target(change(standard_target))}
    assert fired == {code for code, _, _ in RULES}


def test_errors_come_first(standard_target: Target) -> None:
    bad = _one(replace(standard_target, white_margin_m=0.001), xyz_d65=(0.1, 0.1, -0.01))
    severities = [problem.severity for problem in check_target(bad)]
    assert severities == sorted(severities)
    assert {"error", "remark"} == set(severities)


def test_discs_that_always_reach_into_the_windows(standard_target: Target) -> None:
    text = {p.code: p.text for p in check_target(_one(standard_target, diameter_m=0.028))}
    assert "always" in text["large_discs"]
    text = {p.code: p.text for p in check_target(_one(standard_target, diameter_m=0.021))}
    assert "less than 28 px" in text["large_discs"]  # 2 / (0.32 - 0.354 * 0.7)


def test_measured_discs_of_one_name_may_differ(standard_target: Target) -> None:
    first = standard_target.markers[0]
    x, y, z = first.xyz_d65
    changed = _one(standard_target, xyz_d65=(x * 1.01, y * 1.01, z * 1.01))
    assert {p.code for p in check_target(changed)} == {"one_name_two_colours"}
    assert check_target(replace(changed, colours_measured=True)) == []


def test_plain_boards() -> None:
    assert check_target(chessboard((9, 6), (0.03, 0.03))) == []
    (problem,) = check_target(chessboard((7, 7), (0.03, 0.03)))
    assert problem.code == "equal_parity"


def test_a_board_of_thousands_of_colours_is_checked_in_time(board: Target) -> None:
    marker = board.markers[0]
    big = Target(squares=(200, 199), square_m=(0.03, 0.03))
    squares = [(int(ix), int(iy)) for iy, ix in np.argwhere(~big.black_squares[:, :100])]
    markers = tuple(replace(marker, square=s, name=str(i)) for i, s in enumerate(squares))
    assert "almost_equal_colours" in {
        problem.code for problem in check_target(replace(big, markers=markers))
    }

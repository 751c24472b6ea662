import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calichrome.errors import TargetError
from calichrome.target import (
    Paper,
    Target,
    load_target,
    parse_target,
    target_from_json,
    target_to_json,
    with_square_size,
)


def _written(target: Target) -> Any:  # noqa: ANN401 (JSON)
    return json.loads(json.dumps(target_to_json(target)))


def test_a_board_comes_back_as_it_was(board: Target) -> None:
    board = replace(board, paper=Paper(white_xyz_d65=(0.8, 0.85, 0.9)), square_m=(0.03, 0.031))
    again = target_from_json(_written(board))
    for before, after in zip(board.markers, again.markers, strict=True):
        # six decimals of Y = 100
        assert after.xyz_d65 == pytest.approx(before.xyz_d65, abs=1e-8)
    assert replace(again, markers=()) == replace(board, markers=())


def test_unknown_keys_survive_everywhere(board: Target) -> None:
    data = _written(replace(board, paper=Paper(white_xyz_d65=(0.8, 0.85, 0.9))))
    data["printer"] = {"ink": "pigment"}
    data["paper"]["gloss"] = "matte"
    data["markers"][3]["spectrum_id"] = "a7"
    again = _written(with_square_size(target_from_json(data), (0.0279, 0.0281)))
    assert again["printer"] == {"ink": "pigment"}
    assert again["paper"]["gloss"] == "matte"
    assert again["markers"][3]["spectrum_id"] == "a7"
    assert "spectrum_id" not in again["markers"][4]


def test_derived_colours_follow_a_new_value(board: Target) -> None:
    data = _written(board)
    data["markers"][0]["XYZ_D65"] = [95.047, 100, 108.883]
    again = _written(target_from_json(data))["markers"][0]
    assert again["Lab_D50"] == pytest.approx([100, 0, 0], abs=1e-3)
    assert again["XYZ_D50"] == pytest.approx([96.422, 100, 82.521], abs=1e-3)


def test_a_measured_size_takes_the_discs_with_it(board: Target) -> None:
    measured = with_square_size(board, (0.0277, 0.0281))
    assert measured.square_size_measured
    assert measured.markers[0].diameter_m / 0.0277 == pytest.approx(0.5)


def test_the_rendered_board_is_read(data: Path) -> None:
    """A file without `format`, made by others; its Lab and D50 values are theirs."""
    path = data / "render" / "recording" / "target.json"
    theirs = json.loads(path.read_text())
    ours = _written(load_target(path))
    assert ours["squares"] == [9, 6]
    assert ours["origin"] == theirs["origin"]
    for mine, their in zip(ours["markers"], theirs["markers"], strict=True):
        # four decimals in the file; their whites have more digits
        assert mine["XYZ_D65"] == pytest.approx(their["XYZ_D65"], abs=1e-6)
        assert mine["Lab_D65"] == pytest.approx(their["Lab_D65"], abs=0.02)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"squares": [3, 9]}, "4x4"),
        ({"squares": [9, 300]}, "more than 200"),
        ({"square_size_m": 0}, "give their size"),
        ({"square_size_m": "NaN"}, "square_size_m"),
        ({"top_left_square": "white"}, "correct background"),
        ({"format_version": 99}, "format_version"),
        ({"format": "other"}, "format"),
        ({"markers": [{"name": "x"}]}, "see docs/file-format.md"),
    ],
)
def test_impossible_boards_are_refused(board: Target, change: dict[str, Any], says: str) -> None:
    with pytest.raises(TargetError, match=says):
        target_from_json(_written(board) | change)


@pytest.mark.parametrize("text", ["{", "[1, 2]", '{"squares": NaN}', "\ufffe", "[" * 100_000])
def test_files_that_are_no_target_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "target.json"
    path.write_text(text, encoding="utf-16" if text == "\ufffe" else "utf-8")
    with pytest.raises(TargetError, match=r"target\.json"):
        load_target(path)


@pytest.mark.parametrize("text", ["chessboard:9x6", "chessboard:9x6:30", "chessboard:9:30mm"])
def test_misspelled_chessboards_name_the_form(text: str) -> None:
    with pytest.raises(TargetError, match=r"mm"):
        parse_target(text)


def test_a_chessboard_is_named_by_its_inner_corners() -> None:
    target = parse_target("chessboard:9x6:30x29.5mm")
    assert (target.squares, target.corners_xy) == ((10, 7), (9, 6))
    assert target.square_m == pytest.approx((0.03, 0.0295))
    assert target.square_colour(0, 0) == "black"

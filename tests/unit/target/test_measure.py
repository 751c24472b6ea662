from dataclasses import replace

import pytest

from calichrome.errors import TargetError
from calichrome.target import PaletteColour, Paper, Target, measured_target

Values = list[PaletteColour]


def _value(name: str, y: float = 0.3) -> PaletteColour:
    return PaletteColour(name=name, xyz_d65=(0.9 * y, y, 0.8 * y))


@pytest.fixture
def values(board: Target) -> Values:
    return [_value(marker.name, 0.1 + 0.01 * i) for i, marker in enumerate(board.markers)]


def test_every_disc_of_a_name_gets_its_value(standard_target: Target) -> None:
    names = list(dict.fromkeys(marker.name for marker in standard_target.markers))
    values = {name: _value(name, 0.1 + 0.01 * i) for i, name in enumerate(names)}
    measured = measured_target(standard_target, list(values.values()))
    assert measured.colours_measured
    assert not standard_target.colours_measured
    assert len(measured.markers) == len(standard_target.markers)
    for before, after in zip(standard_target.markers, measured.markers, strict=True):
        assert after == replace(before, xyz_d65=values[before.name].xyz_d65)
    assert measured.paper == Paper()


def test_single_discs_by_square_or_id_win_over_their_name(board: Target, values: Values) -> None:
    ix, iy = board.markers[3].square
    single = [_value(f"{ix},{iy}", 0.55), _value("5", 0.66)]
    measured = measured_target(board, [*values, *single])
    assert measured.markers[3].xyz_d65 == single[0].xyz_d65
    assert measured.markers[5].xyz_d65 == single[1].xyz_d65
    assert measured.markers[4].xyz_d65 == values[4].xyz_d65


def test_all_discs_one_by_one(board: Target) -> None:
    by_square = [_value(f"{m.square[0]},{m.square[1]}") for m in board.markers]
    by_id = [_value(str(index)) for index in range(len(board.markers))]
    for rows in (by_square, by_id):
        assert measured_target(board, rows).colours_measured


def test_ids_are_no_names_where_colours_are_numbered(board: Target, values: Values) -> None:
    numbered = replace(
        board,
        markers=tuple(replace(m, name=str(i + 1)) for i, m in enumerate(board.markers)),
    )
    rows = [replace(value, name=str(i + 1)) for i, value in enumerate(values)]
    measured = measured_target(numbered, rows)
    assert [m.xyz_d65 for m in measured.markers] == [value.xyz_d65 for value in values]
    with pytest.raises(TargetError, match="not on this board: '0'"):
        measured_target(numbered, [*rows, _value("0")])


def test_paper_alone_leaves_the_discs_nominal(board: Target) -> None:
    white, black = _value("paper_white", 0.86), _value("paper_black", 0.03)
    measured = measured_target(board, [white, black])
    assert measured.paper == Paper(white_xyz_d65=white.xyz_d65, black_xyz_d65=black.xyz_d65)
    assert measured.markers == board.markers
    assert not measured.colours_measured
    again = measured_target(measured, [_value("paper_white", 0.9)])
    assert again.paper.black_xyz_d65 == black.xyz_d65


def test_paper_exchanged_is_refused(board: Target) -> None:
    with pytest.raises(TargetError, match="exchange the two rows"):
        measured_target(board, [_value("paper_white", 0.03), _value("paper_black", 0.86)])


def test_unknown_names_get_the_nearest(board: Target, values: Values) -> None:
    with pytest.raises(TargetError, match=r"'ligt_skin' \(meant light_skin"):
        measured_target(board, [*values, _value("ligt_skin")])
    empty = next(
        (ix, iy)
        for ix in range(9)
        for iy in range(6)
        if (ix, iy) not in {marker.square for marker in board.markers}
    )
    for name in (f"{empty[0]},{empty[1]}", "24", "-1", "99999"):
        with pytest.raises(TargetError, match="not on this board"):
            measured_target(board, [*values, _value(name)])


def test_missing_discs_are_named(board: Target, values: Values) -> None:
    ix, iy = board.markers[-1].square
    with pytest.raises(
        TargetError, match=rf"1 of 24 discs .*{board.markers[-1].name} \(square {ix},{iy}\)"
    ):
        measured_target(board, values[:-1])
    with pytest.raises(TargetError, match="and 17 more colours"):
        measured_target(board, values[:1])


def test_one_disc_in_two_rows_is_refused(board: Target, values: Values) -> None:
    ix, iy = board.markers[0].square
    with pytest.raises(TargetError, match="the same disc"):
        measured_target(board, [*values, _value("0"), _value(f"{ix},{iy}")])

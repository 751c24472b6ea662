"""Which corners a lattice holds: on rendered boards, and by counting where no picture is needed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import BoardMap
from calichrome.detection.identity import Placement, candidate_placements, identify
from calichrome.imaging import Image
from calichrome.target import Target, chessboard, colour_checker_palette, design_target

Rendered = Callable[..., tuple[Image, FloatArray, Any]]

_PLAIN = chessboard((9, 6), (0.03, 0.03))
_BLANK = Image(pixels=np.zeros((400, 600), np.uint8), encoding="srgb", bits=8)
_TURNS = [np.array(turn) for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]])]
_TURNS += [-turn for turn in _TURNS]


@dataclass(frozen=True)
class _Lattice:
    indices: IntArray
    corners_px: FloatArray
    black_parity: int


def _lattice(
    target: Target, corners_px: FloatArray, shown: BoolArray, turn: int = 0
) -> tuple[_Lattice, IntArray]:
    """Take the shown corners (ny, nx) as a lattice whose axes are turned against the board's."""
    nx = target.corners_xy[0]
    ids = np.flatnonzero(shown)
    corners = np.stack([ids % nx, ids // nx], axis=1)
    indices = corners @ _TURNS[turn]
    offset = corners[0] - (indices[0] - indices.min(axis=0)) @ _TURNS[turn].T
    indices = indices - indices.min(axis=0)
    first = (_TURNS[turn] @ [0.5, 0.5] + offset + 0.5).astype(int)
    parity = 0 if target.square_colour(*first.tolist()) == "black" else 1
    return _Lattice(indices, corners_px[ids], parity), ids


def _window(target: Target, x: int, y: int, width: int, height: int) -> BoolArray:
    nx, ny = target.corners_xy
    shown = np.zeros((ny, nx), dtype=bool)
    shown[y : y + height, x : x + width] = True
    return shown


def _identify(
    image: Image, target: Target, corners_px: FloatArray, shown: BoolArray, turn: int = 0
) -> tuple[Placement | str, IntArray]:
    lattice, ids = _lattice(target, corners_px, shown, turn)
    board_map = BoardMap.fit(lattice.indices.astype(float), lattice.corners_px, image.size_wh)
    return identify(image, lattice, board_map, target), ids


def _grid_px(target: Target, *, upside_down: bool = False) -> FloatArray:
    nx, ny = target.corners_xy
    x, y = np.meshgrid(np.arange(nx), np.arange(ny))
    grid = np.stack([x.ravel(), y.ravel()], axis=1) * 30.0 + 50.0
    return np.asarray(grid[::-1] if upside_down else grid, dtype=np.float64)


@pytest.mark.parametrize("turn", range(4))
def test_all_placements_are_tried(turn: int) -> None:
    """3x2 corners on 9x6: 7*5 places lying, 8*4 standing, two turns each, half of each kind."""
    lattice, ids = _lattice(_PLAIN, _grid_px(_PLAIN), _window(_PLAIN, 4, 3, 3, 2), turn)
    found = candidate_placements(lattice, _PLAIN)
    right = np.flatnonzero(~found.mirrored)
    assert len(right) == 7 * 5 + 8 * 4
    assert len(found) == 2 * len(right)
    placed = [found.corner_ids(int(index), lattice, _PLAIN) for index in right]
    assert sum(np.array_equal(corner_ids, ids) for corner_ids in placed) == 1
    assert all(len(set(corner_ids.tolist())) == 6 for corner_ids in placed)
    for corner_ids in placed:
        assert (corner_ids >= 0).all()
        assert (corner_ids < _PLAIN.n_corners).all()


@pytest.mark.parametrize("turn", range(4))
def test_squares_of_a_placement_have_the_lattices_colours(turn: int) -> None:
    lattice, _ = _lattice(_PLAIN, _grid_px(_PLAIN), _window(_PLAIN, 4, 3, 3, 2), turn)
    i, j = np.meshgrid(np.arange(-1, 3), np.arange(-1, 2))
    cells = np.stack([i.ravel(), j.ravel()], axis=1)
    inside = (cells < lattice.indices.max(axis=0) + 1).all(axis=1)
    cells = cells[inside]
    squares = candidate_placements(lattice, _PLAIN).squares(cells, _PLAIN)
    black = _PLAIN.black_squares.ravel()[squares]
    assert (black == (cells.sum(axis=1) % 2 == lattice.black_parity)).all()


@pytest.mark.parametrize("turn", range(4))
def test_whole_plain_boards(turn: int) -> None:
    shown = np.ones((6, 9), dtype=bool)
    shown[2:4, 5] = False  # a finger
    found, ids = _identify(_BLANK, _PLAIN, _grid_px(_PLAIN), shown, turn)
    assert isinstance(found, Placement)
    np.testing.assert_array_equal(found.corner_ids, ids)
    assert not found.half_turn_ambiguous


@pytest.mark.parametrize("upside_down", [False, True])
def test_equal_orders_stand_upright(upside_down: bool) -> None:  # noqa: FBT001
    target = chessboard((7, 5), (0.03, 0.03))
    shown = np.ones((5, 7), dtype=bool)
    found, ids = _identify(_BLANK, target, _grid_px(target, upside_down=upside_down), shown)
    assert isinstance(found, Placement)
    assert found.half_turn_ambiguous
    np.testing.assert_array_equal(found.corner_ids, ids[::-1] if upside_down else ids)


def test_a_part_of_a_plain_board_is_refused() -> None:
    found, _ = _identify(_BLANK, _PLAIN, _grid_px(_PLAIN), _window(_PLAIN, 1, 0, 7, 6), 1)
    assert found == "plain boards must be seen whole; saw 7x6 of 9x6 corners"


def test_a_larger_board_is_refused() -> None:
    large = chessboard((10, 7), (0.03, 0.03))
    lattice, _ = _lattice(large, _grid_px(large), np.ones((7, 10), dtype=bool), 3)
    board_map = BoardMap.fit(lattice.indices.astype(float), lattice.corners_px, _BLANK.size_wh)
    found = identify(_BLANK, lattice, board_map, _PLAIN)
    assert found == "saw 10x7 inner corners, expected 9x6: count them and correct --target"


def test_corner_squares_of_the_other_colour() -> None:
    white = replace(chessboard((8, 6), (0.03, 0.03)), top_left="white")
    lattice, _ = _lattice(white, _grid_px(white), np.ones((6, 8), dtype=bool))
    board_map = BoardMap.fit(lattice.indices.astype(float), lattice.corners_px, _BLANK.size_wh)
    found = identify(_BLANK, lattice, board_map, chessboard((8, 6), (0.03, 0.03)))
    assert isinstance(found, str)
    assert '"top_left_square": "white"' in found


def test_the_other_spelling_of_a_both_odd_board() -> None:
    board = chessboard((7, 5), (0.03, 0.03))
    lattice, _ = _lattice(board, _grid_px(board), np.ones((5, 7), dtype=bool))
    board_map = BoardMap.fit(lattice.indices.astype(float), lattice.corners_px, _BLANK.size_wh)
    found = identify(_BLANK, lattice, board_map, chessboard((5, 7), (0.03, 0.03)))
    assert isinstance(found, str)
    assert "the target is 7x5" in found


def test_parts_of_a_board_with_discs(render: Rendered, standard_target: Target) -> None:
    """Every window of 4x3 squares, lying and standing, however the lattice is turned."""
    image, true_px, _ = render(standard_target, tilt_deg=30)
    n_found = n_windows = 0
    for width, height in ((3, 2), (2, 3)):
        for y in range(8 - height + 1):
            for x in range(9 - width + 1):
                shown = _window(standard_target, x, y, width, height)
                turn = (x + 3 * y) % 4
                found, ids = _identify(image, standard_target, true_px, shown, turn)
                n_windows += 1
                if isinstance(found, Placement):
                    n_found += 1
                    np.testing.assert_array_equal(found.corner_ids, ids)
                    assert not found.half_turn_ambiguous
    assert n_found >= 0.98 * n_windows


def test_whole_board_with_discs(render: Rendered, standard_target: Target) -> None:
    image, true_px, _ = render(standard_target)
    for turn in range(4):
        shown = np.ones((8, 9), dtype=bool)
        found, ids = _identify(image, standard_target, true_px, shown, turn)
        assert isinstance(found, Placement)
        np.testing.assert_array_equal(found.corner_ids, ids)


def test_grey_pictures_are_told_by_presence(render: Rendered, standard_target: Target) -> None:
    image, true_px, _ = render(standard_target)
    grey = replace(image, pixels=np.ascontiguousarray(image.pixels[..., 1]))
    shown = _window(standard_target, 2, 1, 5, 5)
    found, ids = _identify(grey, standard_target, true_px, shown, 3)
    assert isinstance(found, Placement)
    np.testing.assert_array_equal(found.corner_ids, ids)


@pytest.mark.parametrize("whole", [True, False])
def test_mirrored_pictures_are_named(
    render: Rendered,
    standard_target: Target,
    whole: bool,  # noqa: FBT001
) -> None:
    image, true_px, _ = render(standard_target)
    mirrored = replace(image, pixels=np.ascontiguousarray(image.pixels[:, ::-1]))
    flipped = true_px * [-1, 1] + [image.size_wh[0] - 1, 0]
    # As a lattice it is right-handed again: its columns count from the other side.
    shown = np.ones((8, 9), dtype=bool) if whole else _window(standard_target, 1, 2, 5, 4)
    lattice, _ = _lattice(standard_target, flipped, shown)
    width = lattice.indices[:, 0].max()
    indices = np.stack([width - lattice.indices[:, 0], lattice.indices[:, 1]], axis=1)
    # The square at the origin was the last of its row.
    seen = _Lattice(indices, lattice.corners_px, (lattice.black_parity + width - 1) % 2)
    board_map = BoardMap.fit(indices.astype(float), seen.corners_px, image.size_wh)
    found = identify(mirrored, seen, board_map, standard_target)
    assert isinstance(found, str)
    assert found.startswith("the picture is mirrored;")


@pytest.mark.parametrize("whole", [True, False])
def test_another_layout_is_refused(
    render: Rendered,
    standard_target: Target,
    whole: bool,  # noqa: FBT001
) -> None:
    image, true_px, _ = render(standard_target)
    palette = colour_checker_palette()
    other = design_target(squares=(10, 9), square_m=(0.03, 0.03), palette=palette, seed=1)
    shown = np.ones((8, 9), dtype=bool) if whole else _window(other, 1, 2, 5, 4)
    found, _ = _identify(image, other, true_px, shown)
    assert isinstance(found, str)
    assert "is target.json that of this board" in found


def test_a_covered_part_does_not_mislead(render: Rendered, standard_target: Target) -> None:
    """A dark hand over some squares: its corners are missing, its discs count for nothing."""
    image, true_px, _ = render(standard_target)
    shown = _window(standard_target, 0, 2, 6, 5)
    shown[3:6, 3:5] = False
    centre = true_px.reshape(8, 9, 2)[3:6, 3:5].mean(axis=(0, 1))
    y, x = np.mgrid[: image.size_wh[1], : image.size_wh[0]]
    hand = np.hypot(x - centre[0], y - centre[1]) < 32
    pixels = np.where(hand[..., None], np.array([0.3, 0.2, 0.15], dtype=np.float32), image.pixels)
    found, ids = _identify(replace(image, pixels=pixels), standard_target, true_px, shown, 1)
    assert isinstance(found, Placement)
    np.testing.assert_array_equal(found.corner_ids, ids)

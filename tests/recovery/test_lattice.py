"""Corners of boards are found with their places, whatever tilts, bends or covers the board."""

from collections.abc import Callable

import numpy as np
import pytest
from chessboards import Plane, draw, noisy, view

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.detection.grid import Lattice, find_lattices

ToBoard = Callable[[FloatArray], FloatArray]
_CORNERS_XY = (8, 6)


def _check(lattice: Lattice, to_board: ToBoard, tolerance: float = 0.03) -> FloatArray:
    """Return the corners' places (N, 2) on the board; one turn and shift leads to them."""
    places = to_board(lattice.corners_px) + (np.array(_CORNERS_XY) - 1) / 2
    whole = np.rint(places)
    assert np.abs(places - whole).max() < tolerance  # squares: 1 px of a square of 30
    quarter = np.array([[0, -1], [1, 0]])
    for n in range(4):
        shift = whole - lattice.indices @ np.linalg.matrix_power(quarter, n).T
        if (shift == shift[0]).all():
            break
    else:
        pytest.fail("no turn and shift explains the indices")
    assert (whole >= 0).all()
    assert (whole < _CORNERS_XY).all()
    return np.asarray(whole)


@pytest.mark.parametrize("tilt_deg", [0, 30, 50, 62])
@pytest.mark.parametrize("roll_deg", [0, 33, 46, 120])
def test_whole_boards_in_perspective(
    tilt_deg: float, roll_deg: float, rng: np.random.Generator
) -> None:
    to_board = view(tilt_deg=tilt_deg, roll_deg=roll_deg, square_px=34)
    lattices = find_lattices(noisy(draw(to_board), 3, rng))
    assert [len(lattice) for lattice in lattices] == [48]
    _check(lattices[0], to_board)


@pytest.mark.parametrize("k1", [-0.4, 0.3])
def test_distorted_boards(k1: float, rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=25, roll_deg=10, square_px=55, k1=k1)
    lattices = find_lattices(noisy(draw(to_board), 2, rng))
    assert len(lattices[0]) == 48
    _check(lattices[0], to_board)


@pytest.mark.parametrize("square_px", [8.0, 10.0, 16.0])
def test_small_squares(square_px: float, rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=15, roll_deg=20, square_px=square_px)
    lattices = find_lattices(noisy(draw(to_board, blur_px=1.0), 3, rng))
    assert len(lattices[0]) == 48
    _check(lattices[0], to_board, tolerance=0.06)  # half a pixel of 8


@pytest.mark.parametrize("blur_px", [3.0, 5.0])
def test_blurred_boards(blur_px: float, rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=20, roll_deg=70, square_px=36)
    lattices = find_lattices(noisy(draw(to_board, blur_px=blur_px), 2, rng))
    assert len(lattices[0]) == 48
    _check(lattices[0], to_board)


def test_dark_boards(rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=20, roll_deg=5)
    dark = draw(to_board) * np.float32(10 / 170)  # 10 DN from black to white
    lattices = find_lattices(noisy(dark + 5, 3, rng))
    assert len(lattices[0]) == 48
    _check(lattices[0], to_board, tolerance=0.05)


@pytest.mark.parametrize("disc", [0.5, 0.7])
def test_discs_do_not_disturb(disc: float, rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=40, roll_deg=20)
    lattices = find_lattices(noisy(draw(to_board, disc=disc), 2, rng))
    assert [len(lattice) for lattice in lattices] == [48]
    _check(lattices[0], to_board)


def test_uneven_light() -> None:
    to_board = view(roll_deg=12)
    light = np.linspace(0.15, 1, 640, dtype=np.float32)
    lattices = find_lattices(draw(to_board) * light)
    assert len(lattices[0]) == 48
    _check(lattices[0], to_board)


def _covered(picture: Plane, cover: BoolArray) -> Plane:
    return np.where(cover, np.float32(130), picture)


def test_boards_cut_by_the_border(rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=30, roll_deg=25, square_px=60)
    picture = noisy(draw(to_board), 2, rng)[:, :330]
    lattices = find_lattices(picture.copy())
    places = _check(lattices[0], to_board)
    visible = _corners_px(to_board)[:, 0] < 330 - 6
    assert len(places) >= visible.sum()


def test_what_is_covered_is_missing_and_no_more(rng: np.random.Generator) -> None:
    to_board = view(roll_deg=10)
    y, x = np.mgrid[:480, :640]
    spots = ((x - 300) ** 2 + (y - 220) ** 2 < 40**2) | ((x - 420) ** 2 + (y - 300) ** 2 < 30**2)
    lattices = find_lattices(_covered(noisy(draw(to_board), 2, rng), spots))
    _check(lattices[0], to_board)
    corners = _corners_px(to_board)
    middles = np.array([[300, 220], [420, 300]])
    hidden = (np.linalg.norm(corners[:, None] - middles, axis=2) < [40 + 8, 30 + 8]).any(axis=1)
    assert len(lattices[0]) >= (~hidden).sum()


def test_parts_on_both_sides_of_an_arm_join(rng: np.random.Generator) -> None:
    to_board = view(tilt_deg=25, k1=-0.2)
    x = np.arange(640)
    arm = np.broadcast_to(np.abs(x - 330) < 50, (480, 640))  # hides three columns
    lattices = find_lattices(_covered(noisy(draw(to_board), 2, rng), arm))
    places = _check(lattices[0], to_board)
    assert len(lattices) == 1
    assert places[:, 0].min() == 0
    assert places[:, 0].max() == 7


def _corners_px(to_board: ToBoard) -> FloatArray:
    """Return the true corners (48, 2) by Newton's method from the picture's middle."""
    nx, ny = _CORNERS_XY
    goal = np.stack(np.meshgrid(np.arange(float(nx)), np.arange(float(ny))), axis=-1).reshape(-1, 2)
    goal = goal - (np.array(_CORNERS_XY) - 1) / 2
    points = np.full((len(goal), 2), [319.5, 239.5])
    for _ in range(30):
        here = to_board(points)
        slope = np.stack([to_board(points + step) - here for step in np.eye(2)], axis=2)
        points += np.linalg.solve(slope, (goal - here)[..., None])[..., 0]
    return points

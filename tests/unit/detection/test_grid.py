"""Lattices: conventions, and what is none."""

import cv2
import numpy as np
import pytest
from chessboards import SIZE_WH, Plane, draw, noisy, view

from calichrome.core.arrays import FloatArray
from calichrome.detection.grid import Lattice, find_lattices


def _the(lattices: list[Lattice]) -> Lattice:
    assert len(lattices) == 1
    return lattices[0]


def _steps(lattice: Lattice) -> tuple[FloatArray, FloatArray]:
    """Return the mean steps along i and j, pixels."""
    design = np.column_stack([lattice.indices, np.ones(len(lattice))])
    along = np.linalg.lstsq(design, lattice.corners_px, rcond=None)[0]
    return along[0], along[1]


@pytest.mark.parametrize("roll_deg", range(0, 360, 30))
def test_axes_turn_as_those_of_the_picture(roll_deg: float) -> None:
    lattice = _the(find_lattices(draw(view(roll_deg=roll_deg, tilt_deg=30, square_px=30))))
    along_i, along_j = _steps(lattice)
    assert along_i[0] * along_j[1] - along_i[1] * along_j[0] > 0
    assert (lattice.indices.min(axis=0) == 0).all()
    assert len(np.unique(lattice.indices, axis=0)) == len(lattice) == 48


@pytest.mark.parametrize("roll_deg", [0, 40, 90, 200])
@pytest.mark.parametrize("corners_xy", [(8, 6), (7, 6), (7, 5)])
def test_black_squares_are_black(corners_xy: tuple[int, int], roll_deg: float) -> None:
    picture = draw(view(roll_deg=roll_deg, square_px=32), corners_xy=corners_xy)
    lattice = _the(find_lattices(picture))
    along_i, along_j = _steps(lattice)
    x, y = np.rint(lattice.corners_px + (along_i + along_j) / 2).astype(int).T
    black = lattice.indices.sum(axis=1) % 2 == lattice.black_parity
    inside = (lattice.indices < np.ptp(lattice.indices, axis=0)).all(axis=1)
    assert ((picture[y, x] < 125) == black)[inside].all()


def test_the_map_leads_to_the_corners() -> None:
    lattice = _the(find_lattices(draw(view(tilt_deg=40, roll_deg=15, k1=-0.3))))
    off = lattice.board_map(lattice.indices.astype(np.float64)) - lattice.corners_px
    assert np.linalg.norm(off, axis=1).max() < 0.3


def test_a_turned_picture_has_the_same_corners() -> None:
    picture = draw(view(tilt_deg=35, roll_deg=25))
    upright, turned = _the(find_lattices(picture)), _the(find_lattices(np.rot90(picture).copy()))
    x, y = turned.corners_px.T
    back = np.stack([SIZE_WH[0] - 1 - y, x], axis=1)
    distance = np.linalg.norm(upright.corners_px[:, None] - back, axis=2)
    assert distance.min(axis=1).max() < 0.02
    matches = turned.indices[distance.argmin(axis=1)]
    # Some quarter turn takes the indices to each other.
    quarter = np.array([[0, -1], [1, 0]])
    shifts = [matches - upright.indices @ np.linalg.matrix_power(quarter, n).T for n in range(4)]
    assert sum(bool((shift == shift[0]).all()) for shift in shifts) == 1


def test_exchanged_colours_exchange_the_parity() -> None:
    picture = draw(view(roll_deg=10))
    plain, inverse = _the(find_lattices(picture)), _the(find_lattices(255 - picture))
    order = [np.lexsort(lattice.corners_px.T) for lattice in (plain, inverse)]
    np.testing.assert_allclose(plain.corners_px[order[0]], inverse.corners_px[order[1]], atol=1e-3)
    along = [np.stack(_steps(lattice)) for lattice in (plain, inverse)]
    same_axes = np.abs(along[0] - along[1]).max() < 1
    if same_axes:
        assert plain.black_parity != inverse.black_parity


def _band(rng: np.random.Generator, scale: float, *, binary: bool) -> Plane:
    noise = rng.normal(size=(480, 640)).astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(noise, (0, 0), scale * k) for k in (1, 2))
    band = (fine - coarse) / (fine - coarse).std()
    levels = np.where(band > 0, 220, 30) if binary else np.clip(128 + 50 * band, 0, 255)
    return levels.astype(np.float32)


@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("binary", [False, True])
def test_textures_have_none(scale: float, *, binary: bool, rng: np.random.Generator) -> None:
    assert find_lattices(_band(rng, scale, binary=binary)) == []


def test_text_has_none(rng: np.random.Generator) -> None:
    page = np.full((480, 640), 235, np.uint8)
    for y in range(20, 480, 18):
        line = "".join(chr(letter) for letter in rng.integers(33, 122, 80))
        cv2.putText(page, line, (5, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 30, 1, cv2.LINE_AA)
    assert find_lattices(page.astype(np.float32)) == []


def test_stripes_have_none() -> None:
    stripes = np.where(np.arange(640) // 20 % 2 == 0, 30, 220)
    picture = np.broadcast_to(stripes, (480, 640)).astype(np.float32)
    assert find_lattices(picture.copy()) == []


def test_noise_and_flat_pictures_have_none(rng: np.random.Generator) -> None:
    flat = np.full((480, 640), 128, np.float32)
    assert find_lattices(flat) == []
    assert find_lattices(noisy(flat, 10, rng)) == []


def test_two_boards_are_two_lattices() -> None:
    left, right = view(square_px=26, roll_deg=8), view(square_px=24, roll_deg=-30, tilt_deg=30)
    boards = [draw(to_board, corners_xy=(6, 5)) for to_board in (left, right)]
    picture = np.concatenate(boards, axis=1)
    lattices = find_lattices(picture)
    assert [len(lattice) for lattice in lattices] == [30, 30]
    sides = {bool((lattice.corners_px[:, 0] > SIZE_WH[0]).all()) for lattice in lattices}
    assert sides == {False, True}


def test_aligned_boards_are_not_mixed() -> None:
    # Side by side on one wall, half a square off: only what is printed together is one lattice.
    board = draw(view(square_px=30), corners_xy=(6, 5))
    shifted = np.roll(board, 15, axis=0)
    lattices = find_lattices(np.concatenate([board[:, 150:490], shifted[:, 150:490]], axis=1))
    assert [len(lattice) for lattice in lattices] == [30, 30]

"""Chessboards in pictures: which corners, in which order, and where there are none."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography
from calichrome.detection.grid import Lattice, find_lattices

Picture = NDArray[np.float32]
Warp = Callable[[FloatArray], FloatArray]
_SIZE_WH = (640, 480)
_OVERSAMPLING = 4


def _board(
    from_pixels: Warp, corners_xy: tuple[int, int] = (7, 5), size_wh: tuple[int, int] = _SIZE_WH
) -> Picture:
    """Return a black and white board on grey, 0..255; squares are units of the board."""
    step = 1 / _OVERSAMPLING
    x = np.arange(size_wh[0] * _OVERSAMPLING) * step + (step - 1) / 2
    y = np.arange(size_wh[1] * _OVERSAMPLING) * step + (step - 1) / 2
    points = np.asarray(np.stack(np.meshgrid(x, y), axis=-1), dtype=np.float64)
    squares = np.floor(from_pixels(points.reshape(-1, 2)).reshape(points.shape)).astype(int)
    nx, ny = corners_xy
    on_board = ((squares >= -1) & (squares < [nx, ny])).all(axis=-1)
    on_paper = ((squares >= -2) & (squares < [nx + 1, ny + 1])).all(axis=-1)
    level = np.where(on_board & (squares.sum(axis=-1) % 2 == 0), 30.0, 220.0)
    level = np.where(on_paper, level, 130.0).astype(np.float32)
    blurred = cv2.GaussianBlur(level, (0, 0), 0.8 * _OVERSAMPLING)
    return np.asarray(cv2.resize(blurred, size_wh, interpolation=cv2.INTER_AREA))


def _seen(homography: FloatArray) -> Warp:
    inverse = np.asarray(np.linalg.inv(homography))
    return lambda points: apply_homography(inverse, points)


_TILTED = np.array([[46, 6, 150], [-5, 44, 130], [0.02, -0.01, 1.0]])


def _noisy(picture: Picture, rng: np.random.Generator, sigma: float = 3) -> Picture:
    noise = rng.normal(scale=sigma, size=picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.float32)


def _true_corners(homography: FloatArray, corners_xy: tuple[int, int] = (7, 5)) -> FloatArray:
    nx, ny = corners_xy
    grid = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2)
    return apply_homography(homography, grid.astype(np.float64))


def _check_order(lattice: Lattice, true_px: FloatArray, corners_xy: tuple[int, int]) -> None:
    """The indices are those of the board, turned and shifted; black squares are black."""
    distance = np.linalg.norm(lattice.corners_px[:, None] - true_px, axis=2)
    assert distance.min(axis=1).max() < 0.5
    ids = distance.argmin(axis=1)
    assert len(np.unique(ids)) == len(ids)
    board = np.stack([ids % corners_xy[0], ids // corners_xy[0]], axis=1)
    turned = lattice.indices
    for _ in range(4):
        shift = board - turned
        if (shift == shift[0]).all():
            break
        turned = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    else:
        pytest.fail("the corners are not in the order of the board")
    # A square's centre, in the lattice and on the board, where even squares are black.
    first = np.argwhere((lattice.indices == 0).all(axis=1)).ravel()
    if len(first):
        centre = lattice.board_map(np.array([0.5, 0.5]))
        square = np.floor(apply_homography(np.asarray(np.linalg.inv(_TILTED)), centre)).astype(int)
        assert (square.sum() % 2 == 0) == (lattice.black_parity == 0)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_tilted_board_is_found_whole_and_in_order(quarters: int, rng: np.random.Generator) -> None:
    """However the picture is turned, the same corners are found."""
    picture = np.ascontiguousarray(np.rot90(_noisy(_board(_seen(_TILTED)), rng), quarters))
    (lattice,) = find_lattices(picture)
    assert len(lattice) == 35
    if quarters == 0:
        _check_order(lattice, _true_corners(_TILTED), (7, 5))
    assert sorted((lattice.indices.max(axis=0) + 1).tolist()) == [5, 7]
    axes = lattice.board_map.jacobian(np.array([3.0, 2.0]))
    assert np.linalg.det(axes) > 0  # from +i to +j as from x to y


def test_strong_distortion(rng: np.random.Generator) -> None:
    def undistorted(points: FloatArray) -> FloatArray:
        away = (points - [319.5, 239.5]) / 400
        ideal = away.copy()
        for _ in range(30):  # k1 = -0.3 for a focal length of 400 px
            ideal = away / (1 - 0.3 * (ideal**2).sum(axis=1))[:, None]
        return (ideal * 400 + [319.5, 239.5] - [140.0, 140.0]) / 60

    lattices = find_lattices(_noisy(_board(undistorted, (7, 5)), rng))
    assert len(lattices[0]) == 35


def test_covered_corners_are_holes(rng: np.random.Generator) -> None:
    picture = _noisy(_board(_seen(_TILTED)), rng)
    true_px = _true_corners(_TILTED)
    covered = [9, 10, 16, 17]
    low, high = true_px[covered].min(axis=0) - 9, true_px[covered].max(axis=0) + 9
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    picture[y0:y1, x0:x1] = 100
    (lattice,) = find_lattices(picture)
    assert len(lattice) == 31
    _check_order(lattice, true_px, (7, 5))


def test_parts_on_both_sides_of_a_bar_are_one(rng: np.random.Generator) -> None:
    homography = np.array([[40, 0, 180], [0, 40, 120], [0, 0, 1.0]])
    picture = _noisy(_board(_seen(homography)), rng)
    picture[:, 288:312] = 100  # over the corners of one column
    (lattice,) = find_lattices(picture)
    assert len(lattice) == 30
    _check_order(lattice, _true_corners(homography), (7, 5))


def test_two_boards_are_two(rng: np.random.Generator) -> None:
    left = np.array([[30, 2, 60], [-2, 30, 100], [0, 0, 1.0]])
    right = np.array([[28, -3, 400], [3, 28, 180], [0, 0, 1.0]])
    picture = _board(_seen(left), (6, 5))
    other = _board(_seen(right), (6, 5))
    picture = _noisy(np.where(other == 130, picture, other), rng)
    first, second = find_lattices(picture)
    assert (len(first), len(second)) == (30, 30)
    assert abs(first.corners_px[:, 0].mean() - second.corners_px[:, 0].mean()) > 250


def test_small_squares_in_noise(rng: np.random.Generator) -> None:
    homography = np.array([[10, 1, 200], [-1, 10, 150], [0, 0, 1.0]])
    lattices = find_lattices(_noisy(_board(_seen(homography)), rng, sigma=5))
    assert len(lattices[0]) == 35


def test_dim_board(rng: np.random.Generator) -> None:
    """A tenth of the levels between black and white."""
    dim = 20 + 0.08 * _board(_seen(_TILTED))
    (lattice,) = find_lattices(_noisy(dim, rng, sigma=1.5))
    assert len(lattice) == 35


@pytest.mark.parametrize("blur", [0, 1.5, 6])
def test_no_board_in_noise(blur: float, rng: np.random.Generator) -> None:
    picture = rng.normal(scale=40, size=(480, 640)).astype(np.float32)
    if blur:
        picture = cv2.GaussianBlur(picture, (0, 0), blur) * (2 * blur)
    assert find_lattices(np.clip(picture + 128, 0, 255)) == []


def test_no_board_in_bricks() -> None:
    """Rows of bricks meet in T junctions, not in corners of four."""
    y, x = np.mgrid[0:480, 0:640]
    joints = (y % 24 < 3) | ((x + 24 * (y // 24 % 2)) % 48 < 3)
    picture = cv2.GaussianBlur(np.where(joints, 200, 90).astype(np.float32), (0, 0), 0.8)
    assert find_lattices(picture) == []

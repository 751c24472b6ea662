"""Candidate corners: where they are, which way their edges run, and that noise has none."""

import cv2
import numpy as np
import pytest
from chessboards import SIZE_WH, Plane, draw, noisy, view

from calichrome.core.arrays import FloatArray
from calichrome.detection.pyramid import build_pyramid, estimate_noise
from calichrome.detection.saddles import find_saddles


def _middle_saddle(picture: Plane) -> tuple[float, FloatArray, float, int]:
    """Return distance from the middle, directions, contrast and level of the saddle there."""
    saddles = find_saddles(picture)
    off = np.linalg.norm(saddles.points_px - (np.array(SIZE_WH) - 1) / 2, axis=1)
    at = int(off.argmin())
    angles, contrast = saddles.angles_rad[at], float(saddles.contrast[at])
    return float(off[at]), angles, contrast, int(saddles.level[at])


@pytest.mark.parametrize("blur_px", [0.6, 1.5, 3.0, 5.0])
@pytest.mark.parametrize("roll_deg", [0, 20, 43, 110])
def test_a_corner_is_found_with_its_edges(blur_px: float, roll_deg: float) -> None:
    picture = draw(view(roll_deg=roll_deg), corners_xy=(5, 5), blur_px=blur_px)
    off, angles, _, _ = _middle_saddle(picture)
    assert off < 0.05  # a bilinear sample of a level's plane is off by less
    turn = np.mod(np.rad2deg(angles) - roll_deg + 45, 90) - 45
    assert np.abs(turn).max() < 4  # the rays are 11 degrees apart


def test_from_the_first_edge_to_the_second_it_is_bright() -> None:
    picture = draw(view(), corners_xy=(5, 5))
    saddles = find_saddles(picture)
    middle = saddles.angles_rad.mean(axis=1)
    for turn, bright in ((0, True), (np.pi / 2, False), (np.pi, True), (-np.pi / 2, False)):
        at = saddles.points_px + 8 * np.stack(
            [np.cos(middle + turn), np.sin(middle + turn)], axis=1
        )
        x, y = np.rint(at).astype(int).T
        assert ((picture[y, x] > 125) == bright).all()


def test_neighbours_have_opposite_polarity() -> None:
    saddles = find_saddles(draw(view(), corners_xy=(5, 5)))
    assert len(saddles) == 25
    column, row = np.rint((saddles.points_px - saddles.points_px.min(axis=0)) / 36).astype(int).T
    along_x = np.abs(np.cos(saddles.angles_rad[:, 0])) > 0.7
    assert ((column + row) % 2 == along_x).all() or ((column + row) % 2 != along_x).all()


def test_contrast_is_half_the_step() -> None:
    _, _, contrast, _ = _middle_saddle(draw(view(), corners_xy=(5, 5), blur_px=0.6))
    # of 40 and 210, less what blur leaves at 2.1 px from both edges: erf(2.1 / (1.2 sqrt 2))^2
    assert contrast == pytest.approx(85 * 0.84, rel=0.05)


def test_blurred_corners_are_found_on_a_coarser_level() -> None:
    sharp = draw(view(square_px=60), corners_xy=(3, 3), blur_px=0.6)
    blurred = draw(view(square_px=60), corners_xy=(3, 3), blur_px=6.0)
    assert _middle_saddle(sharp)[3] == 0
    assert _middle_saddle(blurred)[3] > 0


@pytest.mark.parametrize("sigma", [1.0, 5.0, 15.0])
def test_noise_is_measured_and_has_few_saddles(sigma: float, rng: np.random.Generator) -> None:
    picture = noisy(np.full((480, 640), 128, np.float32), sigma, rng)
    # Rounding to whole DN adds 1/12, and steps to the quantile of little noise
    expected = pytest.approx(np.hypot(sigma, 12**-0.5), rel=0.2 if sigma < 2 else 0.05)
    assert estimate_noise(picture) == expected
    assert len(find_saddles(picture)) < 60  # of 12,000 maxima


def test_edges_do_not_raise_the_noise(rng: np.random.Generator) -> None:
    picture = noisy(draw(view()), 2.0, rng)
    assert estimate_noise(picture) == pytest.approx(2.0, rel=0.1)


def test_a_flat_picture_has_none() -> None:
    saddles = find_saddles(np.full((200, 300), 77, np.float32))
    assert len(saddles) == 0


@pytest.mark.parametrize("shape", [(8, 8), (9, 300), (41, 30)])
def test_tiny_pictures_are_pictures(shape: tuple[int, int], rng: np.random.Generator) -> None:
    find_saddles(noisy(np.full(shape, 128, np.float32), 5.0, rng))


def test_large_pictures_are_reduced_without_shift() -> None:
    picture = draw(view(), corners_xy=(5, 5))
    large = cv2.resize(picture, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
    pyramid = build_pyramid(large)
    assert pyramid.reduction == 2  # 4.9 MP
    saddles = find_saddles(large)
    truth = (np.array(SIZE_WH) - 1) / 2
    off = np.linalg.norm((saddles.points_px + 0.5) / 4 - 0.5 - truth, axis=1)
    assert off.min() < 0.05

"""The channel in which corners are measured, and why no board is seen."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.detection.board_map import EdgeBend
from calichrome.detection.levels import best_mix, readings_of
from calichrome.detection.light_field import light_gradients
from calichrome.detection.reasons import edge_width_px, why_no_board
from calichrome.imaging import Image
from calichrome.target import chessboard

_TARGET = chessboard((7, 6), (0.03, 0.03))


def _corner(black: FloatArray, white: FloatArray) -> Image:
    """Return four squares that meet at (30, 30), linear 0..1."""
    y, x = np.mgrid[0:61, 0:61]
    bright = ((x > 30) == (y > 30))[..., None]
    pixels = np.where(bright, white, black).astype(np.float32)
    return Image(pixels=pixels, encoding="linear", bits=32)


def _mix(image: Image) -> FloatArray:
    edges = EdgeBend(
        along_i=np.array([[30.0, 0]]),
        along_j=np.array([[0, 30.0]]),
        curvature=np.zeros((1, 2)),
        variance=np.zeros((1, 2)),
    )
    return best_mix(image, np.array([[30.0, 30.0]]), edges, np.array([True]))


def test_mix_follows_the_contrast() -> None:
    image = _corner(np.array([0.1, 0.1, 0.1]), np.array([0.2, 0.5, 0.6]))
    np.testing.assert_allclose(_mix(image), [0.1, 0.4, 0.5], atol=1e-6)


def test_mix_leaves_out_clipped_channels() -> None:
    image = _corner(np.array([0.1, 0.1, 0.1]), np.array([1.0, 0.5, 0.3]))
    np.testing.assert_allclose(_mix(image), [0, 2 / 3, 1 / 3], atol=1e-6)


def test_mix_of_a_picture_clipped_in_all_channels() -> None:
    image = _corner(np.array([0.1, 0.1, 0.1]), np.array([1.0, 1.0, 1.0]))
    np.testing.assert_allclose(_mix(image), np.full(3, 1 / 3))


def test_readings_are_as_declared_and_as_stored() -> None:
    image = Image(pixels=np.full((3, 3, 3), 128, np.uint8), encoding="srgb", bits=8)
    at = np.array([1]), np.array([1])
    declared, stored = (reading(*at)[0] for reading in readings_of(image, np.full(3, 1 / 3)))
    assert declared == pytest.approx(0.2158605, abs=1e-6)  # IEC 61966-2-1
    assert stored == pytest.approx(128 / 255)
    assert len(readings_of(replace(image, encoding="linear"), np.full(3, 1 / 3))) == 1


def test_light_of_a_quadratic_is_recovered() -> None:
    lattice = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    x, y = lattice.T
    gradients, covariance = light_gradients(lattice, 0.5 + 0.01 * x - 0.02 * y + 0.003 * x * y)
    expected = np.stack([0.01 + 0.003 * y, -0.02 + 0.003 * x], axis=1)
    np.testing.assert_allclose(gradients, expected, atol=1e-9)
    assert np.abs(covariance).max() < 1e-12


def test_covariance_of_the_light_is_the_scatter(rng: np.random.Generator) -> None:
    lattice = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    found, stated = [], []
    for _ in range(200):
        gradients, covariance = light_gradients(lattice, 0.5 + rng.normal(scale=0.01, size=48))
        found.append(gradients)
        stated.append(np.einsum("nii->ni", covariance))
    ratio = np.var(found, axis=0) / np.mean(stated, axis=0)
    assert ratio.mean() == pytest.approx(1, abs=0.15)


def test_few_corners_leave_the_light_open() -> None:
    _, covariance = light_gradients(np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([0.4, 0.5, 0.6]))
    np.testing.assert_allclose(covariance, np.tile(0.05**2 * np.eye(2), (3, 1, 1)))


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0, 6.0])
def test_edge_width_of_a_blurred_step(sigma: float) -> None:
    """From 10 to 90 % of a Gaussian step are 2.563 sigma."""
    picture = np.full((200, 200), 40, np.float32)
    picture[:, 100:] = 200
    blurred = cv2.GaussianBlur(picture, (0, 0), sigma)
    assert edge_width_px(blurred) == pytest.approx(2.563 * sigma, rel=0.1)


def _why(pixels: FloatArray) -> str:
    image = Image(pixels=np.rint(pixels).astype(np.uint8), encoding="srgb", bits=8)
    return why_no_board(image, image.grey(), _TARGET)


def test_reasons(rng: np.random.Generator) -> None:
    y, x = np.mgrid[0:300, 0:400]
    checks = np.where((x // 40 + y // 40) % 2, 210.0, 40.0)
    assert "add light" in _why(60 + 0.1 * checks)
    assert "close the aperture" in _why(np.where(x > 250, 255.0, checks))
    blurred = cv2.GaussianBlur(checks, (0, 0), 7)
    assert "too blurred (edges 1" in _why(blurred)
    assert "show it whole" in _why(rng.integers(0, 250, (300, 400)).astype(np.float64))
    assert all("7x6" in _why(picture) for picture in (checks, blurred))

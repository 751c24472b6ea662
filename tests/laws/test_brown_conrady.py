"""The lens: inverse, derivatives, the fold, and OpenCV as oracle."""

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import BrownConrady

LENSES = {
    "pinhole": BrownConrady(fx=900, fy=905, cx=640.5, cy=355.2),
    "barrel": BrownConrady(
        fx=610, fy=602, cx=322, cy=238, k1=-0.28, k2=0.11, p1=1e-3, p2=-7e-4, k3=-0.02
    ),
    "pincushion": BrownConrady(
        fx=1500, fy=1490, cx=700, cy=500, k1=0.2, k2=-0.05, p1=-2e-3, p2=1e-3, k3=0.3
    ),
}

lenses = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())


def _points(rng: np.random.Generator, n_points: int = 300) -> FloatArray:
    """Up to 0.6 of the plane z = 1 from the axis (31 degrees), at 0.2 to 5 m."""
    radius, angle = rng.uniform(0, 0.6, n_points), rng.uniform(0, 2 * np.pi, n_points)
    plane = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(n_points)], axis=1)
    return plane * rng.uniform(0.2, 5, (n_points, 1))


@lenses
def test_pixels_and_rays_are_inverse(lens: BrownConrady, rng: np.random.Generator) -> None:
    points = _points(rng)
    pixels = lens.project(points)
    rays = lens.unproject(pixels)
    np.testing.assert_allclose(rays, points / points[:, 2:], atol=1e-11)
    np.testing.assert_allclose(lens.project(rays), pixels, atol=1e-9)  # px: the tolerance of Newton
    assert lens.sees(points).all()


@lenses
def test_opencv_projects_alike(lens: BrownConrady, rng: np.random.Generator) -> None:
    points = _points(rng)
    coeffs = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, coeffs)
    np.testing.assert_allclose(lens.project(points), expected[:, 0], atol=1e-9)  # px, rounding


@lenses
def test_jacobians_are_finite_differences(lens: BrownConrady, rng: np.random.Generator) -> None:
    points = _points(rng, 60)
    pixels, d_parameters, d_points = lens.project_with_jacobians(points)
    np.testing.assert_allclose(pixels, lens.project(points), atol=1e-12 * np.abs(pixels).max())
    for column, name in enumerate(lens.NAMES):
        # pixels are linear in every parameter: only rounding of 1e-13 px over the step remains
        step = np.zeros(9)
        step[column] = 1.0 if name in {"fx", "fy", "cx", "cy"} else 0.1
        ahead = BrownConrady.from_parameters(lens.parameters + step).project(points)
        back = BrownConrady.from_parameters(lens.parameters - step).project(points)
        slope = (ahead - back) / (2 * step[column])
        _same_column(d_parameters[:, :, column], slope)
    for column in range(3):
        step = np.zeros(3)
        step[column] = 1e-5  # m: second order 1e-10 / 0.2^3, rounding 1e-13 / 1e-5, of 1e3 px/m
        slope = (lens.project(points + step) - lens.project(points - step)) / 2e-5
        _same_column(d_points[:, :, column], slope)


def _same_column(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_behind_the_camera_is_nowhere() -> None:
    lens = LENSES["barrel"]
    points = np.array([[0.1, 0.1, 1.0], [0.1, 0.1, -1.0], [0.1, 0.1, 0.0]])
    assert np.isfinite(lens.project(points)).all(axis=1).tolist() == [True, False, False]
    assert lens.sees(points).tolist() == [True, False, False]
    pixels, _, _ = lens.project_with_jacobians(points)
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, False]


def test_beyond_the_fold_there_are_no_rays() -> None:
    """k1 = -0.3: r (1 - 0.3 r^2) rises to 0.7027 at r = 1 / sqrt(0.9) and falls from there."""
    lens = BrownConrady(fx=500, fy=500, cx=0, cy=0, k1=-0.3)
    fold = 1 / np.sqrt(0.9)
    highest_px = 500 * fold * (1 - 0.3 * fold**2)
    angle = np.linspace(0, 2 * np.pi, 7)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert np.isfinite(lens.unproject(ring * 0.99 * highest_px)).all()
    assert np.isnan(lens.unproject(ring * 1.01 * highest_px)).all()
    beyond = np.concatenate([ring * 1.2 * fold, np.ones((7, 1))], axis=1)
    assert not lens.sees(beyond).any()
    assert lens.sees(beyond * [0.8, 0.8, 1.0]).all()
    # a point beyond projects into the picture, but the ray of that pixel is the near one
    near = lens.unproject(lens.project(beyond))
    assert (np.linalg.norm(near[:, :2], axis=1) < fold).all()


def test_far_outside_pixels_do_not_spoil_their_neighbours() -> None:
    lens = LENSES["barrel"]
    pixels = np.array([[300.0, 200.0], [1e6, -1e6], [np.nan, 5.0], [400.0, 100.0]])
    rays = lens.unproject(pixels)
    assert np.isfinite(rays).all(axis=1).tolist() == [True, False, False, True]
    np.testing.assert_allclose(lens.project(rays[[0, 3]]), pixels[[0, 3]], atol=1e-9)


@lenses
def test_parameters_round_trip(lens: BrownConrady) -> None:
    assert BrownConrady.from_parameters(lens.parameters) == lens
    assert BrownConrady(**lens.as_dict()) == lens
    assert list(lens.as_dict()) == list(lens.NAMES)

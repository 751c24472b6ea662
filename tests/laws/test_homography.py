"""Homographies are recovered from the points they map."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import apply_homography, fit_homography


def _homography(rng: np.random.Generator) -> FloatArray:
    """Seen from the front: a turned and scaled square of 100 px with 20 % perspective."""
    angle, scale = rng.uniform(-np.pi, np.pi), rng.uniform(50, 200)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn = turn + rng.uniform(-0.2, 0.2, (2, 2)) * scale
    homography = np.eye(3)
    homography[:2, :2], homography[:2, 2] = turn, rng.uniform(0, 2000, 2)
    homography[2, :2] = rng.uniform(-0.2, 0.2, 2)
    return homography


@pytest.mark.parametrize("n_points", [4, 5, 54])
def test_exact_points_give_the_exact_homography(n_points: int, rng: np.random.Generator) -> None:
    for _ in range(50):
        truth = _homography(rng)
        corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
        source = np.concatenate([corners, rng.uniform(-1, 1, (n_points - 4, 2))])
        found = fit_homography(source, apply_homography(truth, source))
        # relative to the largest number; thanks to the normalisation only rounding remains
        np.testing.assert_allclose(found, truth, atol=1e-11 * np.abs(truth).max())


def test_units_do_not_matter(rng: np.random.Generator) -> None:
    """Without normalisation, points far from the origin cost six digits (Hartley 1997)."""
    truth = _homography(rng)
    source = rng.uniform(-1, 1, (30, 2))
    noisy = apply_homography(truth, source) + rng.normal(0, 0.3, (30, 2))
    plain = apply_homography(fit_homography(source, noisy), source)
    moved = fit_homography(source * 1e-3 + 7, noisy)
    np.testing.assert_allclose(apply_homography(moved, source * 1e-3 + 7), plain, atol=1e-6)


@pytest.mark.parametrize(("n_source", "n_target"), [(3, 3), (5, 4)])
def test_points_that_cannot_do_are_refused(n_source: int, n_target: int) -> None:
    with pytest.raises(ValueError, match="4 or more matching points"):
        fit_homography(np.zeros((n_source, 2)), np.zeros((n_target, 2)))

"""What a covariance means in pixels, and how far two lenses differ, rotations aside."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.geometry.comparison import projection_difference
from calichrome.geometry.lenses import BrownConrady, KannalaBrandt, Lens
from calichrome.geometry.uncertainty import (
    picture_grid,
    projection_covariances,
    projection_sigma_px,
)

_SIZE_WH = (1280, 960)
_LENSES: list[Lens] = [
    BrownConrady(fx=1000, fy=1010, cx=650, cy=470, k1=-0.2, k2=0.08, p1=1e-3, p2=-5e-4, k3=-0.01),
    KannalaBrandt(fx=400, fy=402, cx=640, cy=480, k1=0.02, k2=-0.005, k3=0.001, k4=0.0),
]


def _moved(lens: Lens, step: FloatArray) -> Lens:
    return type(lens).from_parameters(lens.parameters + step)


def _covariance(lens: Lens, rng: np.random.Generator) -> FloatArray:
    sigma = np.where(np.abs(lens.parameters) > 10, 0.1, 1e-4)
    root = rng.normal(size=(len(sigma), len(sigma))) * sigma[:, None] / 3
    return np.asarray(root @ root.T)


@pytest.mark.parametrize("lens", _LENSES, ids=lambda lens: lens.MODEL)
def test_differences_of_drawn_lenses_scatter_as_predicted(
    lens: Lens, rng: np.random.Generator
) -> None:
    cov = _covariance(lens, rng)
    n_draws = 400
    squares = np.zeros(len(picture_grid(_SIZE_WH)))
    for step in rng.multivariate_normal(np.zeros(len(cov)), cov, n_draws):
        difference, _ = projection_difference(lens, _moved(lens, step), _SIZE_WH)
        squares += (difference**2).sum(axis=1) / n_draws
    sigma = projection_sigma_px(lens, cov, _SIZE_WH)
    # the mean of 400 squares of one or two effective dimensions scatters by 7 %, its root by 3.5
    np.testing.assert_allclose(np.sqrt(squares), sigma, rtol=0.14)


@pytest.mark.parametrize("lens", _LENSES, ids=lambda lens: lens.MODEL)
def test_what_a_rotation_can_do_does_not_count(lens: Lens) -> None:
    """Near the axis a shift of the principal point is a rotation, and a focal length is not."""
    middle = picture_grid((41, 31)) + (np.array(_SIZE_WH) - 41) / 2
    cov = np.zeros((len(lens.parameters), len(lens.parameters)))
    cov[2, 2] = 1.0
    shift = projection_covariances(lens, cov, middle)
    assert np.sqrt(np.trace(shift, axis1=1, axis2=2)).max() < 0.01
    cov[2, 2], cov[0, 0] = 0.0, 1.0
    zoom = projection_covariances(lens, cov, middle)
    assert np.sqrt(np.trace(zoom, axis1=1, axis2=2)).max() > 0.01


def test_equal_lenses_do_not_differ() -> None:
    difference, rotvec = projection_difference(_LENSES[0], _LENSES[0], _SIZE_WH)
    assert np.abs(difference).max() < 1e-9
    assert np.linalg.norm(rotvec) < 1e-12


def test_a_shift_of_a_narrow_lens_is_a_rotation(rng: np.random.Generator) -> None:
    """At 4 degrees of view a pinhole that looks elsewhere differs by its principal point alone."""
    lens = BrownConrady(fx=20_000, fy=20_000, cx=639.5, cy=479.5)
    shift_px = rng.normal(scale=2, size=2)
    other = BrownConrady(fx=20_000, fy=20_000, cx=639.5 + shift_px[0], cy=479.5 + shift_px[1])
    difference, rotvec = projection_difference(lens, other, _SIZE_WH)
    # other shifts pixels by +shift, so rays are turned back: about y for x, about -x for y
    np.testing.assert_allclose(rotvec[:2] * 20_000, [shift_px[1], -shift_px[0]], rtol=2e-3)
    assert np.abs(difference).max() < 0.01

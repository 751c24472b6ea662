"""Rendered edges, discs and corners against integrals of the Gaussian and the square pixel."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from calichrome.core.arrays import FloatArray
from calichrome.synthetic.coverage import filter_radius_px
from calichrome.synthetic.planes import PlanePatch

_FAR = 100.0


def _patch(
    side: int, sigma_px: float, origin_xy: tuple[float, float], turn_rad: float = 0.0
) -> PlanePatch:
    """A plane of one pixel per metre, its origin and first axis somewhere in the picture."""
    padding = filter_radius_px(sigma_px) + 1
    line = np.arange(-padding, side + padding, dtype=np.float64)
    x, y = np.meshgrid(line - origin_xy[0], line - origin_xy[1])
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return PlanePatch((0, 0), padding, cos * x + sin * y, cos * y - sin * x, sigma_px)


def _normal_cdf(t: FloatArray) -> FloatArray:
    return np.asarray((1 + erf(t / math.sqrt(2))) / 2)


def _exact_edge(distance_px: FloatArray, turn_rad: float, sigma_px: float) -> FloatArray:
    """The Gaussian edge, averaged over 41 x 41 points of each pixel (error below 1e-5)."""
    inside = (np.arange(41) + 0.5) / 41 - 0.5
    x, y = np.meshgrid(inside, inside)
    shift = (math.cos(turn_rad) * x + math.sin(turn_rad) * y).ravel()
    return np.asarray(_normal_cdf((distance_px[..., None] + shift) / sigma_px).mean(axis=-1))


@settings(max_examples=40, deadline=None)
@given(
    phase=st.floats(0, 1),
    turn_rad=st.floats(-math.pi, math.pi),
    sigma_px=st.floats(0.5, 1.2),
)
def test_edge_profile_is_gaussian_and_pixel(phase: float, turn_rad: float, sigma_px: float) -> None:
    patch = _patch(16, sigma_px, (8 + phase, 7.7), turn_rad)
    cover = patch.rectangle((0, _FAR, -_FAR, _FAR))
    expected = _exact_edge(patch.u, turn_rad, sigma_px)
    # 4 x 4 samples and the Gaussian cut at 4 sigma leave 4e-4 at sigma 0.5: a tenth of an 8-bit
    # step. An edge snapped to samples would be off by up to 0.1.
    np.testing.assert_allclose(cover, expected, atol=8e-4)


@pytest.mark.parametrize("phase", [0.0, 0.1, 0.25, 0.37, 0.5, 0.81])
def test_half_crossing_is_on_the_edge(phase: float) -> None:
    patch = _patch(24, 0.65, (11 + phase, 12.0))
    profile = patch.rectangle((0, _FAR, -_FAR, _FAR))[12]
    # Pixel i covers i - 0.5 .. i + 0.5: the edge lies where the dark ends.
    crossing = 24 - profile.sum() - 0.5
    assert crossing == pytest.approx(11 + phase, abs=2e-5)  # float32 sums of 24 pixels


@pytest.mark.parametrize("radius_px", [3.0, 5.2, 11.0])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5])
def test_disc_keeps_area_and_centre(radius_px: float, phase: float) -> None:
    patch = _patch(40, 0.65, (19 + phase, 20.1), 0.2)
    cover = patch.disc((0, 0), radius_px)
    # 8e-4 of the area of the smallest disc is 1.2e-3 px of its radius.
    assert cover.sum() == pytest.approx(math.pi * radius_px**2, rel=8e-4)
    y, x = np.mgrid[:40, :40]
    centre = [(cover * x).sum() / cover.sum(), (cover * y).sum() / cover.sum()]
    np.testing.assert_allclose(centre, [19 + phase, 20.1], atol=1e-3)


@pytest.mark.parametrize("phase", [0.0, 0.22, 0.5, 0.77])
def test_corner_is_a_saddle_at_its_place(phase: float) -> None:
    """An upright corner is the product of two edges, exactly."""
    patch = _patch(30, 0.7, (14 + phase, 15.3))
    cover = patch.checkerboard((4, 4), (40.0, 40.0), black_first=True)
    across = 2 * _exact_edge(patch.u[0], 0.0, 0.7) - 1
    down = 2 * _exact_edge(patch.v[:, 0], 0.0, 0.7) - 1
    np.testing.assert_allclose(cover, (1 + down[:, None] * across) / 2, atol=5e-4)


def test_half_turn_about_a_corner_changes_nothing() -> None:
    for turn_rad in (0.1, 0.7, 1.3):
        patch = _patch(31, 0.6, (15.0, 15.0), turn_rad)
        cover = patch.checkerboard((6, 6), (60.0, 60.0), black_first=False)
        np.testing.assert_allclose(cover, cover[::-1, ::-1], atol=2e-6)  # float32


def test_checkerboard_areas() -> None:
    """The rim's edges lie where the squares end: areas are whole squares."""
    patch = _patch(64, 0.6, (20.3, 17.8), 0.05)
    cover = patch.checkerboard((4, 4), (10.0, 9.0), black_first=True)
    assert cover.sum() == pytest.approx(8 * 90, rel=1e-4)  # 16 squares, half of them black
    rectangle = patch.rectangle((-10, 30, -9, 27))
    assert rectangle.sum() == pytest.approx(16 * 90, rel=1e-4)


def test_patch_around_a_shape_holds_all_of_it() -> None:
    patch = _patch(60, 0.8, (30.0, 25.0), 0.3)
    bounds = (-6.0, 5.0, -4.0, 7.0)
    part = patch.around(bounds)
    assert part is not None
    whole = patch.rectangle(bounds)
    small = np.zeros_like(whole)
    small[part.slices] = part.rectangle(bounds)
    np.testing.assert_array_equal(small, whole * (small > 0))
    assert np.abs(small - whole).max() < 1e-4  # what lies beyond 4 sigma
    assert part.u.size < whole.size / 4
    assert patch.around((500, 510, 0, 10)) is None

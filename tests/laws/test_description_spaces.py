"""Description spaces against colour-science, and the metric as their small differences."""

from collections.abc import Callable

import colour
import numpy as np
import pytest
from colour.difference import delta_E_CIE1976, delta_E_CIE1994, delta_E_CIE2000

from calichrome.colorimetry.adaptation import D50, D65
from calichrome.colorimetry.description import (
    DESCRIPTION_SPACES,
    DescriptionSpace,
    difference,
    metric,
)
from calichrome.colorimetry.difference import xyz_from_lab
from calichrome.colorimetry.reference import cam16_ucs, colour_checker_spectra
from calichrome.colorimetry.reference import reflectance_to_xyz_d65 as integrated
from calichrome.core.arrays import FloatArray

every_space = pytest.mark.parametrize("space", DESCRIPTION_SPACES)
both_whites = pytest.mark.parametrize("white", [D65, D50], ids=["D65", "D50"])


@pytest.fixture
def colours(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """The patches of a ColorChecker over white, and neighbours some dE away."""
    spectra = np.array(list(colour_checker_spectra().values()))
    relative = integrated(spectra) / integrated(np.ones(81))
    return relative, relative * rng.normal(1, 0.05, relative.shape)


def _norm(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.asarray(a) - np.asarray(b), axis=-1))


def _lab(xyz: FloatArray, white: FloatArray) -> FloatArray:
    """Lab by colour-science; it names whites by their chromaticity."""
    return np.asarray(colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy(white)))


@both_whites
@pytest.mark.parametrize(
    ("space", "published"), [("lab76", delta_E_CIE1976), ("lab2000", delta_E_CIE2000)]
)
def test_lab_differences_are_the_published(
    space: DescriptionSpace,
    published: Callable[[FloatArray, FloatArray], FloatArray],
    white: FloatArray,
    colours: tuple[FloatArray, FloatArray],
) -> None:
    a, b = (white * item for item in colours)
    expected = published(_lab(a, white), _lab(b, white))
    # the oracle's constants of Lab are rounded to seven digits
    np.testing.assert_allclose(difference(a, b, space, white), expected, rtol=1e-5)


def test_cie94_is_the_published_where_chroma_is_equal(rng: np.random.Generator) -> None:
    """The standard weighs by the chroma of the first colour, ours by the mean of both."""
    lightness, chroma = rng.uniform(20, 90, (2, 40)), rng.uniform(0, 60, 40)
    hue = rng.uniform(0, 2 * np.pi, 40) + np.array([[0.0], [0.2]])
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
    a, b = xyz_from_lab(lab)
    expected = delta_E_CIE1994(lab[0], lab[1], textiles=False)
    np.testing.assert_allclose(difference(a, b, "lab94"), expected, rtol=1e-9)


def test_cie94_lies_between_its_two_readings(rng: np.random.Generator) -> None:
    lab = np.stack([np.array([50.0, 10.0, 5.0]), np.array([55.0, 40.0, 12.0])])
    lab = lab + rng.normal(0, 1, (30, 2, 3))
    a, b = (xyz_from_lab(lab[:, index]) for index in (0, 1))
    one, other = (
        delta_E_CIE1994(lab[:, i], lab[:, j], textiles=False) for i, j in ((0, 1), (1, 0))
    )
    ours = difference(a, b, "lab94")
    assert (np.minimum(one, other) < ours).all()
    assert (ours < np.maximum(one, other)).all()


def test_oklab_is_the_published(colours: tuple[FloatArray, FloatArray]) -> None:
    a, b = (D65 * item for item in colours)
    expected = 100 * _norm(colour.XYZ_to_Oklab(a), colour.XYZ_to_Oklab(b))
    # the oracle starts from XYZ through a matrix of fewer digits
    np.testing.assert_allclose(difference(a, b, "oklab"), expected, rtol=2e-3)


@both_whites
@pytest.mark.parametrize("space", ["oklab", "linear-srgb"])
def test_other_whites_are_adapted(
    space: DescriptionSpace, white: FloatArray, colours: tuple[FloatArray, FloatArray]
) -> None:
    """Greys under their white are greys under D65."""
    levels = np.array([0.1, 0.5, 1.0])[:, None]
    under_white = difference(levels * white, 0.8 * levels * white, space, white)
    np.testing.assert_allclose(
        under_white, difference(levels * D65, 0.8 * levels * D65, space), rtol=1e-9
    )
    assert difference(colours[0] * white, colours[0] * white, space, white).max() == 0


def test_linear_srgb_is_the_published(colours: tuple[FloatArray, FloatArray]) -> None:
    a, b = (D65 * item for item in colours)
    oracle = [colour.XYZ_to_RGB(xyz, "sRGB", apply_cctf_encoding=False) for xyz in (a, b)]
    # IEC 61966-2-1 prints its matrix with four digits
    np.testing.assert_allclose(difference(a, b, "linear-srgb"), 100 * _norm(*oracle), rtol=1e-3)


def test_xyz_counts_in_hundredths_of_white() -> None:
    black, white = np.zeros(3), D50
    assert difference(black, white, "xyz", D50) == pytest.approx(100 * np.sqrt(3))


@both_whites
def test_cam16_ucs_is_the_published(
    white: FloatArray, colours: tuple[FloatArray, FloatArray]
) -> None:
    """By the appearance model and the space of Li et al., an average surround."""
    a, b = (white * item for item in colours)
    oracle = [colour.XYZ_to_CAM16UCS(xyz, XYZ_w=white) for xyz in (a, b)]  # in sRGB's viewing
    np.testing.assert_allclose(difference(a, b, "cam16-ucs", white), _norm(*oracle), rtol=1e-6)
    np.testing.assert_allclose(cam16_ucs(white, white)[0], 100, rtol=1e-6)  # J' of white


@every_space
def test_differences_are_symmetric_and_vanish(
    space: DescriptionSpace, colours: tuple[FloatArray, FloatArray]
) -> None:
    a, b = (D65 * item for item in colours)
    np.testing.assert_allclose(difference(a, b, space), difference(b, a, space), rtol=1e-9)
    assert difference(a, a, space).max() == 0
    assert difference(a, b, space).shape == (24,)
    assert difference(a.reshape(4, 6, 3), b.reshape(4, 6, 3), space).shape == (4, 6)


@every_space
@both_whites
def test_metric_is_the_squared_difference(
    space: DescriptionSpace,
    white: FloatArray,
    colours: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> None:
    xyz = white * colours[0]
    form = metric(xyz, space, white)
    np.testing.assert_allclose(form, np.swapaxes(form, 1, 2), rtol=1e-12)
    assert (np.linalg.eigvalsh(form) > 0).all()
    for _ in range(10):
        step = 3e-5 * rng.normal(size=xyz.shape)
        both_ways = [difference(xyz, xyz + sign * step, space, white) ** 2 for sign in (1, -1)]
        expected = np.mean(both_ways, axis=0)
        found = np.einsum("ni,nij,nj->n", step, form, step)
        # the mean of both ways leaves what is of fourth order in a step of a hundredth of black
        np.testing.assert_allclose(found, expected, rtol=0.05)


@every_space
def test_black_is_a_colour(space: DescriptionSpace) -> None:
    """No slope is infinite there, or fits would not use dark discs, or nothing else."""
    dark = np.array([[0.0, 0.0, 0.0], [1e-3, 1e-3, 1e-3], [1e-3, 0.0, 0.0]])
    assert np.isfinite(difference(dark, D65, space)).all()
    assert np.isfinite(metric(dark, space)).all()

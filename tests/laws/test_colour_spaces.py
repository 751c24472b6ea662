"""Adaptation and output spaces: white stays white, and colour-science as oracle."""

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D50, D65, adapt
from calichrome.colorimetry.reference import (
    WAVELENGTHS_NM,
    _colour,
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
    observer,
    reflectance_to_xyz_d65,
)
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB

_SPACES = {"srgb": "sRGB", "display-p3": "Display P3"}


def test_white_goes_to_white() -> None:
    np.testing.assert_allclose(adapt(0.3 * D65, D65, D50), 0.3 * D50, atol=1e-15)


def test_adaptation_there_and_back(rng: np.random.Generator) -> None:
    xyz = rng.uniform(0, 1, (100, 3))
    np.testing.assert_allclose(adapt(adapt(xyz, D65, D50), D50, D65), xyz, atol=1e-14)
    np.testing.assert_allclose(adapt(xyz, D65, D65), xyz, atol=1e-14)


def test_colour_science_agrees_on_bradford(rng: np.random.Generator) -> None:
    xyz = rng.uniform(0, 1, (100, 3))
    for white_from, white_to in ((D65, D50), (D50, D65), (D65, np.array([1.0985, 1, 0.3558]))):
        expected = _colour().adaptation.chromatic_adaptation_VonKries(
            xyz, white_from, white_to, transform="Bradford"
        )
        np.testing.assert_allclose(adapt(xyz, white_from, white_to), expected, atol=1e-6)


def test_bradford_matrix_as_published() -> None:
    """B. Lindbloom, "Chromatic Adaptation": D65 to D50, printed to seven decimals."""
    published = [
        [1.0478112, 0.0228866, -0.0501270],
        [0.0295424, 0.9904844, -0.0170491],
        [-0.0092345, 0.0150436, 0.7521316],
    ]
    np.testing.assert_allclose(adapt(np.eye(3), D65, D50).T, published, atol=1e-6)


@pytest.mark.parametrize(("ours", "theirs"), _SPACES.items())
def test_colour_science_agrees_on_rgb_spaces(ours: str, theirs: str) -> None:
    space = _colour().RGB_COLOURSPACES[theirs]
    # Theirs has the white x = 0.3127, y = 0.3290 (Z = 1.08906), ours that of ASTM E308
    # (Z = 1.08883): entries differ by up to 2.3e-4 of a column that holds 0.95.
    tolerance = 3e-4
    np.testing.assert_allclose(XYZ_FROM_RGB[ours], space.matrix_RGB_to_XYZ, atol=tolerance)
    white_xyz = np.array([0.3127 / 0.3290, 1, (1 - 0.3127 - 0.3290) / 0.3290])
    scaled = XYZ_FROM_RGB[ours] @ np.diag(
        np.linalg.solve(XYZ_FROM_RGB[ours], white_xyz)
    )  # the same primaries with their white: only their four printed decimals remain
    np.testing.assert_allclose(scaled, space.matrix_RGB_to_XYZ, atol=1e-4)


@pytest.mark.parametrize("name", _SPACES)
def test_rgb_white_is_d65(name: str) -> None:
    np.testing.assert_allclose(XYZ_FROM_RGB[name] @ np.ones(3), D65, atol=1e-15)
    np.testing.assert_allclose(RGB_FROM_XYZ[name] @ D65, 1, atol=1e-14)


def test_perfect_diffuser_is_d65() -> None:
    xyz = reflectance_to_xyz_d65(np.ones((2, len(WAVELENGTHS_NM))))
    # 5 nm steps from 380 to 780 nm against ASTM's tables: 2e-4
    np.testing.assert_allclose(xyz, [D65, D65], atol=5e-4)


def test_spectra_share_their_wavelengths() -> None:
    n = len(WAVELENGTHS_NM)
    assert observer().shape == (n, 3)
    assert illuminant("D65").shape == (n,)
    assert illuminant("D65").mean() == pytest.approx(1)
    assert all(sensitivities.shape == (n, 3) for sensitivities in camera_sensitivities().values())


def test_colour_checker_is_the_known_chart() -> None:
    """L* of the grey row: 96.2, 81.2, 66.8, 50.8, 35.8, 20.7 (X-Rite, before November 2014)."""
    spectra = colour_checker_spectra()
    assert len(spectra) == 24
    assert all(((item > 0) & (item < 1)).all() for item in spectra.values())
    grey = np.stack(list(spectra.values())[18:])
    luminance = reflectance_to_xyz_d65(grey)[:, 1]
    lightness = 116 * np.cbrt(luminance) - 16
    # charts of one make differ by about 1 L*
    np.testing.assert_allclose(lightness, [96.2, 81.2, 66.8, 50.8, 35.8, 20.7], atol=1)

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.difference import delta_e_2000_xyz, lab_from_xyz
from calichrome.colorimetry.reference import (
    WAVELENGTHS_NM,
    colour_checker_spectra,
    observer,
    reflectance_to_xyz_d65,
)
from calichrome.synthetic import Scene, SceneError
from calichrome.synthetic.spectra import (
    black_ink,
    camera_response,
    light_spectrum,
    paper_white,
    printed_palette,
    random_reflectance,
    reflectance_from_xyz,
)
from calichrome.target import Target


def test_perfect_diffuser_is_white_under_d65() -> None:
    # 5 nm sums from 380 to 780 nm against the white of ASTM E308
    np.testing.assert_allclose(reflectance_to_xyz_d65(np.ones(81)), D65, atol=5e-4)


def test_light_spectrum_has_unit_luminance() -> None:
    for name in ("D65", "LED-B4", "FL2"):
        assert light_spectrum(name) @ observer()[:, 1] == pytest.approx(1)


def test_camera_response_is_the_sum_over_wavelengths(pair: Scene) -> None:
    surfaces = np.stack([np.ones(81), paper_white()])
    response = camera_response(pair, "Nikon 5100 (NPL)", surfaces)
    assert response.shape == (2, len(pair.spectra), 3)
    d65 = pair.spectra.index("D65")
    assert response[0, d65, 1] == pytest.approx(1)
    assert (response[1] < response[0]).all()
    grey = camera_response(pair, "Nikon 5100 (NPL)", np.full((1, 81), 0.18))
    np.testing.assert_allclose(grey[0], 0.18 * response[0])


def test_unknown_sensor_is_named(pair: Scene) -> None:
    with pytest.raises(SceneError, match="no sensitivities of a camera 'Brownie'"):
        camera_response(pair, "Brownie", np.ones((1, 81)))


def test_paper_and_ink_are_realistic() -> None:
    white, black = reflectance_to_xyz_d65(np.stack([paper_white(), black_ink()]))
    assert 0.83 < white[1] < 0.87
    assert 0.04 < black[1] < 0.05
    assert np.abs(lab_from_xyz(white)[1:]).max() < 2  # near neutral
    violet = paper_white()[WAVELENGTHS_NM < 400]
    assert (violet < 0.7 * paper_white()[40]).all()


def test_colour_checker_discs_have_their_own_spectra(target: Target) -> None:
    palette = printed_palette(target)
    for marker, reflectance in zip(target.markers, palette.discs, strict=True):
        np.testing.assert_array_equal(reflectance, colour_checker_spectra()[marker.name])
    np.testing.assert_allclose(
        reflectance_to_xyz_d65(palette.discs), target.marker_xyz_d65, atol=1e-12
    )


@pytest.mark.parametrize(
    "xyz", [(0.3, 0.35, 0.2), (0.2, 0.12, 0.05), (0.08, 0.06, 0.3), (0.88, 0.92, 0.98)]
)
def test_reflectance_from_xyz_has_that_colour(xyz: tuple[float, float, float]) -> None:
    reflectance = reflectance_from_xyz(np.array(xyz))
    np.testing.assert_allclose(reflectance_to_xyz_d65(reflectance), xyz, atol=1e-5)
    assert reflectance.min() >= 0
    assert reflectance.max() <= 1
    # Smooth: real surfaces of these colours bend by less than 0.05 from one 5 nm step to the next.
    assert np.abs(np.diff(reflectance, n=2)).max() < 0.05


def test_reflectance_stays_like_another() -> None:
    red = colour_checker_spectra()["red"]
    wanted = reflectance_to_xyz_d65(red) * [1.05, 1.02, 1.0]
    bent = reflectance_from_xyz(wanted, like=red)
    np.testing.assert_allclose(reflectance_to_xyz_d65(bent), wanted, atol=1e-5)
    assert np.abs(bent - red).max() < 0.1


def test_impossible_colour_is_refused() -> None:
    with pytest.raises(SceneError, match="no printable surface"):
        reflectance_from_xyz(np.array([0.05, 0.9, 0.05]))


def test_own_xyz_of_a_disc_is_printed(target: Target) -> None:
    own = replace(target.markers[3], xyz_d65=(0.15, 0.17, 0.08))
    other = replace(target.markers[4], name="house blue", xyz_d65=(0.2, 0.2, 0.4))
    palette = printed_palette(replace(target, markers=(own, other)))
    np.testing.assert_allclose(
        reflectance_to_xyz_d65(palette.discs), [own.xyz_d65, other.xyz_d65], atol=1e-5
    )


def test_palette_error_has_its_size(target: Target) -> None:
    palette = printed_palette(target, palette_error_lab_sd=2.0, seed=5)
    printed = reflectance_to_xyz_d65(palette.discs)
    step = lab_from_xyz(printed) - lab_from_xyz(target.marker_xyz_d65)
    # 72 normal values: their RMS is within 25 % (3 sigma); a shortened step only lowers it.
    assert 1.4 < np.sqrt((step**2).mean()) < 2.5
    assert delta_e_2000_xyz(printed, target.marker_xyz_d65).min() > 0
    again = printed_palette(target, palette_error_lab_sd=2.0, seed=5)
    np.testing.assert_array_equal(again.discs, palette.discs)
    other = printed_palette(target, palette_error_lab_sd=2.0, seed=6)
    assert np.abs(other.discs - palette.discs).max() > 1e-3


def test_random_reflectance_is_a_reflectance(rng: np.random.Generator) -> None:
    surfaces = np.stack([random_reflectance(rng) for _ in range(50)])
    assert surfaces.min() >= 0.05
    assert surfaces.max() <= 0.6

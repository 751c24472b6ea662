"""Stand-alone colour: one camera from one chart."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.reference import (
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
)
from calichrome.colour import ChartFit, fit
from calichrome.core.arrays import FloatArray
from calichrome.target import colour_checker_palette

CAMERA = "Nikon 5100 (NPL)"
PLACES = np.stack(np.meshgrid(np.arange(6) - 2.5, np.arange(4) - 1.5), axis=-1).reshape(-1, 2)
FOLIAGE, WHITE = 3, 18


@dataclass(frozen=True)
class Card:
    """What a detector would read."""

    rgb: FloatArray
    rgb_cov: FloatArray = field(default_factory=lambda: np.zeros((24, 3, 3)))
    clipped: FloatArray = field(default_factory=lambda: np.zeros(24))
    places: FloatArray = field(default_factory=lambda: PLACES)


@pytest.fixture(scope="module")
def card_rgb() -> FloatArray:
    """The ColorChecker in daylight, as a real sensor sees it; white at 80 %."""
    to_rgb = camera_sensitivities()[CAMERA] * illuminant("D65")[:, None]
    spectra = np.array(list(colour_checker_spectra().values()))
    return np.asarray(0.8 * spectra @ (to_rgb / to_rgb.sum(axis=0)))


@pytest.fixture(scope="module")
def reference() -> FloatArray:
    return np.array([colour.xyz_d65 for colour in colour_checker_palette()])


def fitted(result: ChartFit | str) -> ChartFit:
    assert isinstance(result, ChartFit), result
    return result


def codes(result: ChartFit) -> list[str]:
    return [doubt.code for doubt in result.doubts]


def test_matrix_is_recovered(rng: np.random.Generator, reference: FloatArray) -> None:
    matrix = np.array([[0.5, 0.2, 0.05], [0.2, 0.6, 0.1], [0.1, 0.05, 0.7]])
    result = fitted(fit(reference @ np.linalg.inv(matrix).T, reference, model="linear"))
    colours = rng.uniform(0, 1, (50, 3))
    np.testing.assert_allclose(result.xyz_from_rgb(colours), colours @ matrix.T, atol=1e-6)
    assert result.trustworthy
    assert not result.doubts


def test_even_light_and_no_veil_are_left_alone(card_rgb: FloatArray) -> None:
    result = fitted(fit(Card(card_rgb), colour_checker_palette()))
    np.testing.assert_array_equal(result.light.slope, 0)
    assert result.used.all()
    assert result.left_out_delta_e.mean() < 1.5
    assert result.trustworthy


@pytest.mark.parametrize("slope", [(0.08, 0.0), (-0.05, 0.08)])
@pytest.mark.parametrize("veil", [0.0, 0.04])
def test_light_and_veil_are_told_from_colour(
    card_rgb: FloatArray, slope: tuple[float, float], veil: float
) -> None:
    """A lamp at one side, stray light on top: the model must come out as without them."""
    plain = fitted(fit(Card(card_rgb), colour_checker_palette(), model="linear-white"))
    lit = card_rgb * (1 + PLACES @ np.array(slope))[:, None] + 0.8 * veil
    result = fitted(fit(Card(lit), colour_checker_palette(), model="linear-white"))
    np.testing.assert_allclose(result.light.slope, slope, atol=0.012)
    np.testing.assert_allclose(result.light.veil_rgb, 0.8 * veil, atol=0.006)
    assert result.left_out_delta_e.mean() < plain.left_out_delta_e.mean() + 0.2
    white = 0.8 * np.ones(3) + result.light.veil_rgb
    assert delta_e_2000_xyz(result.xyz_from_rgb(white), D65) < 1.5
    assert "uneven_light" in codes(result)


def test_leaf_over_a_third_of_the_card_is_contradicted(
    card_rgb: FloatArray, rng: np.random.Generator
) -> None:
    covered = np.array([0, 6, 7, 12, 13, 14, 18, 19])
    seen = card_rgb.copy()
    seen[covered] = card_rgb[FOLIAGE] * rng.uniform(0.8, 1.2, (8, 1))
    result = fitted(fit(Card(seen), colour_checker_palette()))
    assert not result.trustworthy
    assert "target_contradicted" in codes(result)
    # patches that a leaf hides well may be taken for themselves, but none of the others is blamed
    wrong = np.flatnonzero(~result.used)
    assert len(wrong) >= 6
    assert set(wrong) <= set(covered)


def test_two_dirty_patches_are_left_out(card_rgb: FloatArray) -> None:
    seen = card_rgb.copy()
    seen[[8, 17]] = card_rgb[[17, 8]]
    result = fitted(fit(Card(seen), colour_checker_palette()))
    assert result.trustworthy
    assert codes(result) == ["outliers_left_out"]
    assert set(np.flatnonzero(~result.used)) == {8, 17}
    assert "moderate_red" in result.doubts[0].text


def test_reference_of_another_order_is_contradicted(card_rgb: FloatArray) -> None:
    result = fit(Card(card_rgb), list(reversed(colour_checker_palette())))
    assert isinstance(result, str) or not result.trustworthy


def test_clipped_patches_are_left_out(card_rgb: FloatArray) -> None:
    exposed = np.asarray(np.minimum(card_rgb * 1.6, 1.0))
    clipped = np.asarray((card_rgb * 1.6 >= 1).any(axis=1), dtype=np.float64)
    assert clipped[WHITE]
    result = fitted(fit(Card(exposed, clipped=clipped), colour_checker_palette()))
    assert codes(result) == ["clipped_discs"]
    assert result.reasons[WHITE] == "clipped"
    assert result.left_out_delta_e[result.used].mean() < 1.5


def test_coded_values_taken_for_linear_are_doubted(card_rgb: FloatArray) -> None:
    result = fitted(fit(Card(encode(card_rgb, "srgb")), colour_checker_palette()))
    assert "encoding_doubtful" in codes(result)


def test_order_of_patches_does_not_matter(
    card_rgb: FloatArray, rng: np.random.Generator, reference: FloatArray
) -> None:
    order = rng.permutation(24)
    noisy = card_rgb * (1 + rng.normal(0, 0.01, card_rgb.shape))
    a = fitted(fit(Card(noisy), reference))
    b = fitted(fit(Card(noisy[order], places=PLACES[order]), reference[order]))
    assert a.model.MODEL == b.model.MODEL
    np.testing.assert_allclose(b.xyz, a.xyz[order], rtol=1e-4, atol=1e-5)


def test_exposure_does_not_matter(card_rgb: FloatArray, reference: FloatArray) -> None:
    a, b = (fitted(fit(Card(k * card_rgb), reference)) for k in (1.0, 0.3))
    np.testing.assert_allclose(b.xyz, a.xyz, rtol=1e-3, atol=1e-4)


def test_priorities_pull_the_fit(card_rgb: FloatArray) -> None:
    plain = fitted(fit(card_rgb, colour_checker_palette(), model="linear"))
    pulled = fitted(
        fit(card_rgb, colour_checker_palette(), model="linear", priorities={"cyan": 50.0})
    )
    cyan = 17
    assert pulled.fit_delta_e[cyan] < 0.5 * plain.fit_delta_e[cyan]


def test_too_few_patches_are_an_answer(card_rgb: FloatArray, reference: FloatArray) -> None:
    assert fit(card_rgb[:4], reference[:4]) == "only 4 of 4 patches are usable; auto needs 5"


def test_dead_channel_is_an_answer(card_rgb: FloatArray, reference: FloatArray) -> None:
    for dead in (card_rgb * np.array([1, 1, 0]), np.repeat(card_rgb[:, 1:2], 3, axis=1)):
        result = fit(dead, reference)
        assert isinstance(result, str)
        assert "needs a colour picture" in result


def test_wrong_calls(card_rgb: FloatArray, reference: FloatArray) -> None:
    with pytest.raises(ValueError, match="no patch is called pink"):
        fit(card_rgb, colour_checker_palette(), priorities={"pink": 2.0})
    with pytest.raises(ValueError, match="'magic' is unknown"):
        fit(card_rgb, reference, model="magic")
    with pytest.raises(ValueError, match=r"expected shape \(24, 3\)"):
        fit(card_rgb[:20], reference)

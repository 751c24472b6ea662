"""Tone curves from a board: the true one is found, and what no curve explains is doubted."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from calichrome.colorimetry.encoding import ENCODINGS, EncodingName, ToneCurve, encode
from calichrome.colorimetry.reference import (
    camera_sensitivities,
    colour_checker_spectra,
    illuminant,
    reflectance_to_xyz_d65,
)
from calichrome.colour.linearisation import CurveEstimate, estimate_curve, lightness_error
from calichrome.colour.tone_problem import ToneData, ToneProblem, ToneScales
from calichrome.colour.tone_spline import N_PARAMETERS, known_at, spline_at, spline_light
from calichrome.core.arrays import FloatArray, IntArray

_PAPER = 0.85  # reflectance of the white squares
_LUMA = np.array([0.299, 0.587, 0.114])
_STORED = np.arange(256) / 255

Curve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class _Board:
    stored: FloatArray
    light: FloatArray
    disc: IntArray
    nominal: FloatArray
    white: FloatArray

    def estimate(self) -> CurveEstimate:
        found = estimate_curve(self.stored, self.light, self.disc, self.nominal, self.white)
        assert isinstance(found, CurveEstimate)
        return found


def _board(
    curve: Curve, rng: np.random.Generator, *, n_views: int = 10, saturation: float = 1.0
) -> _Board:
    """24 discs in each view under lamps of 1 to 1/4, means of 30 pixels with 1 % noise, 8 bit."""
    sensor = camera_sensitivities()["Nikon 5100 (NPL)"] * illuminant("D65")[:, None]
    reflectance = np.stack(list(colour_checker_spectra().values()))
    ratio = reflectance @ sensor / sensor.sum(axis=0)
    levels = np.geomspace(0.25, 1, n_views) if n_views > 1 else np.ones(1)
    lit = np.concatenate([level * ratio for level in levels])
    white = np.repeat(levels, len(ratio))[:, None] * np.full(3, _PAPER)

    def seen(rgb: FloatArray) -> FloatArray:
        noisy = rgb[:, None] * (1 + 0.01 * rng.standard_normal((len(rgb), 30, 3)))
        coded = curve(np.clip(noisy, 0, 1))
        luma = (coded @ _LUMA)[..., None]
        coded = np.clip(luma + saturation * (coded - luma), 0, 1)
        return np.asarray((np.round(255 * coded) / 255).mean(axis=1))

    return _Board(
        stored=seen(lit),
        light=seen(white),
        disc=np.tile(np.arange(len(ratio)), n_views),
        nominal=reflectance_to_xyz_d65(reflectance),
        white=_PAPER * reflectance_to_xyz_d65(np.ones(len(illuminant("D65")))),
    )


def _s_shaped(rgb: FloatArray) -> FloatArray:
    coded = encode(rgb, "srgb")
    return 0.5 * coded + 0.5 * coded**2 * (3 - 2 * coded)


def _powers(rgb: FloatArray) -> FloatArray:
    return np.asarray(rgb ** (1 / np.array([1.7, 2.0, 2.4])))


def _table_of(curve: Curve) -> ToneCurve:
    linear = np.linspace(0, 1, 4001)
    coded = curve(np.stack([linear] * 3, axis=-1))
    channels = [np.interp(_STORED, coded[:, c], linear) for c in range(3)]
    return ToneCurve.from_table(_STORED, np.stack(channels, axis=1))


def _error(found: CurveEstimate, curve: Curve, board: _Board) -> float:
    """Largest error of greys in L*."""
    white = np.median(board.light, axis=0)
    return lightness_error(found.encoding, _table_of(curve), white, found.covered)


@pytest.mark.parametrize("name", list(ENCODINGS))
def test_known_encodings_are_named(name: EncodingName, rng: np.random.Generator) -> None:
    found = _board(lambda rgb: encode(rgb, name), rng).estimate()
    assert found.encoding == name
    assert found.doubts is None
    assert not found.deviations.size


# Half a unit of L*: just noticeable differences are above 1. One view has greys and colours alone.
@pytest.mark.parametrize(
    ("curve", "n_views", "limit"),
    [(_s_shaped, 10, 0.5), (_powers, 10, 0.5), (_s_shaped, 1, 1.0)],
    ids=["S-shaped", "a power per channel", "one view"],
)
def test_unknown_curves_are_found(
    curve: Curve, n_views: int, limit: float, rng: np.random.Generator
) -> None:
    board = _board(curve, rng, n_views=n_views)
    found = board.estimate()
    assert isinstance(found.encoding, ToneCurve)
    assert _error(found, curve, board) < limit
    assert found.doubts is None
    assert (found.level_dependence is None) == (n_views == 1)


def test_saturation_after_an_s_shaped_curve_is_doubted(rng: np.random.Generator) -> None:
    found = _board(_s_shaped, rng, saturation=1.6).estimate()
    assert found.doubts is not None
    assert "mixes the channels" in found.doubts


def test_saturation_after_a_power_does_no_harm(rng: np.random.Generator) -> None:
    # A matrix between two powers is homogeneous: the colour model takes it, and the curve is right.
    found = _board(lambda rgb: encode(rgb, "gamma2.2"), rng, saturation=1.4).estimate()
    assert found.encoding == "gamma2.2"
    assert found.doubts is None


def test_greys_off_their_nominal_levels_are_doubted(rng: np.random.Generator) -> None:
    board = _board(lambda rgb: encode(rgb, "srgb"), rng)
    wrong = board.nominal * np.exp(rng.normal(0, 0.3, (len(board.nominal), 1)))
    found = estimate_curve(board.stored, board.light, board.disc, wrong, board.white)
    assert isinstance(found, CurveEstimate)
    assert found.doubts is not None
    assert "target's colours" in found.doubts


def test_flare_is_told_from_the_curve(rng: np.random.Generator) -> None:
    found = _with_flare(_board(lambda rgb: encode(rgb, "srgb"), rng), 0.02).estimate()
    assert found.encoding == "srgb"
    # of the white's light: 0.02 of it was added to all, so that 1 / 1.02 of the rest is left
    assert found.flare == pytest.approx([0.02 / 1.02] * 3, abs=0.003)


def _with_flare(board: _Board, share: float) -> _Board:
    def veil(stored: FloatArray) -> FloatArray:
        light = ENCODINGS["srgb"].linearise(stored)
        white = ENCODINGS["srgb"].linearise(board.light)
        return encode((light + share * white) / (1 + share), "srgb")

    return _Board(veil(board.stored), veil(board.light), board.disc, board.nominal, board.white)


def test_rows_in_any_order_give_the_same(rng: np.random.Generator) -> None:
    board = _board(_s_shaped, rng, n_views=5)
    order = rng.permutation(len(board.disc))
    other = _Board(
        board.stored[order], board.light[order], board.disc[order], board.nominal, board.white
    )
    first, second = board.estimate().encoding, other.estimate().encoding
    assert isinstance(first, ToneCurve)
    assert isinstance(second, ToneCurve)
    np.testing.assert_allclose(first.linear, second.linear, atol=1e-6)


def test_clipped_and_missing_rows_do_not_count(rng: np.random.Generator) -> None:
    board = _board(lambda rgb: encode(rgb, "srgb"), rng)
    stored, light = board.stored.copy(), board.light.copy()
    stored[::7], stored[1::7], light[2::7] = np.nan, 1.0, np.nan
    found = _Board(stored, light, board.disc, board.nominal, board.white).estimate()
    assert found.encoding == "srgb"


def test_few_colours_are_refused(rng: np.random.Generator) -> None:
    board = _board(_s_shaped, rng)
    few = board.disc < 5
    found = estimate_curve(
        board.stored[few], board.light[few], board.disc[few], board.nominal, board.white
    )
    assert found == "only 5 different colours are usable, a tone curve needs 8"


@pytest.mark.slow
def test_sigma_covers_the_error() -> None:
    # Over draws of noise; the mismatch of the sensor is one draw, so inside is more than 95 %.
    truth, inside, count = _table_of(_s_shaped), 0, 0
    for seed in range(12):
        board = _board(_s_shaped, np.random.default_rng(seed))
        curve = board.estimate().encoding
        assert isinstance(curve, ToneCurve)
        white = np.median(board.light, axis=0)[None]
        at = np.stack([np.linspace(0.2, 0.9, 15)] * 3, axis=-1)
        relative = curve.linearise(at) / curve.linearise(white)
        sigma = curve.sigma_of(at) / curve.linearise(white)
        off = np.abs(relative - truth.linearise(at) / truth.linearise(white))
        inside += int((off < 1.96 * sigma).sum())
        count += off.size
    assert inside / count > 0.85


# The mathematics below.


@pytest.fixture
def parameters(rng: np.random.Generator) -> FloatArray:
    parameters = 0.5 * rng.standard_normal(N_PARAMETERS)
    parameters[0], parameters[-1] = 1.2, 0.002
    return parameters


def test_any_parameters_give_a_rising_curve(rng: np.random.Generator) -> None:
    for _ in range(50):
        light, _ = spline_light(0.3 * rng.standard_normal(N_PARAMETERS), _STORED)
        assert (np.diff(light) > 0).all()


def test_curve_derivatives(parameters: FloatArray) -> None:
    stored = np.linspace(0.05, 0.95, 9)
    at = spline_at(parameters, stored)
    for index in range(N_PARAMETERS):
        step = np.zeros(N_PARAMETERS)
        step[index] = 1e-6
        up, down = spline_at(parameters + step, stored), spline_at(parameters - step, stored)
        light = (up.log_light - down.log_light) / 2e-6
        slope = (up.log_slope - down.log_slope) / 2e-6
        np.testing.assert_allclose(at.light_jacobian[:, index], light, atol=1e-6)
        np.testing.assert_allclose(at.slope_jacobian[:, index], slope, atol=1e-6)


@pytest.mark.parametrize("name", list(ENCODINGS))
def test_slopes_of_known_curves(name: EncodingName) -> None:
    stored = np.linspace(0.1, 0.95, 18)
    up, down = known_at(name, stored + 1e-5), known_at(name, stored - 1e-5)
    slope = (up.log_light - down.log_light) / 2e-5
    np.testing.assert_allclose(np.exp(known_at(name, stored).log_slope), slope, rtol=1e-4)


@pytest.mark.parametrize("n_curves", [1, 3])
def test_gradient_is_that_of_the_cost(n_curves: int, rng: np.random.Generator) -> None:
    board = _board(_s_shaped, rng, n_views=3)
    relative = board.nominal / board.white
    n_discs = len(relative)
    data = ToneData(
        stored=board.stored,
        light=board.light,
        sigma=np.full_like(board.stored, 0.001),
        light_sigma=np.full_like(board.stored, 0.0005),
        disc=board.disc,
        terms=relative,
        white_terms=np.ones((1, 3)),
        chroma=np.full(n_discs, 20.0),
        copies=np.ones(n_discs),
        nominal_sigma=np.zeros(n_discs),
    )
    problem = ToneProblem(data, spline_at, n_curves)
    scales = ToneScales(noise=0.003, mismatch=0.01, bend=0.3, drift=0.01)
    state = problem.start()
    problem.look(state)
    state = state + 1e-3 * rng.standard_normal(len(state))
    gradient = problem.linearise(state, scales).gradient
    for index in range(0, len(state), 7):
        step = np.zeros(len(state))
        step[index] = 1e-6
        up, down = (problem.linearise(state + sign * step, scales).cost for sign in (1, -1))
        expected = (up - down) / 2e-6
        assert gradient[index] == pytest.approx(expected, rel=1e-3, abs=0.05)

"""What changed of a camera's colour: told by the simplest explanation, and of the right camera."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.adaptation import D65
from calichrome.colour.drift import (
    ColourDrifts,
    ExpectedDiscs,
    KnownColour,
    find_colour_drift,
)
from calichrome.colour.models.linear import Linear
from calichrome.colour.nested import compare_nested, white_keeping_matrix, white_keeping_terms
from calichrome.colour.samples import ColourSamples
from calichrome.core.arrays import FloatArray
from calichrome.target import Target

_WHITE_RGB = np.array([0.7, 0.8, 0.6])
_RGB_FROM_XYZ = np.array([[1.6, -0.4, -0.2], [-0.5, 1.4, 0.1], [0.0, -0.1, 1.05]])
_SATURATION = np.array([[1.20, -0.12, -0.08], [-0.08, 1.16, -0.08], [-0.06, -0.16, 1.22]])
_NOISE = 0.003  # relative: some dozens of pixels of 8 bits

Change = Callable[[FloatArray], FloatArray]


def _rgb(xyz: FloatArray) -> FloatArray:
    return np.asarray(xyz @ _RGB_FROM_XYZ.T / (_RGB_FROM_XYZ @ D65) * _WHITE_RGB)


_KNOWN = KnownColour(
    model=Linear.from_matrix(np.linalg.inv(_RGB_FROM_XYZ) * (_RGB_FROM_XYZ @ D65) / _WHITE_RGB),
    white_rgb=_WHITE_RGB,
    vignetting=None,
    missed=0.0,
)


def _expected(target: Target) -> ExpectedDiscs:
    names = [marker.name for marker in target.markers]
    return ExpectedDiscs(
        xyz=target.marker_xyz_d65,
        cov=np.zeros((len(names), 3, 3)),
        colour=np.unique(names, return_inverse=True)[1],
    )


def _samples(
    target: Target, light: FloatArray, change: Change | None, rng: np.random.Generator
) -> ColourSamples:
    """One picture under a light (n, 3) on the board."""
    n = len(target.markers)
    rgb, white = _rgb(target.marker_xyz_d65) * light, _WHITE_RGB * light
    if change is not None:
        rgb, white = change(rgb), change(white)
    rgb = rgb * rng.normal(1, _NOISE, (n, 3))
    return ColourSamples(
        frame_ids=("new",),
        view=np.zeros(n, dtype=np.int64),
        marker_ids=np.arange(n),
        rgb=rgb,
        light_rgb=white,
        reference_light_rgb=np.median(white, axis=0),
        n_px=np.full(n, 60),
        clipped=np.zeros(n),
        cov_rgb=(_NOISE * rgb[:, :, None] * np.eye(3)) ** 2,
    )


def _fall_off(target: Target) -> FloatArray:
    return np.linspace(1.2, 0.7, len(target.markers))


def _found(
    target: Target, rng: np.random.Generator, changes: Mapping[str, Change | None]
) -> ColourDrifts:
    """Cameras under one light that falls off over the board."""
    fall_off = _fall_off(target)[:, None] * np.ones(3)
    samples = {
        camera: _samples(target, fall_off, change, rng) for camera, change in changes.items()
    }
    found = find_colour_drift(samples, dict.fromkeys(changes, _KNOWN), _expected(target))
    assert found is not None
    return found


def _half(rgb: FloatArray) -> FloatArray:
    return np.asarray(0.5 * rgb)


def _warm(rgb: FloatArray) -> FloatArray:
    return np.asarray(rgb * np.array([1.1, 1.0, 0.9]))


def _saturate(rgb: FloatArray) -> FloatArray:
    return np.asarray((rgb / _WHITE_RGB) @ _SATURATION.T * _WHITE_RGB)


@pytest.mark.parametrize(
    ("change", "kind"),
    [(None, "nothing"), (_half, "exposure"), (_warm, "white balance"), (_saturate, "matrix")],
)
def test_the_camera_that_changed_is_named(
    standard_target: Target, rng: np.random.Generator, change: Change | None, kind: str
) -> None:
    found = _found(standard_target, rng, {"a": None, "b": change, "c": None})
    assert {camera: item.change for camera, item in found.cameras.items()} == {
        "a": "nothing", "b": kind, "c": "nothing",
    }  # fmt: skip
    level = np.exp(np.log(_fall_off(standard_target)).mean())
    assert found.light.level == pytest.approx(level, abs=1e-3)
    assert found.light.unevenness == pytest.approx(1.2 / 0.7 - 1, rel=0.01)


def test_the_size_of_a_change_is_recovered(
    standard_target: Target, rng: np.random.Generator
) -> None:
    def all_of_it(rgb: FloatArray) -> FloatArray:
        return 0.6 * _warm(_saturate(rgb))

    item = _found(standard_target, rng, {"a": None, "b": all_of_it, "c": None}).cameras["b"]
    assert item.change == "matrix"
    np.testing.assert_allclose(item.balance * item.exposure, 0.6 * np.array([1.1, 1, 0.9]), 0.01)
    np.testing.assert_allclose(item.matrix, _SATURATION, atol=0.02)
    assert item.delta_e == pytest.approx(3.5, abs=1.5)


def test_a_change_of_all_cameras_is_the_light(
    standard_target: Target, rng: np.random.Generator
) -> None:
    found = _found(standard_target, rng, {"a": _half, "b": _half})
    assert {item.change for item in found.cameras.values()} == {"nothing"}
    level = np.exp(np.log(_fall_off(standard_target)).mean())
    assert found.light.level == pytest.approx(0.5 * level, abs=1e-3)


def test_one_camera_cannot_tell_exposure_from_light(
    standard_target: Target, rng: np.random.Generator
) -> None:
    item = _found(standard_target, rng, {"a": _half}).cameras["a"]
    assert item.alone
    assert item.exposure_chance is None
    assert item.change == "nothing"
    assert _found(standard_target, rng, {"a": _warm}).cameras["a"].change == "white balance"


def test_what_was_missed_in_the_calibration_is_no_change(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """A rig that was made to look like one of its cameras never showed the target's colours."""
    light = np.ones((len(standard_target.markers), 3))
    samples = {"a": _samples(standard_target, light, _saturate, rng)}
    told = []
    for missed in (0.0, 6.0):
        known = {"a": replace(_KNOWN, missed=missed)}
        found = find_colour_drift(samples, known, _expected(standard_target))
        assert found is not None
        told.append(found.cameras["a"].change)
    assert told == ["matrix", "nothing"]


def test_a_finger_on_the_board_is_no_change(
    standard_target: Target, rng: np.random.Generator
) -> None:
    def covered(rgb: FloatArray) -> FloatArray:
        if len(rgb) > 1:
            rgb = rgb.copy()
            rgb[:4] = [0.4, 0.25, 0.18]
        return rgb

    light = np.ones((len(standard_target.markers), 3))
    clean = _samples(standard_target, light, None, rng)
    samples = {"a": replace(clean, rgb=covered(clean.rgb))}
    found = find_colour_drift(samples, {"a": _KNOWN}, _expected(standard_target))
    assert found is not None
    assert found.cameras["a"].change == "nothing"


def test_nothing_to_compare(standard_target: Target) -> None:
    assert find_colour_drift({}, {"a": _KNOWN}, _expected(standard_target)) is None


# --- the test behind it ---------------------------------------------------------------------------


def test_terms_are_those_of_the_matrix(rng: np.random.Generator) -> None:
    colours, coefficients = rng.uniform(0, 1, (9, 3)), rng.normal(0, 0.1, 6)
    matrix = white_keeping_matrix(coefficients)
    np.testing.assert_allclose(
        colours + white_keeping_terms(colours) @ coefficients, colours @ matrix.T
    )
    np.testing.assert_allclose(matrix @ np.ones(3), 1)


def test_chance_is_uniform_where_nothing_changed(rng: np.random.Generator) -> None:
    """A thousand draws: 5 % and 1 % have standard deviations of 0.7 % and 0.3 %."""
    colours = rng.uniform(0, 1, (24, 3))
    narrow = colours[:, :, None] * np.eye(3)
    extra = white_keeping_terms(colours)
    chances = np.array(
        [compare_nested(rng.normal(0, 2, (24, 3)), narrow, extra).chance for _ in range(1000)]
    )
    assert np.mean(chances < 0.05) == pytest.approx(0.05, abs=0.025)
    assert np.mean(chances < 0.01) == pytest.approx(0.01, abs=0.01)


def test_covariance_of_a_change_covers_it(rng: np.random.Generator) -> None:
    colours = rng.uniform(0, 1, (24, 3))
    extra = white_keeping_terms(colours)
    narrow = colours[:, :, None] * np.eye(3)
    true = rng.normal(0, 0.2, 6)
    z2 = []
    for _ in range(300):
        fit = compare_nested(extra @ true + rng.normal(0, 0.05, (24, 3)), narrow, extra)
        z2.append((fit.extra - true) @ np.linalg.solve(fit.extra_cov, fit.extra - true))
    assert np.mean(z2) == pytest.approx(6, rel=0.2)  # chi-square of 6, its mean over 300


def test_too_few_data_say_nothing() -> None:
    colours = np.eye(3)
    fit = compare_nested(colours, colours[:, :, None] * np.eye(3), white_keeping_terms(colours))
    assert fit.chance == 1

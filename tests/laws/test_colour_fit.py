"""The 3x3 fit, and what "held out" means."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.fit import ColourSolution, between_cameras, fit_colour
from calichrome.colour.models import MODELS, Linear
from calichrome.colour.samples import ColourSamples
from calichrome.core.arrays import FloatArray
from calichrome.target import Target

_MATRIX = np.array([[0.5, 0.3, 0.15], [0.25, 0.65, 0.1], [0.02, 0.1, 0.95]])


def _samples(rgb: FloatArray) -> ColourSamples:
    """One view of every disc in even light."""
    n = len(rgb)
    return ColourSamples(
        frame_ids=("0",),
        view=np.zeros(n, dtype=np.int64),
        marker_ids=np.arange(n),
        rgb=rgb,
        light_rgb=np.full((n, 3), 0.8),
        reference_light_rgb=np.full(3, 0.8),
        n_px=np.full(n, 100),
        clipped=np.zeros(n),
    )


def _rgb(target: Target) -> FloatArray:
    return np.asarray(target.marker_xyz_d65 @ np.linalg.inv(_MATRIX).T)


def _solved(rgb: FloatArray, target: Target) -> ColourSolution:
    solution = fit_colour(_samples(rgb), target)
    assert isinstance(solution, ColourSolution)
    return solution


def test_exact_data_give_the_exact_matrix(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0, 1, (24, 3))
    fitted = Linear.fit(rgb, rgb @ _MATRIX.T)
    np.testing.assert_allclose(fitted.matrix, _MATRIX, atol=1e-12)
    pixels = rng.uniform(0, 1, (4, 5, 3))
    np.testing.assert_allclose(fitted.apply(pixels), pixels @ _MATRIX.T, atol=1e-12)


@pytest.mark.parametrize("gain", [0.25, 4.0])
def test_exposure_only_scales(gain: float, rng: np.random.Generator) -> None:
    rgb, xyz = rng.uniform(0, 1, (2, 24, 3))
    plain, brighter = Linear.fit(rgb, xyz), Linear.fit(gain * rgb, xyz)
    np.testing.assert_allclose(brighter.apply(gain * rgb), plain.apply(rgb), atol=1e-12)


@pytest.mark.parametrize("name", list(MODELS))
def test_models_survive_their_file(name: str, rng: np.random.Generator) -> None:
    rgb, xyz = rng.uniform(0, 1, (2, 24, 3))
    fitted = MODELS[name].fit(rgb, xyz)
    assert name == fitted.MODEL
    read = MODELS[name].from_json(fitted.to_json())
    np.testing.assert_array_equal(read.apply(rgb), fitted.apply(rgb))


def test_exact_cameras_have_no_error(standard_target: Target) -> None:
    solution = _solved(_rgb(standard_target), standard_target)
    np.testing.assert_allclose(solution.disc_xyz, standard_target.marker_xyz_d65, atol=1e-12)
    # near black, dE grows by 900 per unit of XYZ
    np.testing.assert_allclose(solution.fit_delta_e, 0, atol=1e-9)
    np.testing.assert_allclose(solution.held_out_delta_e, 0, atol=1e-9)


def test_held_out_is_predicted_by_the_others(
    standard_target: Target, rng: np.random.Generator
) -> None:
    rgb = _rgb(standard_target) * rng.normal(1, 0.05, (len(standard_target.markers), 3))
    solution = _solved(rgb, standard_target)
    xyz = standard_target.marker_xyz_d65
    for index in (0, 7, 20):
        rest = (xyz != xyz[index]).any(axis=1)
        predicted = Linear.fit(rgb[rest], xyz[rest]).apply(rgb[index])
        expected = delta_e_2000_xyz(predicted, xyz[index])
        assert solution.held_out_delta_e[index] == pytest.approx(expected, abs=1e-9)


def test_a_disc_does_not_vouch_for_its_twin(standard_target: Target) -> None:
    """A colour measured wrongly, alike on two discs: each shows the error of a stranger."""
    once = replace(standard_target, markers=standard_target.markers[:12])
    first = once.markers[2]
    free = next(
        (ix, iy)
        for ix in range(once.squares[0])
        for iy in range(once.squares[1])
        if once.square_colour(ix, iy) == first.background
        and (ix, iy) not in {marker.square for marker in standard_target.markers}
    )
    twice = replace(once, markers=(*once.markers, replace(first, square=free)))
    rgb = _rgb(once)
    rgb[2] *= [1.5, 0.8, 1.1]
    alone = _solved(rgb, once).held_out_delta_e[2]
    twins = _solved(np.concatenate([rgb, rgb[2:3]]), twice)
    assert twins.held_out_delta_e[[2, 12]] == pytest.approx([alone, alone], abs=1e-9)
    # the fit itself does bend towards a colour that stands twice
    assert twins.fit_delta_e[2] < 0.95 * _solved(rgb, once).fit_delta_e[2]


def test_discs_not_seen_have_no_error(standard_target: Target) -> None:
    rgb = _rgb(standard_target)
    samples = _samples(rgb)
    clipped = samples.clipped.copy()
    clipped[5] = 0.2
    solution = fit_colour(replace(samples, clipped=clipped), standard_target)
    assert isinstance(solution, ColourSolution)
    assert np.flatnonzero(np.isnan(solution.fit_delta_e)).tolist() == [5]
    assert np.flatnonzero(np.isnan(solution.held_out_delta_e)).tolist() == [5]
    assert solution.n_clipped == 1


def test_too_few_colours_are_an_answer(standard_target: Target) -> None:
    few = replace(standard_target, markers=standard_target.markers[:4])
    assert fit_colour(_samples(_rgb(few)), few) == (
        "only 4 different colours are usable, a linear fit needs 5"
    )


def test_differences_between_cameras_are_pairwise(standard_target: Target) -> None:
    rgb = _rgb(standard_target)
    solution = _solved(rgb, standard_target)
    brighter = replace(solution, disc_xyz=1.1 * solution.disc_xyz)
    unseen = 1.2 * solution.disc_xyz
    unseen[3] = np.nan
    third = replace(solution, disc_xyz=unseen)
    n = len(rgb)
    found = between_cameras({"a": solution, "b": brighter, "c": third})
    assert len(found) == n + 2 * (n - 1)
    expected = delta_e_2000_xyz(solution.disc_xyz, brighter.disc_xyz)
    np.testing.assert_allclose(found[:n], expected)
    assert between_cameras({"a": solution}).shape == (0,)

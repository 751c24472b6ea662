"""The colour of a rig from rows of discs, and what "held out" means."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.families import fit_model
from calichrome.colour.models.linear import Linear
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.colour.rig_fit import (
    ColourSettings,
    ColourSolution,
    between_cameras,
    fit_rig_colour,
)
from calichrome.colour.samples import ColourSamples
from calichrome.core.arrays import FloatArray
from calichrome.target import Paper, Target

_MATRIX = np.array([[0.5, 0.3, 0.15], [0.25, 0.65, 0.1], [0.02, 0.1, 0.95]])
_LINEAR = ColourSettings(model="linear")


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


def _solved(rgb: FloatArray, target: Target, settings: ColourSettings = _LINEAR) -> ColourSolution:
    solution = fit_rig_colour({"cam0": _samples(rgb)}, target, settings)["cam0"]
    assert isinstance(solution, ColourSolution)
    return solution


def test_exact_data_give_the_exact_matrix(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.05, 1, (24, 3))
    fitted, _ = fit_terms(Linear, ColourPairs.of(rgb, rgb @ _MATRIX.T))
    np.testing.assert_allclose(fitted.matrix, _MATRIX, atol=1e-9)
    pixels = rng.uniform(0, 1, (4, 5, 3))
    np.testing.assert_allclose(fitted.apply(pixels), pixels @ _MATRIX.T, atol=1e-9)
    given = Linear.from_matrix(_MATRIX)
    np.testing.assert_array_equal(given.matrix, _MATRIX)
    np.testing.assert_allclose(given.apply(pixels), pixels @ _MATRIX.T, atol=1e-15)


@pytest.mark.parametrize("gain", [0.25, 4.0])
@pytest.mark.parametrize("name", ["linear", "linear-white", "root-polynomial-2-white"])
def test_exposure_only_scales(
    name: str, gain: float, standard_target: Target, rng: np.random.Generator
) -> None:
    """A whole recording at another exposure gives the same corrected colours."""
    rgb = _rgb(standard_target) * rng.normal(1, 0.03, (len(standard_target.markers), 3))
    settings = ColourSettings(model=name)
    plain, brighter = (_solved(k * rgb, standard_target, settings) for k in (1.0, gain))
    np.testing.assert_allclose(brighter.disc_xyz, plain.disc_xyz, atol=1e-9)
    np.testing.assert_allclose(brighter.held_out_xyz, plain.held_out_xyz, atol=1e-9)


@pytest.mark.parametrize("model", ["linear", "linear-white", "auto"])
def test_exact_cameras_have_no_error(model: str, standard_target: Target) -> None:
    paper = np.array([0.80, 0.85, 0.88])
    target = replace(standard_target, paper=Paper(white_xyz_d65=(0.80, 0.85, 0.88)))
    light = np.linalg.inv(_MATRIX) @ paper
    rgb = _rgb(target)
    samples = replace(
        _samples(rgb), light_rgb=np.tile(light, (len(rgb), 1)), reference_light_rgb=light
    )
    solution = fit_rig_colour({"a": samples}, target, ColourSettings(model=model))["a"]
    assert isinstance(solution, ColourSolution)
    np.testing.assert_allclose(solution.disc_xyz, target.marker_xyz_d65, atol=1e-9)
    # near black, dE grows by 900 per unit of XYZ
    np.testing.assert_allclose(solution.fit_delta_e, 0, atol=1e-6)
    np.testing.assert_allclose(solution.held_out_delta_e, 0, atol=1e-6)


def test_held_out_is_predicted_by_the_others(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """By plain algebra: rows of all other colours, weighed as in the fit."""
    rgb = _rgb(standard_target) * rng.normal(1, 0.05, (len(standard_target.markers), 3))
    solution = _solved(rgb, standard_target)
    xyz, first, of_marker = np.unique(
        standard_target.marker_xyz_d65, axis=0, return_index=True, return_inverse=True
    )
    mean_rgb = np.array([rgb[np.ravel(of_marker) == colour].mean(axis=0) for colour in range(24)])
    pairs = ColourPairs.of(mean_rgb, xyz)
    for colour in (0, 7, 20):
        rest = np.arange(24) != colour
        predicted = fit_model("linear", pairs[rest]).apply(mean_rgb[colour])
        expected = delta_e_2000_xyz(predicted, xyz[colour])
        # the tolerance of the print shifts the weights of dark colours against bright ones
        assert solution.held_out_delta_e[first[colour]] == pytest.approx(expected, rel=0.1)


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


def test_discs_not_seen_have_no_error(standard_target: Target) -> None:
    rgb = _rgb(standard_target)
    samples = _samples(rgb)
    clipped = samples.clipped.copy()
    clipped[5] = 0.2
    found = fit_rig_colour({"a": replace(samples, clipped=clipped)}, standard_target, _LINEAR)["a"]
    assert isinstance(found, ColourSolution)
    for values in (found.fit_delta_e, found.held_out_delta_e, found.uncertainty_delta_e):
        assert np.flatnonzero(np.isnan(values)).tolist() == [5]
    assert (found.n_clipped, found.n_rejected) == (1, 0)


@pytest.mark.parametrize(("model", "least"), [("auto", 5), ("linear", 4), ("hue-plane", 6)])
def test_too_few_colours_are_an_answer(model: str, least: int, standard_target: Target) -> None:
    few = replace(standard_target, markers=standard_target.markers[: least - 1])
    samples = {"cam0": _samples(_rgb(few))}
    assert fit_rig_colour(samples, few, ColourSettings(model=model)) == {
        "cam0": f"only {least - 1} different colours are usable, a {model} fit needs {least}"
    }


def test_grey_pictures_are_an_answer(standard_target: Target) -> None:
    grey = np.repeat(_rgb(standard_target)[:, 1:2], 3, axis=1)
    both = {"grey": _samples(grey), "colour": _samples(_rgb(standard_target))}
    found = fit_rig_colour(both, standard_target, _LINEAR)
    assert found["grey"] == "its pictures are grey: all three channels are equal"
    assert isinstance(found["colour"], ColourSolution)
    assert list(found) == ["grey", "colour"]


@pytest.mark.parametrize("model", ["linear-white", "root-polynomial-2-white", "hue-plane"])
def test_known_paper_stays_the_paper(
    model: str, standard_target: Target, rng: np.random.Generator
) -> None:
    """The white squares' reading becomes the measured paper, whatever the discs say."""
    paper_xyz = (0.80, 0.85, 0.88)
    rgb = _rgb(standard_target) * rng.normal(1, 0.05, (len(standard_target.markers), 3))
    samples = replace(_samples(rgb), reference_light_rgb=np.array([0.7, 0.8, 0.75]))
    target = replace(standard_target, paper=Paper(white_xyz_d65=paper_xyz))
    found = fit_rig_colour({"a": samples}, target, ColourSettings(model=model))["a"]
    assert isinstance(found, ColourSolution)
    white = found.model.apply(found.white_rgb)
    np.testing.assert_allclose(white, np.array(paper_xyz), atol=1e-12)


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
    held = replace(brighter, held_out_xyz=1.3 * solution.held_out_xyz)
    np.testing.assert_allclose(
        between_cameras({"a": solution, "b": held}, held_out=True),
        delta_e_2000_xyz(solution.held_out_xyz, held.held_out_xyz),
    )

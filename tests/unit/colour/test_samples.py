"""Discs over their views."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.colour.flare import measure_additive
from calichrome.colour.samples import (
    ColourSamples,
    collect_samples,
    combine_views,
    disc_means,
)
from calichrome.colour.shading import Vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.observations import BoardView, DiscSamples
from calichrome.target import Target

_LIGHT = np.array([0.5, 0.6, 0.4])


def _view(level: float, rgb: FloatArray, *, white_known: bool = True) -> BoardView:
    """Discs `rgb` (relative to white) in light of `level`."""
    n = len(rgb)
    white = np.broadcast_to(level * _LIGHT, (n, 3)) if white_known else np.full((n, 3), np.nan)
    discs = DiscSamples(
        marker_ids=np.arange(n),
        centres_px=np.stack([np.arange(n) * 10.0, np.arange(n) % 3 * 7.0], axis=1),
        mean_rgb=rgb * level * _LIGHT,
        median_rgb=rgb * level * _LIGHT,
        cov_rgb=np.zeros((n, 3, 3)),
        n_px=np.full(n, 50),
        clipped=np.zeros(n),
        white_rgb=np.array(white),
        black_rgb=np.zeros((n, 3)),
    )
    return BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)), discs=discs)


def _collected(views: dict[str, BoardView]) -> ColourSamples:
    samples = collect_samples(views)
    assert samples is not None
    return samples


def test_light_is_divided_out(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.05, 0.9, (8, 3))
    samples = _collected({str(level): _view(level, rgb) for level in (0.5, 1.0, 1.6)})
    np.testing.assert_allclose(samples.reference_light_rgb, _LIGHT)  # the median view
    mean_rgb, n_views, n_rejected = disc_means(samples, 9)
    np.testing.assert_allclose(mean_rgb[:8], rgb * _LIGHT, rtol=1e-12)
    assert np.isnan(mean_rgb[8]).all()
    assert n_views.tolist() == [3] * 8 + [0]
    assert n_rejected == 0


def test_a_highlight_in_one_view_is_left_out(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.1, 0.6, (8, 3))
    shiny = rgb.copy()
    shiny[4] += 0.3
    views = {str(i): _view(1.0, rgb + rng.normal(0, 0.002, rgb.shape)) for i in range(6)}
    samples = _collected({**views, "shiny": _view(1.0, shiny)})
    mean_rgb, n_views, n_rejected = disc_means(samples, 8)
    assert n_rejected == 1
    assert n_views.tolist() == [7, 7, 7, 7, 6, 7, 7, 7]
    np.testing.assert_allclose(mean_rgb[4], rgb[4] * _LIGHT, atol=0.003)  # 3 sigma of six


@pytest.mark.parametrize(("n_large", "is_left_out"), [(3, False), (4, True)])
def test_small_discs_are_left_out_where_larger_ones_are_enough(
    n_large: int,
    is_left_out: bool,  # noqa: FBT001
    rng: np.random.Generator,
) -> None:
    rgb = rng.uniform(0.1, 0.6, (8, 3))
    faded = rgb + 0.1 * (rgb.mean(axis=1, keepdims=True) - rgb)
    views = {f"large {i}": _view(1.0, rgb) for i in range(n_large)}
    small = _view(1.0, faded)
    assert small.discs is not None
    small = replace(small, discs=replace(small.discs, n_px=np.full(8, 15)))
    mean_rgb, n_views, n_rejected = disc_means(_collected({**views, "small": small}), 8)
    assert (n_views == n_large).all() == is_left_out
    assert np.allclose(mean_rgb, rgb * _LIGHT) == is_left_out
    if is_left_out:
        assert n_rejected == 0  # they say nothing against the others


def test_views_without_light_do_not_count(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.1, 0.6, (8, 3))
    dark = _view(1.0, rgb, white_known=False)
    samples = _collected({"lit": _view(1.0, rgb), "dark": dark})
    assert samples.usable.tolist() == [True] * 8 + [False] * 8
    assert collect_samples({"dark": dark}) is None


def test_no_discs_are_no_samples() -> None:
    empty = BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)))
    assert collect_samples({"0": empty}) is None
    assert collect_samples({}) is None


@pytest.mark.parametrize("share", [0.01, 1.0])
def test_clipped_discs_do_not_count(share: float, rng: np.random.Generator) -> None:
    samples = _collected({"0": _view(1.0, rng.uniform(0.1, 0.6, (8, 3)))})
    samples.clipped[2] = share
    assert np.flatnonzero(~samples.usable).tolist() == [2]


def _many(rgb: FloatArray, rng: np.random.Generator, sigma: float = 0.001) -> dict[str, BoardView]:
    return {
        str(index): _view(1.0 + 0.1 * index, rgb + rng.normal(0, sigma, rgb.shape))
        for index in range(7)
    }


def test_each_rejection_has_its_reason(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.2, 0.5, (12, 3))
    views = _many(rgb, rng)
    odd = rgb.copy()
    odd[1] += 0.2  # the lamp's reflection
    odd[2] *= 0.6
    odd[3] = odd[3][[1, 2, 0]] + np.array([0.3, -0.1, 0.0])
    odd[4] *= [0.5, 0.8, 1.2]
    views["odd"] = _view(1.0, odd)
    discs = views["odd"].discs
    assert discs is not None
    discs.n_px[4] = 22
    discs.clipped[5] = 0.2
    means = combine_views(_collected(views), 12)
    expected = ["", "highlight", "shadow", "misread", "hidden", "clipped"] + [""] * 6
    assert list(means.reasons[-12:]) == expected
    assert not any(means.reasons[:-12])
    assert means.n_views.tolist() == [8, 7, 7, 7, 7, 7] + [8] * 6


def test_covariance_of_a_mean_is_what_means_scatter_by(rng: np.random.Generator) -> None:
    rgb = rng.uniform(0.2, 0.5, (12, 3))
    means, told = [], []
    for _ in range(150):
        result = combine_views(_collected(_many(rgb, rng, sigma=0.002)), 12)
        means.append(result.mean_rgb)
        told.append(np.einsum("nii->ni", result.cov_rgb))
    seen, expected = np.var(means, axis=0).mean(), np.mean(told)
    # of 150 draws of 36 numbers to 2 %; taking the larger of two estimates never tells less
    assert 0.9 < expected / seen < 1.4


def test_known_fall_off_sets_the_reference_light(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """Behind a lens that darkens, white is white and the reference is the light before it."""
    n = len(standard_target.markers)
    rgb = rng.uniform(0.2, 0.5, (n, 3))
    vignetting = Vignetting(
        centre_px=np.array([320.0, 240.0]),
        half_diagonal_px=400.0,
        coefficients=np.array([[-0.5, 0, 0, 0, 0]] * 3),
        covariance=np.zeros((3, 5, 5)),
        covered_radius=1.0,
    )
    views = {}
    for frame in range(3):
        view = _view(1.0, rgb)
        discs = view.discs
        assert discs is not None
        centres = standard_target.marker_centres_board[:, :2] * 1500 + 80 + 30 * frame
        gain = vignetting.gain(centres)
        even = replace(
            discs,
            centres_px=centres,
            mean_rgb=discs.mean_rgb * gain,
            white_rgb=discs.white_rgb * gain,
        )
        views[str(frame)] = replace(view, discs=even)
    samples = collect_samples(views, vignetting=vignetting)
    assert samples is not None
    # without the target, levels are taken as read at the disc
    np.testing.assert_allclose(samples.reference_light_rgb, _LIGHT, rtol=0.01)
    np.testing.assert_allclose(disc_means(samples, n)[0], rgb * _LIGHT, rtol=0.01)


def test_black_level_is_subtracted(standard_target: Target, rng: np.random.Generator) -> None:
    n = len(standard_target.markers)
    rgb = rng.uniform(0.1, 0.5, (n, 3))
    views = {}
    for index in range(8):
        view = _view(0.4 + 0.2 * index, rgb)
        discs = view.discs
        assert discs is not None
        lifted = replace(
            discs,
            mean_rgb=discs.mean_rgb + 0.02,
            white_rgb=discs.white_rgb + 0.02,
            black_rgb=0.05 * discs.white_rgb * rng.normal(1, 0.003, (n, 1)) + 0.02,
        )
        views[str(index)] = replace(view, discs=lifted)
    additive = measure_additive(views, standard_target)
    samples = collect_samples(views, standard_target, additive=additive)
    assert samples is not None
    np.testing.assert_allclose(
        samples.even_rgb / samples.reference_light_rgb, np.tile(rgb, (8, 1)), rtol=0.02
    )
    plain = collect_samples(views, standard_target)
    assert plain is not None
    off = np.abs(plain.even_rgb / plain.reference_light_rgb / np.tile(rgb, (8, 1)) - 1)
    assert off.max() > 0.1


def test_poses_tell_tilt_and_distance(standard_target: Target, rng: np.random.Generator) -> None:
    n = len(standard_target.markers)
    views = {"0": _view(1.0, rng.uniform(0.1, 0.5, (n, 3))), "1": _view(1.0, np.full((n, 3), 0.2))}
    tilted = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
    centre = standard_target.marker_centres_board.mean(axis=0)
    pose = Pose(tilted, np.array([0, 0, 50.0]) - tilted @ centre)
    samples = collect_samples(views, standard_target, cam_from_board={"0": pose})
    assert samples is not None
    assert samples.tilt_rad is not None
    assert samples.distance_m is not None
    np.testing.assert_allclose(samples.tilt_rad[:n], 0.4, atol=0.01)  # 0.15 m seen from 50 m
    np.testing.assert_allclose(samples.distance_m[:n], 50, atol=0.1)
    assert np.isnan(samples.tilt_rad[n:]).all()

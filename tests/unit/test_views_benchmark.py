"""What benchmarks.geometry.views propagates is what a solve does."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.geometry.bound import camera_covariance
from benchmarks.geometry.printed import moments
from benchmarks.geometry.scenes import SIGMA_PX, Scene, stereo
from benchmarks.geometry.views import first_views, halves, respond, sigmas_of

from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.bundle.board_shape import BOW_TERMS


@pytest.fixture(scope="module")
def scene() -> Scene:
    return stereo(0, 8)


def _observations(
    printed: Scene, rng: np.random.Generator | None
) -> tuple[Observations, BundleState]:
    """Corners of a displaced print, in units of sigma, and the truth with a flat, even board."""
    n_corners = printed.target.n_corners
    cameras, frames = list(printed.lenses), list(printed.ref_from_boards)
    views = []
    for row, camera in enumerate(cameras):
        for column, frame in enumerate(frames):
            pixels = printed.exact_px(camera, frame)
            if rng is not None:
                pixels = pixels + rng.normal(0, SIGMA_PX, pixels.shape)
            whitening = np.eye(2)[None] / SIGMA_PX
            views.append(ObservedView(row, column, np.arange(n_corners), pixels, whitening))
    points = printed.target.corners_board
    truth = BundleState.build(
        [printed.lenses[camera] for camera in cameras],
        [printed.cams_from_ref[camera] for camera in cameras],
        list(printed.ref_from_boards.values()),
        BoardShape.bowed(points, len(BOW_TERMS)),
    )
    return Observations.pack(views, points, truth.models, len(frames)), truth


def test_noise_alone_is_the_bound_of_the_benchmarks_own_equations(scene: Scene) -> None:
    bow = BoardShape.bowed(scene.target.corners_board, len(BOW_TERMS))
    bound = camera_covariance(scene, bow.basis)[:30, :30]
    sigmas = sigmas_of(scene, respond(scene).covariance)
    assert sigmas["focal"] == pytest.approx(np.sqrt(bound[0, 0]), rel=1e-6)
    along = scene.cams_from_ref["right"].trans_m
    along = along / np.linalg.norm(along)
    baseline_m = np.sqrt(along @ bound[27:30, 27:30] @ along)
    assert sigmas["baseline"] == pytest.approx(1e3 * baseline_m, rel=1e-6)
    lens_rows = np.r_[0:9, 15:24]
    lenses = respond(scene).covariance[:18, :18]
    np.testing.assert_allclose(lenses, bound[np.ix_(lens_rows, lens_rows)], rtol=1e-5)


def test_a_displaced_print_moves_the_solution_as_propagated(
    scene: Scene, rng: np.random.Generator
) -> None:
    """One micrometre: what the linear response leaves out is a thousandth."""
    n_corners = scene.target.n_corners
    moved = 1e-6 * rng.normal(size=(2, n_corners))
    corners = scene.corners_board.copy()
    corners[:, :2] += moved.T
    printed = replace(scene, corners_board=corners)
    observations, truth = _observations(printed, None)
    solved = solve_bundle(observations, truth, Free.everything(truth), relative_decrease=1e-14)
    response = respond(scene)
    foreseen = response.by_print @ moved.ravel()
    found = (solved.state.lens_parameters - truth.lens_parameters).ravel()
    scale = np.sqrt(np.diag(response.printed(1e-6)))[:18]
    # both lenses come first: the reference has no pose of its own
    np.testing.assert_allclose(found / scale, foreseen[:18] / scale, atol=5e-3)
    bow = solved.state.shape_parameters
    scale = np.sqrt(np.diag(response.printed(1e-6)))[-len(bow) :]
    np.testing.assert_allclose(bow / scale, foreseen[-len(bow) :] / scale, atol=5e-3)
    left = sum(float((part**2).sum()) for part in residuals_px(observations, solved.state))
    mean = 1e-12 * response.print_chi_square * SIGMA_PX**2
    # four sigma of a sum of 176 squares of about equal weight
    assert left == pytest.approx(mean, rel=4 * np.sqrt(2 / 176))


def test_halves_without_print_errors_differ_as_stated(scene: Scene) -> None:
    found = halves([first_views(scene, list(scene.ref_from_boards))], SIGMA_PX, 0.0)
    for apart, truth in found.values():
        assert apart == pytest.approx(1)
        assert truth == pytest.approx(1)


def test_print_errors_are_told_from_noise(scene: Scene, rng: np.random.Generator) -> None:
    print_sigma_m = 0.1e-3
    points = scene.target.corners_board
    for sigma_m in (0.0, print_sigma_m):
        corners = points.copy()
        corners[:, :2] += rng.normal(0, sigma_m, (len(points), 2))
        printed = replace(scene, corners_board=corners)
        observations, truth = _observations(printed, rng)
        free = Free.everything(truth)
        solved = solve_bundle(observations, truth, free).state
        found = moments(observations, solved, free, len(points))
        # noise alone, s = 0.2 px on 2.5 px/mm in 16 views: a variance of (0.02 mm)^2 each, whose
        # sum over 176 is known to 1/10; the print's own 176 squares spread by as much
        spread_m2 = np.sqrt(2 / 176) * (sigma_m**2 + 0.02e-3**2)
        assert found.variance_m2 == pytest.approx(sigma_m**2, abs=4 * spread_m2)

"""Two calibrations differ by as much as their covariances say, or the difference is found."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.geometry.rigs import Scene, observed
from benchmarks.geometry.scenes import mono, stereo

from calichrome.core.pose import Pose
from calichrome.geometry.comparison import chance_of_more, compare_lenses, root_of
from calichrome.geometry.displacement import displacement, relative_covariance
from calichrome.geometry.halves import Halves, compare_halves
from calichrome.geometry.lenses import BrownConrady, KannalaBrandt
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import Dataset

_SIZE_WH = (1280, 960)
_LENS = BrownConrady(fx=1000, fy=1002, cx=640, cy=478, k1=-0.2, k2=0.08, p1=1e-3, p2=-5e-4)


def _halves(scene: Scene, dataset: Dataset, start: RigSolution) -> Halves:
    again = RigSettings(reference=scene.reference, start=start)  # which only saves time
    halves = compare_halves(dataset, partial(solve_rig, target=scene.target, settings=again))
    assert halves is not None
    return halves


def test_a_lens_and_itself_do_not_differ() -> None:
    found = compare_lenses(_LENS, _LENS, _SIZE_WH, distances_m=(0.5, 1, 2))
    assert found.max_px < 1e-6  # pixels: what unprojection leaves
    np.testing.assert_allclose(found.b_from_a.trans_m, 0, atol=1e-9)
    assert found.ratio is None


def test_a_shifted_principal_point_is_nearly_a_rotation() -> None:
    """The motion takes it up, but for the share by which a turn is no shift."""
    shifted = replace(_LENS, cx=_LENS.cx + 10)
    found = compare_lenses(_LENS, shifted, _SIZE_WH)
    # A ray towards x/z = -1/fx * 10 is where the old axis was.
    np.testing.assert_allclose(found.b_from_a.rotvec_rad[1], -10 / _LENS.fx, rtol=0.15)
    assert 0.05 < found.rms_px < 2


def test_a_scale_is_a_translation_at_one_distance_only() -> None:
    """Nearer by 1 % looks like a longer focal length, on a plane; at three distances it cannot."""
    zoomed = replace(_LENS, fx=_LENS.fx * 1.001, fy=_LENS.fy * 1.001)
    far = compare_lenses(_LENS, zoomed, _SIZE_WH)
    one, two, many = (
        compare_lenses(_LENS, zoomed, _SIZE_WH, distances_m=distances)
        for distances in ([0.5], [1.0], [0.3, 0.6, 3])
    )
    assert one.rms_px < many.rms_px < far.rms_px
    np.testing.assert_allclose(one.rms_px, two.rms_px, rtol=1e-9)
    # ... of which only the translation knows: it is twice as long at twice the range
    np.testing.assert_allclose(2 * one.b_from_a.trans_m, two.b_from_a.trans_m, rtol=1e-6)


def test_lenses_of_different_models_can_agree() -> None:
    """A fisheye's series fitted to a polynomial lens: no difference where they were fitted."""
    x, y = np.meshgrid(np.linspace(0, 1279, 30), np.linspace(0, 959, 20))
    rays = _LENS.unproject(np.stack([x, y], axis=-1).reshape(-1, 2))
    plain = replace(_LENS, p1=0.0, p2=0.0)
    pixels = plain.project(rays)
    parameters = KannalaBrandt.start(_SIZE_WH, 1000).parameters
    for _ in range(30):
        lens = KannalaBrandt.from_parameters(parameters)
        projected, by_lens, _ = lens.project_with_jacobians(rays)
        step, *_ = np.linalg.lstsq(
            by_lens.reshape(-1, len(parameters)), (pixels - projected).ravel(), rcond=None
        )
        parameters = parameters + step
    lens = KannalaBrandt.from_parameters(parameters)
    residual = float(np.sqrt(((lens.project(rays) - pixels) ** 2).sum(axis=1).mean()))
    found = compare_lenses(plain, lens, _SIZE_WH)
    # the grid goes to the borders, as the fit did; the rotation can only help
    assert found.rms_px < 1.5 * residual + 1e-9


def test_predicted_difference_is_that_of_drawn_lenses(rng: np.random.Generator) -> None:
    """Lenses drawn from their covariances differ by what the fit's covariance says."""
    sigma = np.array([0.5, 0.5, 1.0, 1.0, 3e-3, 1e-2, 1e-4, 1e-4, 1e-6])
    cov_a, cov_b = np.diag(sigma**2), np.diag((2 * sigma) ** 2)
    ratios, chances = [], []
    for _ in range(200):
        a, b = (
            BrownConrady.from_parameters(
                _LENS.parameters + root_of(cov) @ rng.normal(size=len(sigma))
            )
            for cov in (cov_a, cov_b)
        )
        found = compare_lenses(a, b, _SIZE_WH, covs=(cov_a, cov_b), distances_m=(0.5, 0.8, 1.5))
        assert found.ratio is not None
        assert found.chance is not None
        ratios.append(found.ratio)
        chances.append(found.chance)
    # the mean square has a relative spread of below sqrt(2 / 200) = 0.1; three of these
    assert np.mean(np.square(ratios)) == pytest.approx(1, abs=0.3)
    # chances are uniform: the largest gap of 200 draws stays below 1.63 / sqrt(200) in 99 % (K-S)
    gap = np.abs(np.sort(chances) - (np.arange(200) + 0.5) / 200).max()
    assert gap < 1.63 / np.sqrt(200)


def test_chance_is_exact_for_equal_weights_and_near_for_others(rng: np.random.Generator) -> None:
    weights = np.array([1.0, 0.5, 0.1, 0.01])
    draws = (rng.normal(size=(100_000, 4)) ** 2) @ weights
    for level in (0.5, 0.1, 0.01):
        value = float(np.quantile(draws, 1 - level))
        # three cumulants are right; 100 000 draws know 1 % to 3 % of itself
        assert chance_of_more(value, weights) == pytest.approx(level, rel=0.12)


def test_relative_places_scatter_as_their_covariance_says(rng: np.random.Generator) -> None:
    """The motion of a camera against another, both in doubt together."""
    cam = Pose.from_rotvec([0.2, -0.5, 0.1], [0.4, 0.1, 2.0])
    other = Pose.from_rotvec([-0.1, 0.3, 0.0], [-0.5, 0.0, 1.5])
    mixing = rng.normal(size=(12, 12)) * 1e-4
    cov = relative_covariance(cam, other, mixing @ mixing.T)
    squares = []
    for _ in range(300):
        step = mixing @ rng.normal(size=12)
        moved = cam.perturbed(step[:6]) @ other.perturbed(step[6:]).inverse()
        found = displacement(cam @ other.inverse(), moved, cov)
        assert found.freedom == 6
        assert found.chi_square is not None
        squares.append(found.chi_square)
    # chi-square of 6 degrees: mean 6, its error over 300 draws sqrt(12 / 300) = 0.2; three of it
    assert np.mean(squares) == pytest.approx(6, abs=0.6)


def test_displacement_says_how_far_the_centre_went() -> None:
    before = Pose.from_rotvec([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
    # centre in ref moved by 5 mm, axes turned by 0.01 rad
    turn = Rotation.from_rotvec([0.01, 0, 0]).as_matrix()
    centre = before.inverse().trans_m + np.array([0.003, 0.0, 0.004])
    rotation = turn @ before.rotation
    found = displacement(before, Pose(rotation, -rotation @ centre), None)
    assert found.distance_m == pytest.approx(0.005, rel=1e-9)
    assert found.angle_rad == pytest.approx(0.01, rel=1e-9)
    assert found.chance is None


@pytest.mark.slow
@pytest.mark.parametrize("make", [mono, stereo])
def test_halves_differ_as_their_covariances_say(make: Callable[[int], Scene]) -> None:
    """And camera positions of both halves agree within 3 combined sigma in 997 of 1000."""
    scene = make(0)
    start = solve_rig(
        observed(scene, [4, 0]).dataset, scene.target, RigSettings(reference=scene.reference)
    )
    squares, chances, sigmas = [], [], []
    for draw in range(20):
        halves = _halves(scene, observed(scene, [4, draw]).dataset, start)
        for camera in scene.lenses:
            ratio, chance = halves.ratio(camera), halves.lenses[camera].chance
            assert ratio is not None
            assert chance is not None
            squares.append(ratio**2)
            chances.append(chance)
            apart = halves.position_sigmas(camera)
            assert (apart is None) == (camera == scene.reference)
            if apart is not None:
                sigmas.append(apart)
    # A mean square ratio has about 3 effective degrees: spread sqrt(2 / 3 / 20) = 0.18; three.
    assert np.mean(squares) == pytest.approx(1, abs=0.55)
    assert min(chances) > 1e-4  # of 40, one in 250 such runs
    if sigmas:
        assert np.mean(np.square(sigmas)) == pytest.approx(1, abs=0.6)  # 60 with correlation
        assert np.abs(sigmas).max() < 4


def test_halves_of_few_frames_are_not_compared() -> None:
    scene = mono(0, 7)
    dataset = observed(scene, [1]).dataset
    assert compare_halves(dataset, lambda _: pytest.fail("solved")) is None

"""Corners that do not belong are found, and what is left is plain least squares with its noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import (
    BoardShape,
    BundleResult,
    BundleState,
    Free,
    Observations,
    ObservedView,
    solve_bundle,
)
from calichrome.geometry.bundle.robust import RobustResult, solve_robust
from calichrome.geometry.lenses import BrownConrady

_X, _Y = np.meshgrid(np.arange(9) * 0.03, np.arange(6) * 0.03)
_BOARD = np.stack([_X.ravel(), _Y.ravel(), np.zeros(54)], axis=1)
_SHAPE = BoardShape.flat(_BOARD)
_MODELS = BrownConrady, BrownConrady


def _truth(rng: np.random.Generator, n_cameras: int = 2, n_frames: int = 15) -> BundleState:
    """Cameras side by side before a board that fills much of each picture."""
    lens = BrownConrady(fx=400, fy=402, cx=322, cy=238, k1=-0.2, k2=0.05, p1=1e-3, p2=-1e-3)
    boards = []
    for _ in range(n_frames):
        turn = Pose.from_rotvec(rng.uniform(-0.6, 0.6, 3), np.zeros(3))
        middle = np.array([*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.3, 0.4)])
        boards.append(Pose(turn.rotation, middle - turn.apply(_BOARD.mean(axis=0))))
    cams_from_ref = [Pose.identity(), Pose.from_rotvec([0.02, 0.2, 0.01], [-0.08, 0, 0.01])]
    return BundleState.build([lens] * n_cameras, cams_from_ref[:n_cameras], boards, _SHAPE)


def _views(
    truth: BundleState, sigma_px: Sequence[float], rng: np.random.Generator
) -> list[ObservedView]:
    """Every camera sees every board; each has its own noise."""
    ids = np.arange(54)
    views = []
    for camera, (lens, cam_from_ref) in enumerate(
        zip(truth.lenses, truth.cams_from_ref, strict=True)
    ):
        for frame, ref_from_board in enumerate(truth.ref_from_boards):
            pixels = lens.project((cam_from_ref @ ref_from_board).apply(_BOARD))
            pixels += rng.normal(0, sigma_px[camera], pixels.shape)
            views.append(ObservedView(camera, frame, ids, pixels))
    return views


def _spoiled(
    views: Sequence[ObservedView], rng: np.random.Generator, share: float = 0.02
) -> tuple[list[ObservedView], list[BoolArray]]:
    """Displace some corners by 3 to 20 px; tell which ones."""
    spoiled, gross = [], []
    for view in views:
        is_gross = rng.uniform(size=len(view.pixels)) < share
        angle = rng.uniform(0, 2 * np.pi, len(is_gross))
        shift = is_gross * rng.uniform(3, 20, len(is_gross))
        pixels = view.pixels + shift[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        spoiled.append(replace(view, pixels=pixels))
        gross.append(is_gross)
    return spoiled, gross


def _stated(views: Sequence[ObservedView], sigma_px: Sequence[float]) -> list[ObservedView]:
    return [
        replace(view, whitening=np.tile(np.eye(2) / sigma_px[view.camera], (54, 1, 1)))
        for view in views
    ]


def _pack(views: Sequence[ObservedView], truth: BundleState) -> Observations:
    return Observations.pack(views, _BOARD, truth.models, len(truth.board_trans_m))


def _start(truth: BundleState) -> BundleState:
    """Focal length 3 % too long, no distortion, boards 3 % too far."""
    lens_parameters = truth.lens_parameters * [1.03, 1.03, 1, 1, 0, 0, 0, 0, 0]
    return replace(truth, lens_parameters=lens_parameters, board_trans_m=1.03 * truth.board_trans_m)


def _solved(
    views: Sequence[ObservedView], truth: BundleState, *, gate: bool = True
) -> RobustResult:
    return solve_robust(_pack(views, truth), _start(truth), Free.everything(truth), gate=gate)


def _covariance(result: BundleResult) -> FloatArray:
    covariance = result.equations.covariance()
    assert covariance is not None
    return covariance


def _sigma(result: BundleResult) -> FloatArray:
    return np.sqrt(np.diag(_covariance(result)))


def _assert_same(found: BundleState, expected: BundleState, sigma: FloatArray, atol: float) -> None:
    """Lens parameters agree to a share of their sigma."""
    n_cameras, n_lens = found.lens_parameters.shape
    sigma = sigma[: n_cameras * (n_lens + 6)].reshape(n_cameras, -1)[:, :n_lens]
    off = found.lens_parameters - expected.lens_parameters
    np.testing.assert_allclose(off / sigma, 0, atol=atol)


def test_all_gross_corners_are_found_and_no_good_one_is_lost(rng: np.random.Generator) -> None:
    """2 % of 3 to 20 px at sigma 0.2 px, of which the gate stands at 5.4 to 5.6, in 10 draws."""
    n_gross = 0
    for _ in range(10):
        truth = _truth(rng)
        views, gross = _spoiled(_views(truth, (0.2, 0.2), rng), rng)
        result = _solved(views, truth)
        for is_inlier, is_gross in zip(result.inliers, gross, strict=True):
            np.testing.assert_array_equal(is_inlier, ~is_gross)
            n_gross += is_gross.sum()
    assert n_gross > 200


def test_the_result_is_least_squares_of_the_inliers(rng: np.random.Generator) -> None:
    truth = _truth(rng)
    views, gross = _spoiled(_views(truth, (0.2, 0.2), rng), rng)
    result = _solved(views, truth)
    good = [
        replace(
            view,
            corner_ids=view.corner_ids[~bad],
            pixels=view.pixels[~bad],
            whitening=np.tile(np.eye(2) / result.noise[view.camera], ((~bad).sum(), 1, 1)),
        )
        for view, bad in zip(views, gross, strict=True)
    ]
    expected = solve_bundle(_pack(good, truth), _start(truth), Free.everything(truth))
    sigma = _sigma(expected)
    # The noise of either camera is settled to 5 %, weights to 10 %; the pull of one camera against
    # the other is half a sigma at most
    _assert_same(result.result.state, expected.state, sigma, 0.05)
    np.testing.assert_allclose(_sigma(result.result), sigma, rtol=1e-3)


@pytest.mark.parametrize("gate", [False, True])
def test_whitened_residuals_have_unit_variance(*, gate: bool, rng: np.random.Generator) -> None:
    """Squares over redundancy are 1 in every camera, so twice the cost is the redundancy."""
    truth = _truth(rng)
    views, _ = _spoiled(_views(truth, (0.1, 0.4), rng), rng)
    result = _solved(views, truth, gate=gate)
    n_inliers = sum(int(item.sum()) for item in result.inliers)
    n_unknowns = 2 * 9 + 6 + 6 * 15
    assert 2 * result.result.cost == pytest.approx(2 * n_inliers - n_unknowns, rel=1e-9)


def test_gross_corners_hardly_cost_accuracy(rng: np.random.Generator) -> None:
    """Found outliers take their own information with them, and nothing else: 1 % of sigma or so."""
    truth = _truth(rng)
    clean = _views(truth, (0.2, 0.2), rng)
    views, _ = _spoiled(clean, rng)
    with_gross, without = _solved(views, truth).result, _solved(clean, truth).result
    # 2 % fewer corners: sigmas grow by 1 %, the solution moves by sqrt(2 %) of a sigma, 0.14
    sigma = _sigma(without)
    np.testing.assert_allclose(_sigma(with_gross), sigma, rtol=0.05)
    _assert_same(with_gross.state, without.state, sigma, 4 * 0.14)


@pytest.mark.parametrize("gate", [False, True])
def test_the_noise_of_each_camera_is_recovered(*, gate: bool, rng: np.random.Generator) -> None:
    """Pixels, where no covariance is stated; four sigma of an estimate from 1600 residuals."""
    truth = _truth(rng)
    sigma_px = 0.1, 0.4
    noise = _solved(_views(truth, sigma_px, rng), truth, gate=gate).noise
    n_redundant = 2 * 54 * 15 - 9 - 6 * 15
    np.testing.assert_allclose(noise / sigma_px, 1, atol=4 / np.sqrt(2 * n_redundant))


def test_stated_covariances_are_scaled_by_what_the_residuals_say(rng: np.random.Generator) -> None:
    """Sigmas stated twice too small: noise 2, the same inliers, minimum and covariance."""
    truth = _truth(rng)
    views, _ = _spoiled(_views(truth, (0.2, 0.4), rng), rng)
    right, small = (
        _solved(_stated(views, sigma_px), truth) for sigma_px in ((0.2, 0.4), (0.1, 0.2))
    )
    n_redundant = 2 * 54 * 15 - 9 - 6 * 15
    np.testing.assert_allclose(right.noise, 1, atol=4 / np.sqrt(2 * n_redundant))
    np.testing.assert_allclose(small.noise, 2 * right.noise, rtol=1e-3)
    for one, two in zip(right.inliers, small.inliers, strict=True):
        np.testing.assert_array_equal(one, two)
    sigma = _sigma(right.result)
    np.testing.assert_allclose(_sigma(small.result), sigma, rtol=1e-3)
    _assert_same(small.result.state, right.result.state, sigma, 1e-3)


def test_without_the_gate_it_is_plain_least_squares(rng: np.random.Generator) -> None:
    """One camera: a common factor of all weights moves nothing."""
    truth = _truth(rng, n_cameras=1)
    views, _ = _spoiled(_views(truth, (0.2,), rng), rng)
    result = _solved(views, truth, gate=False)
    plain = solve_bundle(_pack(views, truth), _start(truth), Free.everything(truth))
    n_residuals, n_unknowns = 2 * 54 * 15, 9 + 6 * 15
    variance = 2 * plain.cost / (n_residuals - n_unknowns)
    assert all(is_inlier.all() for is_inlier in result.inliers)
    assert result.noise[0] == pytest.approx(np.sqrt(variance), rel=1e-6)
    sigma = _sigma(plain) * np.sqrt(variance)
    np.testing.assert_allclose(_sigma(result.result), sigma, rtol=1e-3)
    _assert_same(result.result.state, plain.state, sigma, 1e-3)


def test_the_covariance_stays_true_among_gross_corners(rng: np.random.Generator) -> None:
    """60 draws: squares of deviations in units of the covariance, noise estimated, too."""
    n_draws, truth = 60, _truth(rng, n_cameras=1, n_frames=8)
    distances = []
    for _ in range(n_draws):
        views, _ = _spoiled(_views(truth, (0.2,), rng), rng)
        result = _solved(views, truth).result
        off = (result.state.lens_parameters - truth.lens_parameters)[0]
        distances.append(off @ np.linalg.solve(_covariance(result)[:9, :9], off))
    # chi-square of 9; its mean over the draws to four sigma
    assert np.mean(distances) == pytest.approx(9, abs=4 * np.sqrt(2 * 9 / n_draws))


def test_inliers_come_in_the_order_of_the_views(rng: np.random.Generator) -> None:
    truth = _truth(rng)
    views = _views(truth, (0.2, 0.2), rng)
    shuffled = [views[position] for position in rng.permutation(len(views))]
    pixels = shuffled[4].pixels.copy()
    pixels[17] += 30
    shuffled[4] = replace(shuffled[4], pixels=pixels)
    result = _solved(shuffled, truth)
    assert [np.flatnonzero(~item).tolist() for item in result.inliers] == [
        [17] if position == 4 else [] for position in range(len(shuffled))
    ]

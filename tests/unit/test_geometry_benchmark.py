"""The geometry benchmark: its bound against OpenCV and sampling, its scenes and its verdicts."""

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import Dataset

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.geometry import ours
from benchmarks.geometry.bound import (
    N_CAMERA,
    Problem,
    State,
    View,
    camera_covariance,
    cost_of,
    minimise,
    problem_of,
    state_of,
)
from benchmarks.geometry.converging import bound_medians, pose_errors
from benchmarks.geometry.peers import lensboy_cameras, opencv_camera
from benchmarks.geometry.problems import Problem as StartProblem
from benchmarks.geometry.problems import counted, random_problem
from benchmarks.geometry.projection import difference_px, predicted_ms_px2
from benchmarks.geometry.rigs import (
    SIGMA_PX,
    Scene,
    bent,
    observed,
)
from benchmarks.geometry.scenes import (
    mono,
    ring,
    stereo,
)
from benchmarks.geometry.starts import judge, reference_start
from benchmarks.geometry.tables import Bar
from benchmarks.geometry.truth import Sample, bars, draw


@pytest.fixture(scope="module")
def camera() -> Scene:
    return mono(0, n_frames=8)


@pytest.fixture(scope="module")
def pair() -> Scene:
    return stereo(0, n_frames=8)


@pytest.fixture(scope="module")
def problems() -> list[StartProblem]:
    return [random_problem(seed) for seed in range(24)]


def _seen(problem: Problem, dataset: Dataset) -> Problem:
    views = {
        (camera, frame): View(view.corner_ids, view.corners_px)
        for camera, seen in dataset.views.items()
        for frame, view in seen.items()
    }
    return replace(problem, views=views)


def test_scenes_repeat_and_show_whole_boards() -> None:
    for make, size in ((mono, 6), (stereo, 6), (ring, 8)):
        scene, again = make(3, size), make(3, size)
        for camera, frames in scene.seen.items():
            for frame in frames:
                corners = scene.exact_px(camera, frame)
                np.testing.assert_array_equal(corners, again.exact_px(camera, frame))
                assert (corners >= 0).all()
                assert (corners <= np.array(scene.size_wh) - 1).all()


def test_every_board_of_the_ring_is_seen_by_neighbours() -> None:
    scene = ring(0, 16)
    names = list(scene.lenses)
    for frame in scene.ref_from_boards:
        seen = [index for index, camera in enumerate(names) if frame in scene.seen[camera]]
        assert len(seen) == 2
        assert (seen[1] - seen[0]) % 8 in {1, 7}


def test_noise_has_its_sigma_and_gross_errors_leave_it_alone(camera: Scene) -> None:
    clean, dirty = (observed(camera, [1], gross_share=share) for share in (0.0, 0.1))
    errors, lengths = [], []
    for frame in camera.seen["cam0"]:
        exact = camera.exact_px("cam0", frame)
        gross = dirty.gross["cam0", frame]
        one, other = (item.dataset.views["cam0"][frame].corners_px for item in (clean, dirty))
        np.testing.assert_array_equal(one[~gross], other[~gross])
        errors.append(one - exact)
        lengths.append(np.linalg.norm(other - one, axis=1)[gross])
    # 1408 numbers: their standard deviation is known to 1.9 %
    assert np.concatenate(errors).std() == pytest.approx(SIGMA_PX, rel=0.08)
    moved = np.concatenate(lengths)
    assert 40 < len(moved) < 105  # 704 corners, 10 %, four standard deviations
    assert moved.min() > 2.999  # single precision
    assert moved.max() < 20.001


def test_bow_has_its_sagitta_and_neither_mean_nor_slope(camera: Scene) -> None:
    board = bent(camera, 1e-3).corners_board
    flat = camera.target.corners_board
    assert np.ptp(board[:, 2]) == pytest.approx(1e-3)
    plane = np.stack([flat[:, 0], flat[:, 1], np.ones(len(flat))], axis=1)
    np.testing.assert_allclose(np.linalg.lstsq(plane, board[:, 2])[0], 0, atol=1e-12)


def test_bent_paper_keeps_its_lengths(camera: Scene) -> None:
    """A chord of length s under curvature k is shorter than its arc by (k s)^2 / 24."""
    nx = camera.target.corners_xy[0]
    row = bent(camera, 1e-3, keeps_lengths=True).corners_board[:nx]
    chords = np.linalg.norm(np.diff(row, axis=0), axis=1)
    curvature = 2 * 1e-3 / 0.125**2
    np.testing.assert_allclose(chords, 0.025 * (1 - (curvature * 0.025) ** 2 / 24), rtol=1e-8)
    assert np.ptp(row[:, 0]) == pytest.approx(0.25 - 8 / 3 * 1e-6 / 0.25, abs=1e-9)


def _perturbed(state: State, step: FloatArray, frame: str, board_step: FloatArray) -> State:
    lenses, cams = {}, {}
    for own, (camera, lens) in zip(step.reshape(-1, N_CAMERA), state.lenses.items(), strict=True):
        lenses[camera] = BrownConrady.from_parameters(lens.parameters + own[:9])
        cams[camera] = state.cams_from_ref[camera].perturbed(own[9:])
    boards = dict(state.ref_from_boards)
    boards[frame] = boards[frame].perturbed(board_step)
    return replace(state, lenses=lenses, cams_from_ref=cams, ref_from_boards=boards)


def test_bound_is_what_opencv_states(camera: Scene) -> None:
    """`calibrateCameraExtended` from the noise-free corners; its sigmas are for its own residuals.

    So the ratio of its sigmas to ours is one number.
    """
    draw_ = observed(camera, [2])
    views = draw_.dataset.views["cam0"].values()
    corners = (camera.target.corners_board / 0.025).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    rms, *_, sigmas, _, _ = cv2.calibrateCameraExtended(
        [corners] * len(views),
        [view.corners_px.astype(np.float32) for view in views],
        camera.size_wh,
        np.empty(0),
        np.empty(0),
        criteria=stop,
    )
    problem = _seen(problem_of(camera), draw_.dataset)
    state, cost = minimise(problem, state_of(camera))
    n_corners = sum(len(view.corner_ids) for view in problem.views.values())
    assert np.sqrt(cost / n_corners) == pytest.approx(rms, rel=1e-6)
    at_minimum = replace(camera, lenses=state.lenses, ref_from_boards=state.ref_from_boards)
    own = np.sqrt(np.diag(camera_covariance(at_minimum)))[:9]
    ratio = np.ravel(sigmas)[:9] / own
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)


def test_bound_of_a_rig_is_the_scatter_of_its_minima(pair: Scene) -> None:
    """30 draws of 24 parameters: e' C^-1 e is 24 on average, to 1.3 (one standard error)."""
    covariance = camera_covariance(pair)
    free = np.diag(covariance) > 0
    assert free.sum() == 24
    inverse = np.linalg.inv(covariance[np.ix_(free, free)])
    distances = []
    for seed in range(30):
        problem = _seen(problem_of(pair), observed(pair, [5, seed]).dataset)
        state, _ = minimise(problem, state_of(pair))
        error = _errors(pair, state.lenses, state.cams_from_ref)[free]
        distances.append(error @ inverse @ error)
    assert np.mean(distances) == pytest.approx(24, abs=4)


def _errors(
    scene: Scene, lenses: Mapping[str, BrownConrady], cams_from_ref: Mapping[str, Pose]
) -> FloatArray:
    parts = []
    for camera, lens in scene.lenses.items():
        turn = cams_from_ref[camera].rotation @ scene.cams_from_ref[camera].rotation.T
        shift = cams_from_ref[camera].trans_m - scene.cams_from_ref[camera].trans_m
        parts += [lenses[camera].parameters - lens.parameters]
        parts += [Rotation.from_matrix(turn).as_rotvec(), shift]
    return np.concatenate(parts)


def test_minimise_returns_from_afar(pair: Scene, rng: np.random.Generator) -> None:
    """From a start as bad as a closed form the same minimum is reached as from the truth."""
    problem = _seen(problem_of(pair), observed(pair, [6]).dataset)
    best, cost = minimise(problem, state_of(pair))
    step = rng.normal(0, 1, 2 * N_CAMERA) * np.tile([30, 30, 10, 10, *[0] * 5, *[0.02] * 6], 2)
    step[9:15] = 0
    start = _perturbed(state_of(pair), step, "003", rng.normal(0, 0.02, 6))
    assert cost_of(problem, start) > 100 * cost
    again, same = minimise(problem, start)
    assert same == pytest.approx(cost, rel=1e-10)
    np.testing.assert_allclose(
        again.lenses["left"].parameters, best.lenses["left"].parameters, rtol=1e-4, atol=1e-6
    )


def test_a_turned_lens_is_no_difference(camera: Scene) -> None:
    """Moving the principal point of a long lens is a rotation, but for the second order."""
    lens = BrownConrady(fx=1e5, fy=1e5, cx=640, cy=480)
    moved = replace(lens, cx=645.0, cy=478.0)
    assert np.abs(difference_px(lens, moved, camera.size_wh)).max() < 1e-3
    wider = replace(lens, fx=1.01e5, fy=1.01e5)
    assert np.abs(difference_px(lens, wider, camera.size_wh)).max() == pytest.approx(6.4, rel=0.01)


def test_predicted_difference_is_that_of_drawn_lenses(
    camera: Scene, rng: np.random.Generator
) -> None:
    """200 lenses of a tenth of the bound's errors, where all is linear."""
    lens, covariance = camera.lenses["cam0"], camera_covariance(camera)[:9, :9] / 100
    steps = rng.multivariate_normal(np.zeros(9), covariance, 200)
    squares = [
        (
            difference_px(
                lens, BrownConrady.from_parameters(lens.parameters + step), camera.size_wh
            )
            ** 2
        )
        .sum(axis=1)
        .mean()
        for step in steps
    ]
    predicted = predicted_ms_px2(lens, covariance, camera.size_wh)
    spread = np.std(squares) / np.sqrt(len(squares))
    assert np.mean(squares) == pytest.approx(predicted, abs=4 * spread)
    assert spread < 0.15 * predicted


def test_opencv_reaches_the_same_minimum(camera: Scene) -> None:
    dataset = observed(camera, [3]).dataset
    fit = opencv_camera(dataset, camera.target)
    assert fit is not None
    state, cost = minimise(_seen(problem_of(camera), dataset), state_of(camera))
    assert fit.cost_px2 == pytest.approx(cost, rel=1e-9)
    assert np.abs(difference_px(fit.lens, state.lenses["cam0"], camera.size_wh)).max() < 1e-4


def test_what_is_absent_did_not_run(camera: Scene) -> None:
    assert lensboy_cameras(None, [observed(camera, [3]).dataset], camera.target) is None


def test_pose_errors_are_angles_and_distances(pair: Scene) -> None:
    moved = pair.cams_from_ref["right"].inverse()
    turn = Rotation.from_rotvec([0, 0.01, 0]).as_matrix()
    shifted = Pose(turn @ moved.rotation, moved.trans_m + np.array([0.003, 0, 0.004])).inverse()
    errors = pose_errors(pair, {"left": Pose.identity(), "right": shifted})
    np.testing.assert_allclose(errors, [[0.01, 0.005]])
    assert np.isinf(pose_errors(pair, None)).all()


def test_bound_medians_scale_with_the_noise(pair: Scene) -> None:
    """Medians of lengths lie between the least and the largest axis of their ellipsoid."""
    covariance = camera_covariance(pair)[N_CAMERA + 9 :, N_CAMERA + 9 :]
    axes = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]))
    rotation, position = bound_medians(pair)
    assert axes[0] < rotation < 1.54 * axes[-1]  # 1.54: median length of a unit normal in 3-D
    assert position > 0


@pytest.mark.parametrize(("factor", "met"), [(1.0, True), (1.3, False), (0.8, False)])
def test_bars_find_sigmas_that_lie(factor: float, met: bool, rng: np.random.Generator) -> None:  # noqa: FBT001
    """5000 errors of unit variance under a stated sigma of 1 / factor."""
    errors = rng.standard_normal((5000, 6))
    sample = Sample(
        tuple("abcdef"),
        0,
        errors,
        np.full_like(errors, 1 / factor),
        ((errors * factor) ** 2).sum(axis=1),
        {"a length": errors[:, :1] * factor},
    )
    assert all(bar.is_met for bar in bars(sample, 0.07, 0.02)) == met


def test_a_bar_that_was_not_measured_is_not_met() -> None:
    assert not Bar("x", float("nan"), high=1.0).is_met


def test_draws_are_those_of_the_package(camera: Scene) -> None:
    sample = draw(camera, 3, 0)
    assert sample.errors.shape == sample.sigmas.shape == (3, 9)
    assert (np.abs(sample.errors) < 6 * sample.sigmas).all()


def test_problems_repeat_and_cover_what_they_promise(problems: list[StartProblem]) -> None:
    again = random_problem(7)
    for key, exact in problems[7].recording.gross.items():
        np.testing.assert_array_equal(exact, again.recording.gross[key])
    for problem in problems:
        width = problem.scene.size_wh[0]
        assert all(0.4 <= lens.fx / width <= 2.5 for lens in problem.scene.lenses.values())
        assert 3 <= problem.n_frames <= 30
        assert bool(problem.mishaps) == (problem.n_frames >= 8)
        assert min(map(len, problem.scene.seen.values())) >= 3
    kinds = Counter(item.kind for problem in problems for item in problem.mishaps)
    assert set(kinds) == {"turned", "mirrored", "swapped"}


def test_mishaps_are_what_their_names_say(problems: list[StartProblem]) -> None:
    problem = next(p for p in problems if _kinds(p) == {"swapped"})
    (first, *_) = problem.mishaps
    one, two = first.frames
    views = problem.recording.dataset.views[first.camera]
    before = problem.pristine.dataset.views[first.camera]
    np.testing.assert_array_equal(views[one].corners_px, before[two].corners_px)
    assert problem.origin[first.camera, two] == one
    assert counted((3, 2), "turned").tolist() == [5, 4, 3, 2, 1, 0]
    assert counted((3, 2), "mirrored").tolist() == [2, 1, 0, 5, 4, 3]


def _kinds(problem: StartProblem) -> set[str]:
    return {item.kind for item in problem.mishaps}


@pytest.mark.parametrize("kind", ["turned", "mirrored"])
def test_a_view_counted_otherwise_starts_where_it_fits(
    kind: str, problems: list[StartProblem]
) -> None:
    """The reference of a single camera explains such views as well as any other."""
    problem = next(p for p in problems if _kinds(p) == {kind} and len(p.scene.lenses) == 1)
    solved = ours.solve(problem.pristine.dataset, problem.scene.target)
    views = {
        ("cam0", frame): View(view.corner_ids[good], view.corners_px[good])
        for frame, view in problem.recording.dataset.views["cam0"].items()
        for good in [~problem.recording.gross["cam0", frame]]
    }
    start = reference_start(problem, replace(solved, problem=replace(solved.problem, views=views)))
    assert start is not None
    worst = max(
        np.abs(
            start.lenses["cam0"].project(
                start.ref_from_boards[frame].apply(problem.scene.corners_board[view.corner_ids])
            )
            - view.pixels
        ).max()
        for (_, frame), view in views.items()
    )
    assert worst < 6 * SIGMA_PX


def test_verdict_on_a_plain_problem_is_right(problems: list[StartProblem]) -> None:
    problem = next(p for p in problems if not p.mishaps)
    verdict = judge(problem)
    assert verdict.kind == "right"
    assert abs(verdict.excess) < 1e-6

"""The minimum of a bundle: where it lies, how it is reached, and how it scatters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry import adjustment
from calichrome.geometry.adjustment import PlanarView, Scene, Sightings, adjust
from calichrome.geometry.bundle import (
    BoardShape,
    BundleResult,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.lenses import LENSES, BrownConrady, Lens

_X, _Y = np.meshgrid(np.arange(6) * 0.04, np.arange(5) * 0.04)
_BOARD = np.stack([_X.ravel(), _Y.ravel(), np.zeros(30)], axis=1)


def _truth(
    rng: np.random.Generator, models: Sequence[type[Lens]], shape: BoardShape, n_frames: int
) -> BundleState:
    """Wide-angle cameras side by side before a board that fills much of each picture."""
    lenses = []
    for model in models:
        parameters = model.start((640, 480), 330).parameters
        parameters[4:] = rng.normal(0, 0.01, len(parameters) - 4)
        lenses.append(model.from_parameters(parameters))
    cams_from_ref = [
        Pose.from_rotvec(rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.04, 0.04, 3)) for _ in models
    ]
    cams_from_ref[0] = Pose.identity()
    boards = []
    for _ in range(n_frames):
        turn = Pose.from_rotvec(rng.uniform(-0.6, 0.6, 3), np.zeros(3))
        middle = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.18, 0.3)])
        boards.append(Pose(turn.rotation, middle - turn.apply(_BOARD.mean(axis=0))))
    parameters = rng.normal(0, 1e-3, len(shape))
    return BundleState.build(lenses, cams_from_ref, boards, shape, parameters)


def _views(truth: BundleState, sigma_px: float, rng: np.random.Generator) -> list[ObservedView]:
    """Every camera sees half of the board or more in every frame."""
    points_board = truth.shape.displaced(_BOARD, truth.shape_parameters)
    views = []
    for camera, (lens, cam_from_ref) in enumerate(
        zip(truth.lenses, truth.cams_from_ref, strict=True)
    ):
        for frame, ref_from_board in enumerate(truth.ref_from_boards):
            ids = np.sort(rng.permutation(30)[: rng.integers(15, 31)])
            pixels = lens.project((cam_from_ref @ ref_from_board).apply(points_board[ids]))
            pixels += rng.normal(0, sigma_px, pixels.shape)
            views.append(ObservedView(camera, frame, ids, pixels))
    return views


def _pack(views: Sequence[ObservedView], state: BundleState) -> Observations:
    return Observations.pack(views, _BOARD, state.models, len(state.board_trans_m))


def _disturbed(truth: BundleState, rng: np.random.Generator) -> BundleState:
    """Off by 6 px in focal length and centre, all distortion, 1 degree and 4 mm."""
    n_cameras, n_lens = truth.lens_parameters.shape
    lens_parameters = truth.lens_parameters.copy()
    lens_parameters[:, :4] += rng.uniform(-6, 6, (n_cameras, 4))
    lens_parameters[:, 4:] = 0
    pose_steps = np.tile([0.02, 0.02, 0.02, 0.004, 0.004, 0.004], (n_cameras, 1))
    pose_steps[0] = 0
    own = np.hstack([np.zeros((n_cameras, n_lens)), pose_steps])
    boards = np.tile([0.02, 0.02, 0.02, 0.004, 0.004, 0.004], len(truth.board_trans_m))
    steps = np.concatenate([own.ravel(), np.zeros(len(truth.shape)), boards])
    moved = truth.moved(steps * rng.uniform(-1, 1, len(steps)))
    return replace(
        moved, lens_parameters=lens_parameters, shape_parameters=np.zeros(len(truth.shape))
    )


def _covariance(result: BundleResult) -> FloatArray:
    covariance = result.equations.covariance()
    assert covariance is not None
    return covariance


def test_data_without_noise_give_back_the_truth(rng: np.random.Generator) -> None:
    """Lenses of all models, all poses, bow and aspect."""
    truth = _truth(rng, tuple(LENSES.values()), BoardShape.bowed(_BOARD, 2, aspect=True), 8)
    observations = _pack(_views(truth, 0, rng), truth)
    start = _disturbed(truth, rng)
    result = solve_bundle(observations, start, Free.everything(start), relative_decrease=1e-14)
    residuals = residuals_px(observations, result.state)
    assert max(np.abs(item).max() for item in residuals) < 1e-7
    for name in (
        "lens_parameters",  # the quotient of the rational lens is 1e5 times less sure than a pixel
        "cam_rotations",
        "cam_trans_m",
        "board_rotations",
        "board_trans_m",
        "shape_parameters",
    ):
        atol = 1e-3 if name == "lens_parameters" else 1e-7
        found, expected = getattr(result.state, name), getattr(truth, name)
        np.testing.assert_allclose(found, expected, atol=atol, err_msg=name)


def test_residuals_are_projected_minus_observed_view_by_view(rng: np.random.Generator) -> None:
    truth = _truth(rng, (BrownConrady, BrownConrady), BoardShape.flat(_BOARD), 3)
    views = _views(truth, 0, rng)
    offsets = rng.normal(size=(len(views), 2))
    moved = [
        replace(view, pixels=view.pixels + offset)
        for view, offset in zip(views, offsets, strict=True)
    ]
    order = rng.permutation(len(views))
    found = residuals_px(_pack([moved[i] for i in order], truth), truth)
    for index, residuals in zip(order, found, strict=True):
        expected = np.broadcast_to(-offsets[index], views[index].pixels.shape)
        np.testing.assert_allclose(residuals, expected, atol=1e-10)


def test_the_minimum_is_that_of_the_dense_adjustment(rng: np.random.Generator) -> None:
    truth = _truth(rng, (BrownConrady, BrownConrady), BoardShape.flat(_BOARD), 6)
    views = [
        replace(view, whitening=np.tril(rng.uniform(0.5, 2, (len(view.pixels), 2, 2))))
        for view in _views(truth, 0.5, rng)
    ]
    start, free = _disturbed(truth, rng), Free.everything(truth)
    result = solve_bundle(_pack(views, start), start, free, relative_decrease=1e-14)

    planar = [
        PlanarView(
            points_board=_BOARD[view.corner_ids], pixels=view.pixels, whitening=view.whitening
        )
        for view in views
    ]
    rows = [(view.camera, view.frame, item) for view, item in zip(views, planar, strict=True)]
    lenses = tuple(BrownConrady.from_parameters(row) for row in start.lens_parameters)
    expected = adjust(
        Sightings.collect(rows),
        Scene(lenses, start.cams_from_ref, start.ref_from_boards),
        adjustment.Free(free.lenses, free.cameras),
    )
    assert expected.covariance is not None
    n_residuals, n_free = expected.jacobian.shape
    cost = 0.5 * expected.variance * (n_residuals - n_free)
    assert result.cost == pytest.approx(cost, rel=1e-12)

    # Both stop after a step that lowers the cost by less than 1e-12 of it: in sigmas, so long
    last = np.sqrt(2e-12 * cost)
    covariance = expected.covariance / expected.variance
    sigma = np.sqrt(np.diag(covariance))
    off = result.state.lens_parameters - [lens.parameters for lens in expected.scene.lenses]
    np.testing.assert_allclose(off.ravel() / sigma[:18], 0, atol=last)
    found = [*result.state.cams_from_ref[1:], *result.state.ref_from_boards]
    wanted = [*expected.scene.cams_from_ref[1:], *expected.scene.ref_from_boards]
    pose_off = [_pose_step(a, b) for a, b in zip(found, wanted, strict=True)]
    np.testing.assert_allclose(np.ravel(pose_off) / sigma[18:], 0, atol=last)


def _pose_step(pose: Pose, origin: Pose) -> FloatArray:
    """The (omega, tau) of `Pose.perturbed` that leads from `origin` to `pose`."""
    turn = Rotation.from_matrix(pose.rotation @ origin.rotation.T).as_rotvec()
    return np.concatenate([turn, pose.trans_m - origin.trans_m])


def test_no_step_puts_a_board_behind_a_camera(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Boards three times too far away: steps of full length lead some of them through the lens."""
    truth = _truth(rng, (BrownConrady, BrownConrady), BoardShape.flat(_BOARD), 6)
    middle = truth.board_rotations @ _BOARD.mean(axis=0)
    start = replace(truth, board_trans_m=3 * (truth.board_trans_m + middle) - middle)
    taken: list[bool] = []
    tried: list[bool] = []
    move = BundleState.moved

    def spy(state: BundleState, step: FloatArray) -> BundleState:
        moved = move(state, step)
        taken.append(_is_behind(state))
        tried.append(_is_behind(moved))
        return moved

    monkeypatch.setattr(BundleState, "moved", spy)
    views = _views(truth, 0.5, rng)
    result = solve_bundle(_pack(views, truth), start, Free.everything(start))
    assert any(tried)  # it was tempted
    assert not any(taken)
    assert not _is_behind(result.state)


def _is_behind(state: BundleState) -> bool:
    return any(
        ((cam_from_ref @ ref_from_board).apply(_BOARD)[:, 2] <= 0).any()
        for cam_from_ref in state.cams_from_ref
        for ref_from_board in state.ref_from_boards
    )


def test_a_start_behind_a_camera_is_refused(rng: np.random.Generator) -> None:
    truth = _truth(rng, (BrownConrady,), BoardShape.flat(_BOARD), 4)
    trans_m = truth.board_trans_m.copy()
    trans_m[2, 2] = -0.3
    start = replace(truth, board_trans_m=trans_m)
    with pytest.raises(ValueError, match="start"):
        solve_bundle(_pack(_views(truth, 0.5, rng), truth), start, Free.everything(start))


def test_what_is_not_free_stays(rng: np.random.Generator) -> None:
    truth = _truth(rng, (BrownConrady, BrownConrady), BoardShape.bowed(_BOARD, 2), 6)
    start = _disturbed(truth, rng)
    observations = _pack(_views(truth, 0.5, rng), truth)
    boards = solve_bundle(observations, start, Free.only_boards(start)).state
    for name in "lens_parameters", "cam_rotations", "cam_trans_m", "shape_parameters":
        np.testing.assert_array_equal(getattr(boards, name), getattr(start, name))
    assert (boards.board_trans_m != start.board_trans_m).all()
    everything = solve_bundle(observations, start, Free.everything(start, reference=1)).state
    np.testing.assert_array_equal(everything.cam_rotations[1], start.cam_rotations[1])
    np.testing.assert_array_equal(everything.cam_trans_m[1], start.cam_trans_m[1])
    assert (everything.cam_trans_m[0] != start.cam_trans_m[0]).all()


def test_the_choice_of_the_reference_does_not_matter(rng: np.random.Generator) -> None:
    """Cost, lenses and the pose of one camera seen from the other are the same, sigmas too."""
    truth = _truth(rng, (BrownConrady, BrownConrady), BoardShape.flat(_BOARD), 6)
    observations = _pack(_views(truth, 0.5, rng), truth)
    results = [
        solve_bundle(
            observations, truth, Free.everything(truth, reference), relative_decrease=1e-14
        )
        for reference in (0, 1)
    ]
    assert results[0].cost == pytest.approx(results[1].cost, rel=1e-12)
    lens = np.r_[0:9, 15:24]
    sigmas = [np.sqrt(np.diag(_covariance(result))[lens]) for result in results]
    # Of the last step: relative 1e-14 of a cost of 100 is 1e-6 of a sigma
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=1e-5)
    off = results[0].state.lens_parameters - results[1].state.lens_parameters
    np.testing.assert_allclose(off.ravel() / sigmas[0], 0, atol=1e-5)
    pair = [
        result.state.cams_from_ref[1] @ result.state.cams_from_ref[0].inverse()
        for result in results
    ]
    np.testing.assert_allclose(_pose_step(*pair), 0, atol=1e-8)


def test_solutions_scatter_as_the_covariance_says(rng: np.random.Generator) -> None:
    """One camera, 8 boards, 120 draws of noise; limits are four sigma of what is counted."""
    n_draws, sigma_px = 120, 0.2
    truth = _truth(rng, (BrownConrady,), BoardShape.bowed(_BOARD, 2), 8)
    free = Free.everything(truth)
    clean = [
        replace(view, whitening=np.tile(np.eye(2) / sigma_px, (len(view.pixels), 1, 1)))
        for view in _views(truth, 0, rng)
    ]
    result = solve_bundle(_pack(clean, truth), truth, free)
    joint = _covariance(result)
    boards = result.equations.board_covariances(joint)
    assert boards is not None
    offs: list[list[FloatArray]] = []
    for _ in range(n_draws):
        views = [
            replace(view, pixels=view.pixels + rng.normal(0, sigma_px, view.pixels.shape))
            for view in clean
        ]
        state = solve_bundle(_pack(views, truth), truth, free).state
        lens = (state.lens_parameters - truth.lens_parameters)[0]
        shape = state.shape_parameters - truth.shape_parameters
        board = _pose_step(state.ref_from_boards[0], truth.ref_from_boards[0])
        offs.append([np.concatenate([lens, shape]), board])
    for off, covariance in zip(
        map(np.array, zip(*offs, strict=True)),
        (joint[np.ix_(free.mask, free.mask)], boards[0]),
        strict=True,
    ):
        n = len(covariance)
        ratio = off.std(axis=0) / np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(ratio, 1, atol=4 / np.sqrt(2 * n_draws))
        distance = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
        assert distance.mean() == pytest.approx(n, abs=4 * np.sqrt(2 * n / n_draws))

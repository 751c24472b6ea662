"""Bundles at the edge: cameras and frames of which nothing is known, and data that are no data."""

from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.least_squares import DenseEquations, levenberg_marquardt
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import (
    BoardShape,
    BundleEquations,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.bundle.blocks import view_blocks
from calichrome.geometry.bundle.noise import view_noise
from calichrome.geometry.bundle.robust import solve_robust
from calichrome.geometry.lenses import BrownConrady

_N_CAMERAS, _N_FRAMES = 2, 10


def _grid(nx: int, ny: int) -> FloatArray:
    x, y = np.meshgrid(np.arange(nx) * 0.24 / (nx - 1), np.arange(ny) * 0.15 / (ny - 1))
    return np.stack([x.ravel(), y.ravel(), np.zeros(nx * ny)], axis=1)


_BOARD = _grid(9, 6)


def _truth(rng: np.random.Generator) -> BundleState:
    lens = BrownConrady(fx=400, fy=402, cx=322, cy=238, k1=-0.2, k2=0.05, p1=1e-3, p2=-1e-3)
    boards = []
    for _ in range(_N_FRAMES):
        turn = Pose.from_rotvec(rng.uniform(-0.6, 0.6, 3), np.zeros(3))
        middle = np.array([*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.3, 0.4)])
        boards.append(Pose(turn.rotation, middle - turn.apply(_BOARD.mean(axis=0))))
    cams_from_ref = [Pose.identity(), Pose.from_rotvec([0.02, 0.2, 0.01], [-0.08, 0, 0.01])]
    return BundleState.build([lens, lens], cams_from_ref, boards, BoardShape.flat(_BOARD))


def _views(
    truth: BundleState, sigma_px: tuple[float, float], rng: np.random.Generator
) -> list[ObservedView]:
    views = []
    for camera in range(_N_CAMERAS):
        for frame in range(_N_FRAMES):
            cam_from_board = truth.cams_from_ref[camera] @ truth.ref_from_boards[frame]
            pixels = truth.lenses[camera].project(cam_from_board.apply(_BOARD))
            pixels += rng.normal(0, sigma_px[camera], pixels.shape)
            views.append(ObservedView(camera, frame, np.arange(54), pixels))
    return views


def _pack(views: list[ObservedView], state: BundleState) -> Observations:
    return Observations.pack(views, _BOARD, state.models, _N_FRAMES)


def test_cameras_that_are_known_have_no_covariance_left(rng: np.random.Generator) -> None:
    truth = _truth(rng)
    observations = _pack(_views(truth, (0.2, 0.2), rng), truth)
    equations = solve_bundle(observations, truth, Free.only_boards(truth)).equations
    covariance = equations.covariance()
    assert covariance is not None
    assert not covariance.any()
    assert equations.open_columns() == frozenset()
    boards = equations.board_covariances(covariance)
    assert boards is not None
    assert (np.linalg.eigvalsh(boards) > 0).all()


def test_a_camera_that_saw_nothing_stays_where_it_is(rng: np.random.Generator) -> None:
    """The others are solved as if it were not there; that it is unknown is not hidden."""
    truth = _truth(rng)
    views = [view for view in _views(truth, (0.2, 0.2), rng) if view.camera == 0]
    everything = Free.everything(truth)
    result = solve_bundle(_pack(views, truth), truth, everything)
    np.testing.assert_array_equal(result.state.lens_parameters[1], truth.lens_parameters[1])
    np.testing.assert_array_equal(result.state.cam_trans_m[1], truth.cam_trans_m[1])
    assert result.equations.covariance() is None
    assert result.equations.open_columns() == frozenset(range(15, 30))

    held = Free(
        lenses=everything.lenses & [[True], [False]],
        cameras=np.zeros(2, dtype=bool),
        shape=everything.shape,
    )
    alone = solve_bundle(_pack(views, truth), truth, held)
    assert alone.equations.covariance() is not None
    assert alone.cost == pytest.approx(result.cost, rel=1e-9)


def test_a_frame_without_weight_is_a_frame_left_out(rng: np.random.Generator) -> None:
    truth = _truth(rng)
    views = _views(truth, (0.2, 0.2), rng)
    weightless = [
        replace(view, whitening=np.zeros((54, 2, 2))) if view.frame == 3 else view for view in views
    ]
    fewer = [view for view in views if view.frame != 3]
    found, expected = (
        solve_bundle(_pack(some, truth), truth, Free.everything(truth))
        for some in (weightless, fewer)
    )
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    np.testing.assert_array_equal(found.state.board_trans_m[3], truth.board_trans_m[3])
    covariances = found.equations.covariance(), expected.equations.covariance()
    assert covariances[0] is not None
    assert covariances[1] is not None
    sigma = np.sqrt(np.diag(covariances[1]))
    np.testing.assert_allclose(np.sqrt(np.diag(covariances[0])), sigma, rtol=1e-6)
    boards = found.equations.board_covariances(covariances[0])
    assert boards is not None
    assert np.isnan(boards).all(axis=(1, 2)).tolist() == [frame == 3 for frame in range(_N_FRAMES)]


def test_a_frame_of_nonsense_is_left_out_whole(rng: np.random.Generator) -> None:
    """By chance a corner or two lie where they should: they do not make a view."""
    truth = _truth(rng)
    views = _views(truth, (0.2, 0.2), rng)
    spoiled = [
        replace(view, pixels=view.pixels + rng.normal(0, 20, (54, 2))) if view.frame == 3 else view
        for view in views
    ]
    result = solve_robust(_pack(spoiled, truth), truth, Free.everything(truth))
    for view, is_inlier in zip(views, result.inliers, strict=True):
        assert is_inlier.all() == (view.frame != 3)
        assert is_inlier.any() == (view.frame != 3)
    assert result.result.equations.covariance() is not None


def test_noise_of_unlike_cameras_has_no_bias(rng: np.random.Generator) -> None:
    """The sharper camera fixes most boards, so more of its equations are spent: mean of 40 draws.

    Shared by corners, they give it 0.96 of its noise, and the other 1.04 (these 40 draws).
    """
    sigma_px, n_draws = (0.1, 0.6), 40
    ratios = []
    for _ in range(n_draws):
        truth = _truth(rng)
        views = [
            replace(view, corner_ids=view.corner_ids[::3], pixels=view.pixels[::3])
            for view in _views(truth, sigma_px, rng)
        ]
        noise = solve_robust(_pack(views, truth), truth, Free.everything(truth)).noise
        ratios.append(noise / sigma_px)
    n_equations = 2 * 18 * _N_FRAMES
    sigma = 1 / np.sqrt(2 * (n_equations - 9 - 6 * _N_FRAMES) * n_draws)
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=4 * sigma)


def test_shares_in_a_board_add_up(rng: np.random.Generator) -> None:
    """They are traces of a hat matrix: over the views of a frame, one; by weight between them."""
    truth = _truth(rng)
    views = [
        replace(view, whitening=np.tile(np.eye(2) * (3 if view.camera else 1), (54, 1, 1)))
        for view in _views(truth, (0.2, 0.2), rng)
        if not (view.camera and view.frame == 4)
    ]
    observations = _pack(views, truth)
    blocks = view_blocks(observations, truth)
    shares = BundleEquations(observations, truth, Free.everything(truth), blocks).shares()
    np.testing.assert_allclose(np.bincount(observations.frame, shares), 1, rtol=1e-9)
    assert shares[observations.frame == 4] == pytest.approx(1)
    both = observations.frame != 4
    sharp, blunt = (
        shares[both & (observations.camera == 1)],
        shares[both & (observations.camera == 0)],
    )
    assert sharp.mean() == pytest.approx(0.9, abs=0.03)  # 9 : 1, but for the places of the cameras
    assert (sharp > blunt).all()


def test_data_without_any_error_have_no_noise(rng: np.random.Generator) -> None:
    truth = _truth(rng)
    views = _views(truth, (0, 0), rng)
    exact = [
        replace(view, pixels=view.pixels + residuals)
        for view, residuals in zip(views, residuals_px(_pack(views, truth), truth), strict=True)
    ]
    result = solve_robust(_pack(exact, truth), truth, Free.everything(truth))
    assert all(item.all() for item in result.inliers)
    np.testing.assert_allclose(result.noise, 0, atol=1e-9)
    np.testing.assert_allclose(
        result.result.state.lens_parameters, truth.lens_parameters, atol=1e-6
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda view: replace(view, corner_ids=view.corner_ids + 1), "frame 5: a corner that"),
        (lambda view: replace(view, corner_ids=view.corner_ids - 1), "frame 5: a corner that"),
        (
            lambda view: replace(view, corner_ids=np.arange(0), pixels=np.zeros((0, 2))),
            "frame 5: has no corner",
        ),
        (lambda view: replace(view, pixels=view.pixels * np.nan), "frame 5: .* not finite"),
    ],
)
def test_views_that_are_none_are_refused(
    spoil: "object", message: str, rng: np.random.Generator
) -> None:
    truth = _truth(rng)
    views = _views(truth, (0.2, 0.2), rng)
    assert callable(spoil)
    views[5] = spoil(views[5])
    with pytest.raises(ValueError, match=f"camera 0, {message}"):
        _pack(views, truth)


@pytest.mark.parametrize("corners_xy", [(8, 20), (20, 8), (16, 10), (9, 20)])
def test_thinning_leaves_no_line(corners_xy: tuple[int, int], rng: np.random.Generator) -> None:
    board = _grid(*corners_xy)
    n = len(board)
    views = [ObservedView(0, 0, np.arange(n), rng.normal(size=(n, 2)))]
    thin = Observations.pack(views, board, (BrownConrady,), 1).thinned(20)
    kept = board[thin.chunks[0].corner_ids[0], :2]
    assert len(kept) == 20
    # spread along its thin direction: a fifth of the board's, which is 0.29 of its size
    spread = np.linalg.svd(kept - kept.mean(axis=0), compute_uv=False)[-1] / np.sqrt(20)
    assert spread > 0.2 * 0.29 * 0.15


@pytest.mark.parametrize(
    ("corners_xy", "names"),
    [
        ((2, 7), ("uv", "vv", "uvv")),
        ((7, 2), ("uu", "uv", "uuv")),
        ((2, 2), ("uv",)),
        ((3, 2), ("uu", "uv", "uuv")),
    ],
)
def test_small_boards_have_fewer_ways_to_bend(
    corners_xy: tuple[int, int], names: tuple[str, ...]
) -> None:
    """As many as they have corners beyond the three of a plane, and no more than tell apart."""
    points = _grid(*corners_xy)
    shape = BoardShape.bowed(points, 5)
    assert shape.names == names
    heights = np.stack([np.ones(len(points)), *points[:, :2].T, *shape.basis[:, 2]])
    assert np.linalg.matrix_rank(heights) == 3 + len(names)


def test_views_of_few_corners_are_not_taken_to_differ(rng: np.random.Generator) -> None:
    """20 recordings of 400 views of 6 corners and equal noise, at a level of 0.001 each."""
    ids = np.arange(6)
    views = [ObservedView(0, frame, ids, np.zeros((6, 2))) for frame in range(400)]
    observations = Observations.pack(views, _BOARD, (BrownConrady,), 400)
    free = Free(
        lenses=np.zeros((1, 9), dtype=bool),
        cameras=np.zeros(1, dtype=bool),
        shape=np.zeros(0, dtype=bool),
    )
    n_alarms = 0
    for _ in range(20):
        # as if six of the twelve equations of a view were spent on its board
        lengths = [
            np.sqrt(rng.chisquare(1, chunk.corner_ids.shape)) for chunk in observations.chunks
        ]
        kept = [chunk.filled for chunk in observations.chunks]
        noise = view_noise(observations, lengths, kept, free, views_differ=True)
        n_alarms += int(np.ptp(noise) > 0)
    assert n_alarms <= 1


def test_a_minimum_behind_a_wall_is_not_called_reached() -> None:
    """The least x is 0, but x below 1 is impossible: steps are short because longer ones fail."""

    def linearise(x: FloatArray) -> DenseEquations:
        return DenseEquations(np.where(x > 1, x, np.nan), np.ones((1, 1)))

    result = levenberg_marquardt(
        np.array([2.0]), linearise, lambda x, step: x + step, relative_decrease=1e-6
    )
    assert result.state[0] == pytest.approx(1, abs=1e-3)
    assert result.stop_reason == "stalled"

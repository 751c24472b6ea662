"""Cameras placed by pairs and paths: the truth, and an honest sigma of every place."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import DisconnectedRigError, SolveError
from calichrome.geometry.adjustment import Scene
from calichrome.geometry.held_out import held_out_rms_px
from calichrome.geometry.intrinsics import CameraSolution
from calichrome.geometry.pairs import PairSolution, solve_pair
from calichrome.geometry.rig_graph import UncertainPose
from calichrome.geometry.rig_solve import RigSolution, planar_view, solve_rig_pairwise
from calichrome.observations import Dataset
from calichrome.target import Target

MakeRig = Callable[[Target, int, int], Scene]
Observe = Callable[[Scene, Target, float, np.random.Generator], Dataset]

_SIGMA_PX = 0.2


def _kept(dataset: Dataset, frames: Mapping[str, Iterable[int]]) -> Dataset:
    """Leave each camera only the frames listed for it."""
    views = {
        camera: {f"{frame:02}": dataset.views[camera][f"{frame:02}"] for frame in kept}
        for camera, kept in frames.items()
    }
    return dataset.with_views(views)


def _step(found: Pose, truth: Pose) -> FloatArray:
    """Return the (omega, tau) that leads from `truth` to `found`."""
    turn: FloatArray = Rotation.from_matrix(found.rotation @ truth.rotation.T).as_rotvec()
    return np.concatenate([turn, found.trans_m - truth.trans_m])


def _cov(place: UncertainPose) -> FloatArray:
    assert place.cov is not None
    return place.cov


def _misfit(found: UncertainPose, truth: Pose) -> float:
    """Squared error in units of its covariance: chi-square with 6 degrees of freedom."""
    error = _step(found.pose, truth)
    return float(error @ np.linalg.solve(_cov(found), error))


def _solve(dataset: Dataset, board: Target, truth: Scene, reference: str = "a") -> RigSolution:
    """Solve from the true lenses, which only saves time."""
    lenses = dict(zip("abcdef", truth.lenses, strict=False))
    return solve_rig_pairwise(dataset, board, reference=reference, start=lenses)


def test_exact_corners_give_the_exact_rig(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 3, 8)
    solved = solve_rig_pairwise(observe(truth, board, 0, rng), board, reference="a")
    for camera, expected in zip("abc", truth.cams_from_ref, strict=True):
        found = solved.graph.cams_from_ref[camera].pose
        # rad and m: the lenses are exact to 1e-7 of their size
        np.testing.assert_allclose(_step(found, expected), 0, atol=1e-8)
    for placed, expected in zip(solved.boards.values(), truth.ref_from_boards, strict=True):
        np.testing.assert_allclose(_step(placed.ref_from_board, expected), 0, atol=1e-8)


def test_pair_recovers_the_truth(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 2, 12)
    solved = solve_rig_pairwise(observe(truth, board, _SIGMA_PX, rng), board)
    pair = solved.pairs["a", "b"]
    assert pair.cov is not None
    error = _step(pair.b_from_a, truth.cams_from_ref[1] @ truth.cams_from_ref[0].inverse())
    # 99.99 % of all draws lie within 4 sigma; the sigmas themselves are tested below
    np.testing.assert_array_less(np.abs(error), 4 * np.sqrt(np.diag(pair.cov)))
    # Two cameras 0.4 m apart, boards at 0.65 m: the principal points (sigma 2 px of 600) turn the
    # cameras by 0.2 degrees and move them by 1.3 mm at the boards. Four times that is no feat.
    np.testing.assert_array_less(np.abs(error[:3]), np.radians(0.8))
    np.testing.assert_array_less(np.abs(error[3:]), 0.01)
    # Two coordinates a corner; each lens was free to suit its own boards, so together they fit
    # by some per cent less well than the noise.
    assert pair.rms_px == pytest.approx(_SIGMA_PX * np.sqrt(2), rel=0.1)


def test_motion_there_and_back_is_one_estimate(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 2, 8), board, _SIGMA_PX, rng)
    forth = solve_rig_pairwise(dataset, board, reference="a").graph.cams_from_ref["b"]
    back = solve_rig_pairwise(dataset, board, reference="b").graph.cams_from_ref["a"]
    there = back.inverse()
    np.testing.assert_allclose(_step(there.pose, forth.pose), 0, atol=1e-12)
    np.testing.assert_allclose(_cov(there), _cov(forth), rtol=1e-9, atol=1e-20)


def test_order_of_cameras_and_frames_changes_nothing(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 3, 8), board, _SIGMA_PX, rng)
    shuffled = replace(
        dataset,
        views={
            camera: {frame: dataset.views[camera][frame] for frame in order}
            for camera, order in (
                ("c", rng.permutation(dataset.frames)),
                ("a", rng.permutation(dataset.frames)),
                ("b", rng.permutation(dataset.frames)),
            )
        },
    )
    one = solve_rig_pairwise(dataset, board, reference="a")
    other = solve_rig_pairwise(shuffled, board, reference="a")
    for camera in "abc":
        assert one.graph.paths[camera] == other.graph.paths[camera]
        lens_cov = one.cameras[camera].lens_cov
        assert lens_cov is not None
        change = one.cameras[camera].lens.parameters - other.cameras[camera].lens.parameters
        # The solver stops where parameters are exact to about 1e-6 sigma; how far it gets
        # beyond depends on rounding.
        assert (np.abs(change) <= 1e-4 * np.sqrt(np.diag(lens_cov))).all()
        here, there = one.graph.cams_from_ref[camera], other.graph.cams_from_ref[camera]
        moved = np.abs(_step(here.pose, there.pose))
        assert (moved <= 1e-4 * np.sqrt(np.diag(_cov(here)))).all()


def test_places_scatter_as_their_covariances_say(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    """A pair, and a third camera on a chain through the second."""
    truth = make_rig(board, 3, 12)
    seen = {"a": range(7), "b": range(12), "c": range(5, 12)}  # two frames of a and c: too few
    n_draws = 30
    squared = {"b": 0.0, "c": 0.0}
    for _ in range(n_draws):
        solved = _solve(_kept(observe(truth, board, _SIGMA_PX, rng), seen), board, truth)
        assert solved.graph.paths["c"] == ("a", "b", "c")
        for index, camera in ((1, "b"), (2, "c")):
            place = solved.graph.cams_from_ref[camera]
            squared[camera] += _misfit(place, truth.cams_from_ref[index])
    # Chi-square over 6 x 30: mean 1, sigma sqrt(2 / 180) = 0.105; three of these.
    assert squared["b"] / (6 * n_draws) == pytest.approx(1, abs=0.32)
    assert squared["c"] / (6 * n_draws) == pytest.approx(1, abs=0.32)


def test_pair_of_known_lenses_scatters_as_its_covariance_says(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    """The share of the corners alone, which the lenses outweigh elsewhere."""
    truth = make_rig(board, 2, 4)
    b_from_a = truth.cams_from_ref[1]
    poses_a = {f"{frame:02}": pose for frame, pose in enumerate(truth.ref_from_boards)}
    poses_b = {frame: b_from_a @ pose for frame, pose in poses_a.items()}
    cameras = [
        CameraSolution(
            lens=lens, lens_cov=np.zeros((9, 9)), cams_from_board=(), residuals_px=(), rms_px=0.0
        )
        for lens in truth.lenses
    ]
    n_draws = 100
    squared = 0.0
    for _ in range(n_draws):
        dataset = observe(truth, board, _SIGMA_PX, rng)
        views_a, views_b = (
            {frame: planar_view(view, board) for frame, view in dataset.views[camera].items()}
            for camera in "ab"
        )
        pair = solve_pair(views_a, views_b, cameras[0], cameras[1], poses_a, poses_b)
        squared += _misfit(UncertainPose(pair.b_from_a, _named(pair, "a", "b")), b_from_a)
    # Chi-square over 6 x 100: mean 1, sigma sqrt(2 / 600) = 0.058; three of these
    assert squared / (6 * n_draws) == pytest.approx(1, abs=0.175)


@pytest.mark.slow
@pytest.mark.parametrize("shared", ["disjoint", "all"])
def test_every_sigma_of_every_place(
    shared: str, board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    """A chain of four cameras whose steps see different boards, or all the same ones."""
    truth = make_rig(board, 4, 18)
    seen: dict[str, Iterable[int]] = {
        "a": range(6), "b": range(12), "c": range(6, 18), "d": range(12, 18)
    }  # fmt: skip
    n_draws = 150
    errors: dict[str, list[FloatArray]] = {camera: [] for camera in "bcd"}
    variances: dict[str, list[FloatArray]] = {camera: [] for camera in "bcd"}
    for _ in range(n_draws):
        dataset = observe(truth, board, _SIGMA_PX, rng)
        dataset = _kept(dataset, seen if shared == "disjoint" else dict.fromkeys("abcd", range(12)))
        solved = _solve(dataset, board, truth)
        places = dict(solved.graph.cams_from_ref)
        if shared == "all":  # the graph would take the direct pairs
            for previous, following in (("b", "c"), ("c", "d")):
                places[following] = _linked(solved, previous, following) @ places[previous]
        for index, camera in enumerate("bcd", start=1):
            errors[camera].append(_step(places[camera].pose, truth.cams_from_ref[index]))
            variances[camera].append(np.diag(_cov(places[camera])))
    ratios = np.stack(
        [
            np.std(errors[camera], axis=0, ddof=1) / np.sqrt(np.mean(variances[camera], axis=0))
            for camera in "bcd"
        ]
    )
    # The scatter of 150 draws is itself known to 1 / sqrt(2 x 149) = 5.8 %; three of these and
    # the second order. Steps taken as independent give 0.72 to 0.85 for most numbers of d.
    np.testing.assert_allclose(ratios, 1, atol=0.2)


def _named(
    pair: PairSolution, camera_a: str, camera_b: str
) -> dict[tuple[str, str | None], FloatArray]:
    assert pair.errors is not None
    names = (camera_a, camera_b)
    return {(names[side], frame): part for (side, frame), part in pair.errors.items()}


def _linked(solved: RigSolution, previous: str, following: str) -> UncertainPose:
    pair = solved.pairs[previous, following]
    return UncertainPose(pair.b_from_a, _named(pair, previous, following))


def _noisy_shortcut(
    truth: Scene, board: Target, observe: Observe, rng: np.random.Generator, sigma_px: float
) -> Dataset:
    """Let a-b and b-c share eight clean frames each, a-c three frames of `sigma_px`."""
    clean, noisy = (observe(truth, board, sigma, rng) for sigma in (_SIGMA_PX, sigma_px))
    frames = {"a": range(8), "b": range(16), "c": range(8, 16)}
    ends = _kept(noisy, {"a": range(16, 19), "c": range(16, 19)})
    views = {
        camera: {**seen, **ends.views.get(camera, {})}
        for camera, seen in _kept(clean, frames).views.items()
    }
    return clean.with_views(views)


@pytest.mark.parametrize(("sigma_px", "path"), [(2.0, "abc"), (0.2, "ac")])
def test_path_avoids_the_noisy_pair(
    sigma_px: float,
    path: str,
    board: Target,
    make_rig: MakeRig,
    observe: Observe,
    rng: np.random.Generator,
) -> None:
    truth = make_rig(board, 3, 19)
    dataset = _noisy_shortcut(truth, board, observe, rng, sigma_px)
    solved = solve_rig_pairwise(dataset, board, reference="a")
    assert solved.pairs["a", "c"].n_shared == 3
    assert solved.graph.paths["c"] == tuple(path)


def test_two_shared_views_serve_only_where_nothing_else_connects(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    truth = make_rig(board, 3, 16)
    dataset = observe(truth, board, _SIGMA_PX, rng)
    around = _kept(dataset, {"a": [*range(8), 14, 15], "b": range(14), "c": range(6, 16)})
    solved = solve_rig_pairwise(around, board, reference="a")
    assert solved.pairs["a", "c"].n_shared == 4  # frames 6, 7, 14, 15
    assert solved.graph.paths["c"] == ("a", "c")

    weak = _kept(dataset, {"a": [*range(8), 14, 15], "b": range(14), "c": range(8, 16)})
    solved = solve_rig_pairwise(weak, board, reference="a")
    assert solved.pairs["a", "c"].n_shared == 2
    assert solved.graph.paths["c"] == ("a", "b", "c")

    alone = _kept(dataset, {"a": [*range(8), 14, 15], "b": range(8), "c": range(8, 16)})
    solved = solve_rig_pairwise(alone, board, reference="a")
    assert solved.graph.paths["c"] == ("a", "c")
    error = _step(solved.graph.cams_from_ref["c"].pose, truth.cams_from_ref[2])
    np.testing.assert_array_less(
        np.abs(error), 4 * np.sqrt(np.diag(_cov(solved.graph.cams_from_ref["c"])))
    )


def test_separate_groups_are_named(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 4, 12), board, _SIGMA_PX, rng)
    apart = _kept(dataset, {"a": range(6), "c": range(6, 12), "b": range(6), "d": range(6, 12)})
    with pytest.raises(DisconnectedRigError) as caught:
        solve_rig_pairwise(apart, board)
    assert {frozenset(group) for group in caught.value.groups} == {
        frozenset("ab"),
        frozenset("cd"),
    }
    assert "a, b | c, d" in str(caught.value)


def test_a_camera_with_too_few_views_is_named(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 2, 8), board, _SIGMA_PX, rng)
    with pytest.raises(SolveError, match="camera b: 2 views"):
        solve_rig_pairwise(_kept(dataset, {"a": range(8), "b": range(2)}), board)


def test_an_unknown_reference_is_refused(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 2, 6), board, _SIGMA_PX, rng)
    with pytest.raises(SolveError, match="reference camera z"):
        solve_rig_pairwise(dataset, board, reference="z")


def test_held_out_error_is_the_noise(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 2, 24), board, _SIGMA_PX, rng)
    noise_px = _SIGMA_PX * np.sqrt(2)
    alone = _kept(dataset, {"a": range(24)})
    held_out = held_out_rms_px(solve_rig_pairwise(alone, board), board)["a"]
    # Of 108 numbers a frame the board takes 6; nine lens parameters from 18 frames add back 1 %.
    # The mean square of 2592 numbers is known to 2.8 %, its root to 1.4 %; three of these.
    assert held_out == pytest.approx(noise_px * np.sqrt(1 - 6 / 108), rel=0.045)
    # With one pose for two cameras nothing hides the errors of the lenses: some per cent more.
    both = held_out_rms_px(solve_rig_pairwise(dataset, board), board)
    assert set(both) == {"a", "b"}
    for value in both.values():
        assert value == pytest.approx(noise_px, rel=0.1)


def test_held_out_error_sees_more_than_the_fit(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    """Four views hardly fix nine parameters: the fit looks better than it is."""
    dataset = observe(make_rig(board, 1, 4), board, 1.0, rng)
    solved = solve_rig_pairwise(dataset, board)
    held_out = held_out_rms_px(solved, board)["a"]
    assert held_out is not None
    assert held_out > 1.02 * solved.cameras["a"].rms_px


def test_held_out_error_is_unknown_where_a_fold_has_too_little(
    board: Target, make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    dataset = observe(make_rig(board, 2, 8), board, _SIGMA_PX, rng)
    dataset = _kept(dataset, {"a": range(8), "b": range(3)})
    solved = solve_rig_pairwise(dataset, board)
    assert held_out_rms_px(solved, board) == {"a": None, "b": None}

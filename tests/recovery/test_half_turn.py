"""Boards that look the same when turned: the rig knows which way up each one was."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.errors import AmbiguousBoardError
from calichrome.geometry.adjustment import Scene
from calichrome.geometry.rig_pairwise import solve_rig_pairwise
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import Dataset
from calichrome.target import Target, chessboard

MakeRig = Callable[[Target, int, int], Scene]
Observe = Callable[[Scene, Target, float, np.random.Generator], Dataset]
Solve = Callable[[Dataset, Target], RigSolution]


def _pairwise(dataset: Dataset, target: Target) -> RigSolution:
    return solve_rig_pairwise(dataset, target, reference="a")


def _joint(dataset: Dataset, target: Target) -> RigSolution:
    return solve_rig(dataset, target, RigSettings(reference="a"))


_BOTH = pytest.mark.parametrize("solve", [_pairwise, _joint], ids=["pairwise", "joint"])


def _turned(dataset: Dataset, target: Target, rng: np.random.Generator) -> Dataset:
    """Number the corners of every view as one of the turns that nobody can tell apart."""
    views = {
        camera: {
            frame: replace(
                view,
                corners_px=view.corners_px[
                    target.symmetries[int(rng.integers(len(target.symmetries)))]
                ],
            )
            for frame, view in seen.items()
        }
        for camera, seen in dataset.views.items()
    }
    return dataset.with_views(views)


@_BOTH
@pytest.mark.parametrize(
    ("corners_xy", "n_turns"), [((6, 4), 2), ((7, 5), 2), ((4, 4), 4), ((6, 6), 4)]
)
def test_one_rigid_rig_results(
    solve: Solve,
    corners_xy: tuple[int, int],
    n_turns: int,
    make_rig: MakeRig,
    observe: Observe,
    rng: np.random.Generator,
) -> None:
    target = chessboard(corners_xy, (0.035, 0.035))
    assert len(target.symmetries) == n_turns
    truth = make_rig(target, 3, 9)
    dataset = _turned(observe(truth, target, 0.2, rng), target, rng)
    solved = solve(dataset, target)
    for camera, expected in zip("abc", truth.cams_from_ref, strict=True):
        place, cov = solved.cams_from_ref[camera], solved.pose_cov[camera]
        turn = Rotation.from_matrix(place.rotation @ expected.rotation.T).as_rotvec()
        error = np.concatenate([turn, place.trans_m - expected.trans_m])
        assert cov is not None
        # 99.99 % of all draws lie within 4 sigma (of 16 corners a view: up to 2 degrees)
        assert (np.abs(error) <= 4 * np.sqrt(np.diag(cov))).all()
    for pair in solved.pairs.values():
        # Noise of 0.28 px, and as much of lenses from 16 corners a view; one view of nine turned
        # wrongly (by half a board, 100 px) would give 10 px or more.
        assert pair.rms_px < 1
    for frame in solved.dataset.frames:
        turns = [
            _turn_of(solved.dataset, observe(truth, target, 0, rng), target, camera, frame)
            for camera in "abc"
        ]
        assert len(set(turns)) == 1  # all cameras number the corners of a frame alike


def _turn_of(found: Dataset, exact: Dataset, target: Target, camera: str, frame: str) -> int:
    """Which turn of the true numbering a view has."""
    pixels = exact.views[camera][frame].corners_px
    distances = [
        np.abs(found.views[camera][frame].corners_px - pixels[turn]).max()
        for turn in target.symmetries
    ]
    return int(np.argmin(distances))


def test_turned_views_contradict_each_other_without_the_resolution(
    make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    """The same data, said to be sure of its numbering, must not pass."""
    target = chessboard((6, 4), (0.035, 0.035))
    dataset = _turned(observe(make_rig(target, 2, 9), target, 0.2, rng), target, rng)
    sure = dataset.with_views(
        {
            camera: {
                frame: replace(view, half_turn_ambiguous=False) for frame, view in seen.items()
            }
            for camera, seen in dataset.views.items()
        }
    )
    assert solve_rig_pairwise(sure, target).pairs["a", "b"].rms_px > 10


def test_one_shared_frame_decides_nothing(
    make_rig: MakeRig, observe: Observe, rng: np.random.Generator
) -> None:
    target = chessboard((6, 4), (0.035, 0.035))
    dataset = observe(make_rig(target, 2, 9), target, 0.2, rng)
    shared = dataset.with_views(
        {
            "a": {frame: view for frame, view in dataset.views["a"].items() if frame <= "04"},
            "b": {frame: view for frame, view in dataset.views["b"].items() if frame >= "04"},
        }
    )
    with pytest.raises(AmbiguousBoardError) as caught:
        solve_rig_pairwise(shared, target)
    assert caught.value.frames == ("04",)
    assert "frame 04" in str(caught.value)

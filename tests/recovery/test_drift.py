"""A camera that moved, or whose lens changed, is named; one that did not is not."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.geometry.rigs import SIGMA_PX, Scene, observed
from benchmarks.geometry.scenes import converging, stereo

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import ObservedView
from calichrome.geometry.drift import Drift, KnownRig, find_drift
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig

Views = dict[str, dict[str, ObservedView]]

_SHIFT = np.array([0.0, np.radians(0.3), 0.0, 0.003, 0.004, 0.0])  # 5 mm and 0.3 degrees


def _known(solved: RigSolution, scene: Scene, *, with_cov: bool = True) -> KnownRig:
    joint, shape = solved.joint, solved.shape
    assert joint is not None
    assert shape is not None
    rows = np.concatenate([*joint.columns.values(), joint.shape])
    return KnownRig(
        lenses=solved.lenses,
        cams_from_ref=solved.cams_from_ref,
        noise=solved.noise,
        corners_board=scene.target.corners_board,
        shape=shape,
        shape_parameters=solved.shape_parameters,
        cov=joint.matrix[np.ix_(rows, rows)] if with_cov else None,
    )


def _solved(scene: Scene, draw: int, start: RigSolution | None = None) -> RigSolution:
    dataset = observed(scene, [5, draw]).dataset
    settings = RigSettings(reference=scene.reference, start=start)  # a start only saves time
    return solve_rig(dataset, scene.target, settings)


@pytest.fixture(scope="module")
def four() -> tuple[Scene, KnownRig]:
    scene = converging(0)
    return scene, _known(_solved(scene, 0), scene)


def _new(
    scene: Scene,
    rng: np.random.Generator,
    n_frames: int,
    *,
    moved: Mapping[str, FloatArray] | None = None,
    zoomed: Mapping[str, float] | None = None,
    sigma_px: float = SIGMA_PX,
) -> Views:
    """Views of boards that all cameras see, of which some have changed."""
    shared = [
        frame
        for frame in scene.ref_from_boards
        if all(frame in frames for frames in scene.seen.values())
    ]
    frames = [str(frame) for frame in rng.permutation(shared)[:n_frames]]
    views: Views = {}
    for camera, lens in scene.lenses.items():
        change = (moved or {}).get(camera, np.zeros(6))
        cam_from_ref = Pose.from_rotvec(change[:3], change[3:]) @ scene.cams_from_ref[camera]
        scale = (zoomed or {}).get(camera, 1.0)
        now = replace(lens, fx=lens.fx * scale, fy=lens.fy * scale)
        views[camera] = {}
        for frame in frames:
            place = cam_from_ref @ scene.ref_from_boards[frame]
            pixels = now.project(place.apply(scene.corners_board))
            views[camera][frame] = ObservedView(
                0, 0, np.arange(len(pixels)), pixels + rng.normal(0, sigma_px, pixels.shape),
                np.tile(np.eye(2) / SIGMA_PX, (len(pixels), 1, 1)),
            )  # fmt: skip
    return views


def _said(found: Drift) -> set[str]:
    return {camera for camera, item in found.cameras.items() if not item.unchanged}


@pytest.mark.slow
def test_a_moved_camera_is_named_and_measured(
    four: tuple[Scene, KnownRig], rng: np.random.Generator
) -> None:
    scene, known = four
    for camera in scene.lenses:
        found = find_drift(known, _new(scene, rng, 3, moved={camera: _SHIFT}))
        assert found.changes[0] == ("place", camera)
        assert _said(found) == {camera}
        item = found.cameras[camera]
        assert item.moved is not None
        assert item.moved.cov is not None
        error = item.moved.motion - _SHIFT
        # chi-square of 6 degrees: 1 of 10,000 is beyond 27.9
        assert error @ np.linalg.solve(item.moved.cov, error) < 27.9
        assert item.moved.distance_m == pytest.approx(0.005, abs=5 * (item.moved.sigma_m or 0))
        assert not item.has_lens_changed


def test_one_picture_tells_which_camera_moved(
    four: tuple[Scene, KnownRig], rng: np.random.Generator
) -> None:
    """Though not always whether it moved or its lens did."""
    scene, known = four
    camera = list(scene.lenses)[2]
    found = find_drift(known, _new(scene, rng, 1, moved={camera: _SHIFT}))
    assert _said(found) == {camera}
    assert found.cameras[camera].has_moved


def test_a_camera_that_fell_is_named(
    four: tuple[Scene, KnownRig], rng: np.random.Generator
) -> None:
    """20 degrees and 300 mm are far from any linearisation."""
    scene, known = four
    camera = list(scene.lenses)[1]
    fall = np.array([0.1, 0.2, 0.25, 0.2, -0.2, 0.1])
    found = find_drift(known, _new(scene, rng, 2, moved={camera: fall}))
    assert found.changes == (("place", camera),)
    assert _said(found) == {camera}


def test_two_moved_cameras_of_four_are_named(
    four: tuple[Scene, KnownRig], rng: np.random.Generator
) -> None:
    scene, known = four
    first, _, third, _ = scene.lenses
    moved = {first: _SHIFT, third: -_SHIFT[::-1].copy() * [0.1, 0.1, 0.1, 1, 1, 1]}
    found = find_drift(known, _new(scene, rng, 3, moved=moved))
    assert {camera for _, camera in found.changes} == {first, third}


def test_a_zoomed_lens_is_named_and_measured(
    four: tuple[Scene, KnownRig], rng: np.random.Generator
) -> None:
    scene, known = four
    for camera in scene.lenses:
        found = find_drift(known, _new(scene, rng, 3, zoomed={camera: 1.01}))
        assert found.changes == (("lens", camera),)
        assert _said(found) == {camera}
        lens = found.cameras[camera].lens
        assert lens is not None
        assert abs(lens.values[0] - 0.01) < 4 * lens.sigma[0]
        assert lens.sigma[0] < 1e-3


@pytest.mark.slow
def test_a_lone_camera_knows_its_lens(rng: np.random.Generator) -> None:
    scene = stereo(0)
    known = _known(_solved(scene, 0), scene)
    alone = {"left": _new(scene, rng, 3, zoomed={"left": 1.01})["left"]}
    found = find_drift(known, alone)
    assert found.changes == (("lens", "left"),)
    assert found.cameras["left"].moved is None
    still = {"left": _new(scene, rng, 3)["left"]}
    assert find_drift(known, still).changes == ()


@pytest.mark.slow
def test_two_cameras_blame_each_other(rng: np.random.Generator) -> None:
    """With two there is no third to decide: both are named, each as the other's alternative."""
    scene = stereo(0)
    known = _known(_solved(scene, 0), scene)
    found = find_drift(known, _new(scene, rng, 3, moved={"right": _SHIFT}))
    assert _said(found) == {"left", "right"}
    assert ("place", "left") in found.cameras["right"].moved_or
    assert ("place", "right") in found.cameras["left"].moved_or
    assert found.cameras["left"].moved_chance == pytest.approx(
        found.cameras["right"].moved_chance, abs=1e-6
    )


@pytest.mark.slow
def test_another_lens_does_not_fit(rng: np.random.Generator) -> None:
    """Five times the noise is explained by no move."""
    scene = stereo(0)
    known = _known(_solved(scene, 0), scene)
    views = _new(scene, rng, 2)
    views["left"] = _new(scene, np.random.default_rng(1), 2, sigma_px=1.0)["left"]
    found = find_drift(known, {"left": views["left"]})
    assert not found.cameras["left"].fits
    assert found.cameras["left"].misfit == pytest.approx(5, rel=0.2)


@pytest.mark.slow
def test_false_alarms_are_as_frequent_as_stated() -> None:
    """A new calibration and new pictures for each draw, at a level that 60 draws can show."""
    scene = stereo(0)
    first = _solved(scene, 0)
    alarms, moved, lens = 0, [], []
    n_draws, level = 60, 0.1
    for draw in range(n_draws):
        rng = np.random.default_rng([6, draw])
        found = find_drift(
            _known(_solved(scene, draw, first), scene), _new(scene, rng, 2), false_alarm=level
        )
        alarms += bool(found.changes)
        moved.append(found.cameras["right"].moved_chance)
        lens += [item.lens_chance for item in found.cameras.values()]
    # Of 60 at a tenth: 6, sigma 2.3; the tests overlap (both cameras' places are one), so fewer.
    assert alarms <= 12
    # The chances themselves are uniform, K-S at 1 in 1000 (1.95); both lenses of a draw go together
    for chances, n in ((moved, n_draws), (lens, n_draws)):
        ordered = np.sort(np.array(chances, dtype=np.float64))
        gap = np.abs(ordered - (np.arange(len(ordered)) + 0.5) / len(ordered)).max()
        assert gap < 1.95 / np.sqrt(n)
    if not any(chance is not None and chance < 0.3 for chance in moved):
        pytest.fail("a test that never comes near an alarm has no power")

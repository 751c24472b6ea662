"""Balls followed through regions with known truth: identity, sizes of errors, hidden objects."""

from dataclasses import replace

import numpy as np
import pytest
from tracking_scenes import Balls, Observe, camera_covariance, disturbed, lissajous, observer, ring

from calichrome.core.arrays import FloatArray
from calichrome.rig import CameraCovariance, Rig
from calichrome.tracking import (
    AssociationSettings,
    RegionTable,
    Tracker,
    TrackingSettings,
    Trajectory,
    distance_bounds,
    extent_of,
    find_objects,
    light_levels,
    smooth_tracks,
    views_of,
)


@pytest.fixture(name="rig", scope="module")
def _rig() -> Rig:
    """Return a ring of six cameras."""
    return ring()


def _owner(item: Trajectory, balls: Balls, rig: Rig) -> int:
    """Ball that a track is at all its instants."""
    frames = [int(step.frame) for step in item.track.steps]
    world = rig.world_from_ref.apply(item.positions_ref)
    nearest = np.linalg.norm(balls.positions[frames] - world[:, None], axis=2).argmin(axis=1)
    (ball,) = set(nearest.tolist())  # or it was swapped
    return int(ball)


def _errors(item: Trajectory, balls: Balls, rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Of places and velocities, in ref."""
    frames = [int(step.frame) for step in item.track.steps]
    ball = _owner(item, balls, rig)
    ref_from_world = rig.world_from_ref.inverse()
    places = item.positions_ref - ref_from_world.apply(balls.positions[frames, ball])
    speeds = item.velocities_ref - balls.velocities[frames, ball] @ ref_from_world.rotation.T
    return places, speeds


@pytest.fixture(scope="module")
def calm() -> tuple[tuple[Trajectory, ...], Balls, Rig]:
    """Six balls, exact cameras, noise alone."""
    rng = np.random.default_rng(4)
    rig = ring()
    balls = lissajous(6, 60, rng)
    observe = observer(rig, balls, rng, noise_px=0.1)
    tracker = Tracker(rig)
    for frame in range(60):
        tracker.update(str(frame), float(balls.times_s[frame]), observe(frame))
    trajectories, sizes = smooth_tracks(tracker.tracks, tracker.views)
    # regions state 0.05 px, the noise is 0.1 px; no silhouette is biased
    assert sizes.noise == pytest.approx(2, rel=0.1)
    assert sizes.silhouette < 0.5
    return trajectories, balls, rig


def test_every_ball_has_one_track(calm: tuple[tuple[Trajectory, ...], Balls, Rig]) -> None:
    trajectories, balls, rig = calm
    assert sorted(_owner(item, balls, rig) for item in trajectories) == list(range(6))
    assert all(len(item.times_s) == 60 for item in trajectories)


def test_places_scatter_as_stated(calm: tuple[tuple[Trajectory, ...], Balls, Rig]) -> None:
    trajectories, balls, rig = calm
    squared, stated = [], []
    for item in trajectories:
        places, _ = _errors(item, balls, rig)
        squared.append((places**2).sum(axis=1))
        stated.append(np.trace(item.cov[:, :3, :3], axis1=1, axis2=2))
    # 360 places of which about every fifth is independent: 1 +- 0.2 if acceleration were white;
    # these paths are smoother than that, so the stated covariance is on the safe side
    assert 0.4 < np.mean(squared) / np.mean(stated) < 1.2


def test_speeds(calm: tuple[tuple[Trajectory, ...], Balls, Rig]) -> None:
    trajectories, balls, rig = calm
    error = np.concatenate([_errors(item, balls, rig)[1][5:] for item in trajectories])
    usual = np.sqrt((balls.velocities**2).sum(axis=2).mean())
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.05 * usual


@pytest.mark.slow
def test_bounds_of_distances_hold_over_calibrations() -> None:
    """Among all draws of the cameras' errors, noise and biases, 95 of 100 bounds are right."""
    held = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        rig = ring(5)
        covariance = camera_covariance(rig, focal_px=0.2, turn_rad=4e-5, shift_m=1e-4)
        balls = lissajous(5, 25, rng)
        observe = observer(rig, balls, rng, noise_px=0.1, bias_px=0.15)
        tracker = Tracker(disturbed(rig, covariance, rng), covariance)
        for frame in range(25):
            tracker.update(str(frame), float(balls.times_s[frame]), observe(frame))
        trajectories, _ = smooth_tracks(tracker.tracks, tracker.views, covariance)
        owners = [_owner(item, balls, rig) for item in trajectories]
        for i, first in enumerate(trajectories):
            for j, second in enumerate(trajectories[:i]):
                rows = {step.frame: k for k, step in enumerate(second.track.steps)}
                places = [
                    (k, rows[step.frame])
                    for k, step in enumerate(first.track.steps)
                    if step.frame in rows
                ]
                found = distance_bounds(first, second, places)
                frames = [int(first.track.steps[k].frame) for k, _ in places]
                apart = np.linalg.norm(
                    balls.positions[frames, owners[i]] - balls.positions[frames, owners[j]], axis=1
                )
                held.append(found.distance_m - 1.645 * found.sigma_m <= apart)
    # 60 pairs whose frames share one bias: 0.95 +- 0.03
    assert np.mean(np.concatenate(held)) == pytest.approx(0.95, abs=0.05)


@pytest.mark.parametrize(
    ("cameras", "n_lost"), [(("cam1",), 0), (("cam0", "cam1", "cam2", "cam3", "cam4", "cam5"), 1)]
)
def test_hidden_objects(cameras: tuple[str, ...], n_lost: int) -> None:
    """Hidden from one camera nothing is lost; hidden from all for a second, everything is."""
    rng = np.random.default_rng(7)
    rig = ring()
    balls = lissajous(2, 60, rng)
    observe = observer(
        rig,
        balls,
        rng,
        hidden=lambda frame, camera, ball: ball == 0 and camera in cameras and 20 <= frame < 50,
    )
    tracker = Tracker(rig, settings=TrackingSettings(max_gap_s=0.5))
    for frame in range(60):
        tracker.update(str(frame), float(balls.times_s[frame]), observe(frame))
    whole = [track for track in tracker.tracks if len(track.steps) == 60]
    assert len(whole) == 2 - n_lost
    assert len(tracker.tracks) == 2 + n_lost  # the lost one is found again, as another


def test_time_must_go_on(rig: Rig) -> None:
    tracker = Tracker(rig)
    tracker.update("0", 1.0, {})
    with pytest.raises(ValueError, match="not after"):
        tracker.update("1", 1.0, {})


def test_colour_tells_what_geometry_cannot() -> None:
    """Two cameras, two balls in one epipolar plane: four places are possible, colour leaves two."""
    rng = np.random.default_rng(3)
    rig = ring(2)
    centres = [
        rig.world_from_ref.apply(c.cam_from_ref.inverse().trans_m) for c in rig.cameras.values()
    ]
    middle = np.mean(centres, axis=0)
    towards = -middle / np.linalg.norm(middle)
    along = (centres[1] - centres[0]) / np.linalg.norm(centres[1] - centres[0])
    places = np.stack([-0.1 * along, 0.1 * along + 0.02 * towards])
    balls = Balls(
        times_s=np.zeros(1),
        positions=places[None],
        velocities=np.zeros((1, 2, 3)),
        radius_m=np.full(2, 0.03),
        xyz=np.array([[0.4, 0.3, 0.1], [0.12, 0.2, 0.4]]),
    )
    regions = observer(rig, balls, rng, noise_px=0.05)(0)
    views = views_of(rig, None)
    tables = {
        camera: RegionTable.of(views[camera], own, AssociationSettings())
        for camera, own in regions.items()
    }
    found = find_objects(tables, AssociationSettings())
    world = np.stack([rig.world_from_ref.apply(item.position_ref) for item in found])
    order = np.argsort(np.linalg.norm(world - places[0], axis=1))
    np.testing.assert_allclose(world[order], places, atol=2e-3)


def test_extent_of_a_ball(rig: Rig) -> None:
    rng = np.random.default_rng(5)
    balls = lissajous(1, 4, rng)
    observe = observer(rig, balls, rng, noise_px=0.0)
    tracker = Tracker(rig)
    for frame in range(4):
        tracker.update(str(frame), float(balls.times_s[frame]), observe(frame))
    (track,) = tracker.tracks
    step = track.steps[-1]
    sides = extent_of(step.state.position_m, step.sightings, tracker.views, rig.world_from_ref)
    # boxes of whole pixels about a ball of some 25 px
    np.testing.assert_allclose(sides, 2 * balls.radius_m[0], rtol=0.15)


def test_no_extent_from_one_view(rig: Rig) -> None:
    assert np.isnan(extent_of(np.zeros(3), {}, views_of(rig, None), rig.world_from_ref)).all()


def test_light_levels_are_found(rig: Rig) -> None:
    """One camera that sees everything a fifth brighter."""
    rng = np.random.default_rng(6)
    balls = lissajous(4, 30, rng)
    observe = observer(rig, balls, rng)
    tracker = Tracker(rig)
    for frame in range(30):
        seen = {
            camera: [
                replace(r, colour=None if r.colour is None else r.colour.in_light(1 / 1.2))
                if camera == "cam2"
                else r
                for r in own
            ]
            for camera, own in observe(frame).items()
        }
        tracker.update(str(frame), float(balls.times_s[frame]), seen)
    levels = light_levels(tracker.tracks)
    others = [levels[camera] for camera in levels if camera != "cam2"]
    assert levels["cam2"] / np.mean(others) == pytest.approx(1.2, rel=0.03)


def test_calibration_errors_count(rig: Rig) -> None:
    """Places are less sure where the cameras are, and by as much as their errors move them."""
    rng = np.random.default_rng(8)
    covariance = camera_covariance(rig, focal_px=1.0)
    balls = lissajous(1, 10, rng)
    observe = observer(rig, balls, rng)
    cov = [_last_cov(rig, known, balls, observe) for known in (None, covariance)]
    assert np.linalg.eigvalsh(cov[1] - cov[0]).min() > 0


def _last_cov(
    rig: Rig, covariance: CameraCovariance | None, balls: Balls, observe: Observe
) -> FloatArray:
    tracker = Tracker(rig, covariance)
    for frame in range(10):
        tracker.update(str(frame), float(balls.times_s[frame]), observe(frame))
    (item,), _ = smooth_tracks(tracker.tracks, tracker.views, covariance)
    return item.cov[-1, :3, :3]

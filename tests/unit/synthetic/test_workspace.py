"""The simulated workspace: paths, outlines, occlusion, shadows, what is written."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import Unreadable, open_recording
from calichrome.synthetic import Ambient, Light, Panel, Scene, SceneCamera, SceneError, SceneSensor
from calichrome.synthetic.workspace import (
    Ball,
    Box,
    HarmonicPath,
    Workspace,
    WorkspaceRenderer,
    large_board,
    read_workspace_truth,
    workspace_scene,
    write_workspace_recording,
)
from calichrome.synthetic.workspace.shadows import blocked_by_ball, seen_past_boxes

_SIZE_WH = (160, 120)
_LENS = BrownConrady(fx=150.0, fy=150.0, cx=79.5, cy=59.5, k1=0, k2=0, p1=0, p2=0, k3=0)
_LAMP = Light(
    spectrum="D65",
    power=4.0,
    centre_world=(0.0, -2.0, 1.5),
    axis_world=(0.0, 1.0, 0.0),
    radius_m=0.2,
)


def _still(x: float, y: float, z: float) -> HarmonicPath:
    zero = np.zeros(3)
    return HarmonicPath(
        centre_world=np.array([x, y, z]), amplitude_m=zero, rate_rad_s=zero, phase_rad=zero
    )


def _ball(x: float, y: float, z: float, radius_m: float = 0.1, reflectance: float = 0.8) -> Ball:
    return Ball(
        name="white",
        radius_m=radius_m,
        reflectance=np.full(81, reflectance),
        path=_still(x, y, z),
    )


def _workspace(*balls: Ball, boxes: tuple[Box, ...] = (), noise: bool = True) -> Workspace:
    """One camera in the origin that looks along z, a black wall at 3 m and a black floor."""
    black = np.full(81, 0.01)
    floor_from_panel = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    scene = Scene(
        target=large_board(),
        cameras=(
            SceneCamera(
                camera_id="cam0",
                size_wh=_SIZE_WH,
                lens=_LENS,
                cam_from_world=Pose.identity(),
                sensor=SceneSensor(sensitivity="Nikon 5100 (NPL)", noise=noise),
                flare=0.0,
                vignetting_power=0.0,
            ),
        ),
        world_from_board={},
        lights=(_LAMP,),
        ambients=(Ambient(spectrum="D65", irradiance=0.2),),
        panels=(
            Panel(
                world_from_panel=Pose(np.eye(3), np.array([0, 0, 3.0])),
                half_size_m=(9.0, 9.0),
                reflectance=black,
            ),
            Panel(
                world_from_panel=Pose(floor_from_panel, np.array([0, 0.8, 1.5])),
                half_size_m=(9.0, 3.0),
                reflectance=black,
            ),
        ),
    )
    return Workspace(
        scene=scene, boxes=boxes, balls=balls, floor_m=0.8, rate_hz=25, n_frames=2, n_background=2
    )


def _outline_centre_px(centre_cam: FloatArray, radius_m: float) -> FloatArray:
    """Centre of the ellipse in which the cone about a ball meets the image plane."""
    squared = centre_cam @ centre_cam
    direction = centre_cam / np.sqrt(squared)
    middle = direction[:2] * direction[2] / (direction[2] ** 2 - radius_m**2 / squared)
    return np.asarray(150.0 * middle + [79.5, 59.5])


def test_velocity_is_the_derivative_of_position(rng: np.random.Generator) -> None:
    path = HarmonicPath(
        centre_world=rng.normal(size=3),
        amplitude_m=rng.uniform(0, 1, 3),
        rate_rad_s=rng.uniform(0, 5, 3),
        phase_rad=rng.uniform(0, 6, 3),
    )
    times_s = np.linspace(0, 3, 40)
    step = 1e-6
    slope = (path.positions_world(times_s + step) - path.positions_world(times_s - step)) / 2 / step
    np.testing.assert_allclose(path.velocities_world(times_s), slope, atol=1e-7)
    long = path.velocities_world(np.linspace(0, 2000, 200_000))
    assert np.sqrt((long**2).sum(axis=1).mean()) == pytest.approx(path.rms_speed_m_s, rel=0.01)


@pytest.mark.parametrize("place", [(0.0, 0.0, 1.5), (0.35, -0.25, 1.2), (-0.3, 0.15, 1.0)])
def test_outline_is_the_ellipse_of_the_touching_cone(place: tuple[float, float, float]) -> None:
    black = _workspace(_ball(*place, radius_m=0.13, reflectance=0.0))
    # Without light on the ball its share of a pixel is what is missing of the wall's light.
    bright = replace(
        black,
        scene=replace(black.scene, lights=(), ambients=(Ambient(spectrum="D65", irradiance=1.0),)),
    )
    renderer = WorkspaceRenderer(bright)
    empty, _ = renderer.electrons("cam0", None)
    with_ball, seen = renderer.electrons("cam0", 0)
    cover = 1 - with_ball[..., 1] / empty[..., 1]
    y, x = np.mgrid[: _SIZE_WH[1], : _SIZE_WH[0]]
    centre = np.array([(x * cover).sum(), (y * cover).sum()]) / cover.sum()
    # 4 x 4 samples per pixel, the edge's ramp included
    np.testing.assert_allclose(centre, _outline_centre_px(np.array(place), 0.13), atol=0.01)
    assert seen[0] == pytest.approx(1, abs=0.005)


def test_nearer_things_hide_farther_ones() -> None:
    box = Box(
        world_from_box=Pose(np.eye(3), np.array([0.5, 0.4, 1.0])),
        half_size_m=(0.1, 0.4, 0.1),
        reflectance=np.full(81, 0.5),
    )
    near, far = _ball(0, 0, 1.0), _ball(0, 0, 1.6)
    behind, before = _ball(0.85, 0.35, 1.8), _ball(0.33, 0.2, 0.75, radius_m=0.05)
    renderer = WorkspaceRenderer(_workspace(near, far, behind, before, boxes=(box,)))
    _, seen = renderer.electrons("cam0", 0)
    np.testing.assert_allclose(seen, [1, 0, 0, 1], atol=0.01)


def test_half_hidden_ball_is_half_seen() -> None:
    # The same size in the picture, side by side by a radius: the nearer one covers 39.1 % of the
    # other (two circles of radius 1 at the distance 1 share 2 pi / 3 - sqrt(3) / 2 of pi).
    near, far = _ball(-0.05, 0, 1.0, 0.1), _ball(0.1, 0, 2.0, 0.2)
    _, seen = WorkspaceRenderer(_workspace(near, far)).electrons("cam0", 0)
    shared = (2 * np.pi / 3 - np.sqrt(3) / 2) / np.pi
    # Silhouettes of balls off the axis are a little wider than circles.
    assert seen[0] == pytest.approx(1, abs=0.01)
    assert seen[1] == pytest.approx(1 - shared, abs=0.01)


def test_ball_is_bright_where_the_lamp_is() -> None:
    electrons, _ = WorkspaceRenderer(_workspace(_ball(0, 0, 1.5, 0.3))).electrons("cam0", 0)
    column = electrons[36:84, 80, 1]  # the ball is 60 px high
    assert column[4] > 3 * column[-4]
    assert (np.diff(column[2:]) <= 0).all()


def test_shadow_of_a_ball_is_the_covered_share_of_the_lamp() -> None:
    lamp = np.array(_LAMP.centre_world)
    middle = np.array([0.0, 0.0, 1.5])
    below = np.array([[0.0, 2.0, 1.5], [0.0, 20.0, 1.5], [1.0, 2.0, 1.5], [0.0, -1.0, 1.5]])
    share = blocked_by_ball(_LAMP, below, middle, 0.05)
    # At equal distances the lamp's disc is half as large where the ball is: 0.05 of 0.1, squared.
    assert share[0] == pytest.approx(0.25)
    assert share[1] == pytest.approx((0.05 / (0.2 * 20 / 22)) ** 2)
    assert share[2] == share[3] == 0  # beside the cone, and between lamp and ball
    assert blocked_by_ball(_LAMP, below[:1], (lamp + below[0]) / 2, 0.2)[0] == pytest.approx(1)


def test_balls_darken_the_floor_under_the_lamp() -> None:
    renderer = WorkspaceRenderer(_workspace(_ball(0, 0.3, 2.2, 0.1)))
    empty, _ = renderer.electrons("cam0", None)
    lit, _ = renderer.electrons("cam0", 0)
    # The line from the lamp past the ball ends at z = 2.35 on the floor.
    row = round(59.5 + 150 * 0.8 / 2.35)
    assert lit[row, 80, 1] < 0.9 * empty[row, 80, 1]
    assert lit[row, 10, 1] == pytest.approx(empty[row, 10, 1])


def test_boxes_keep_the_lamp_from_what_is_behind_them() -> None:
    box = Box(
        world_from_box=Pose(np.eye(3), np.array([0, -1.0, 1.5])),
        half_size_m=(0.3, 0.05, 0.3),
        reflectance=np.full(81, 0.5),
    )
    points = np.array([[0.0, 0.0, 1.5], [2.0, 0.0, 1.5], [0.6, 0.0, 1.5], [0.0, -1.05, 1.5]])
    share = seen_past_boxes(_LAMP, points, (box,))
    assert share[0] == 0
    assert share[1] == share[3] == 1  # beside its shadow; on its upper face
    assert 0 < share[2] < 1  # penumbra
    np.testing.assert_array_equal(seen_past_boxes(_LAMP, points, ()), 1)


@pytest.fixture(scope="module")
def ready() -> Workspace:
    return workspace_scene(3, n_cameras=2, n_frames=100)


def test_balls_never_touch(ready: Workspace) -> None:
    times_s = np.linspace(0, ready.n_frames / ready.rate_hz, 1500)
    places = np.stack([ball.path.positions_world(times_s) for ball in ready.balls])
    radii = np.array([ball.radius_m for ball in ready.balls])
    assert len(radii) == 12
    for i, j in zip(*np.triu_indices(len(radii), 1), strict=True):
        assert np.linalg.norm(places[i] - places[j], axis=1).min() > radii[i] + radii[j]


def test_balls_move_as_fast_as_things_in_a_workspace(ready: Workspace) -> None:
    speeds = [ball.path.rms_speed_m_s for ball in ready.balls]
    assert min(speeds) >= 0.3
    assert max(speeds) <= 1.0


@pytest.mark.parametrize(("n_cameras", "n_balls", "n_frames"), [(1, 1, 1), (2, 17, 1), (2, 1, 0)])
def test_impossible_workspaces_are_refused(n_cameras: int, n_balls: int, n_frames: int) -> None:
    with pytest.raises(SceneError, match="needs 2 cameras or more"):
        workspace_scene(n_cameras=n_cameras, n_balls=n_balls, n_frames=n_frames)


def test_recording_says_what_a_user_would_know(tmp_path: Path) -> None:
    write_workspace_recording(_workspace(_ball(0, 0, 1.5)), tmp_path / "space")
    recording = open_recording(tmp_path / "space")
    assert dict(recording.files) == {
        "cam0": {name: tmp_path / "space/cam0" / f"{name}.png" for name in ("0000", "0001")}
    }
    with (tmp_path / "space/timestamps.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["camera"], row["frame"], float(row["time_s"])) for row in rows] == [
        ("cam0", "0000", 0.0),
        ("cam0", "0001", 0.04),
    ]
    first, second = (recording.read("cam0", name) for name in ("0000", "0001"))
    assert not isinstance(first, Unreadable)
    assert not isinstance(second, Unreadable)
    assert (first.pixels != second.pixels).any()  # the noise of each frame is its own
    assert (tmp_path / "space/cam0/background0001.png").is_file()


def test_truth_is_read_as_it_was_written(tmp_path: Path) -> None:
    space = _workspace(_ball(0.1, 0.2, 1.5))
    write_workspace_recording(space, tmp_path / "space", jpeg_quality=80)
    truth = read_workspace_truth(tmp_path / "space/truth.json")
    (ball,) = truth.balls
    np.testing.assert_array_equal(ball.positions_world, [[0.1, 0.2, 1.5]] * 2)
    np.testing.assert_array_equal(ball.velocities_world, 0)
    np.testing.assert_allclose(ball.xyz_d65, 0.8 * np.array([0.9505, 1, 1.0888]), atol=1e-3)
    np.testing.assert_allclose(ball.seen["cam0"], 1, atol=0.005)
    assert truth.frame_ids == space.frame_ids
    assert truth.cameras["cam0"].lens.as_dict() == _LENS.as_dict()
    (tmp_path / "space/truth.json").write_text('{"format": "calichrome.truth"}')
    with pytest.raises(FileFormatError, match="is no truth file"):
        read_workspace_truth(tmp_path / "space/truth.json")

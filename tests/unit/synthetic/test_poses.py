from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic import Scene, SceneError, hold_board, random_scene, truth_of
from calichrome.synthetic.poses import PoseRules
from calichrome.synthetic.visibility import (
    outline_board,
    project_visible,
    square_corners_board,
)
from calichrome.target import Target


def _eyes(scene: Scene) -> FloatArray:
    return np.array([camera.cam_from_world.inverse().trans_m for camera in scene.cameras])


def test_every_pose_is_seen_wholly_by_three_cameras(demo: Scene) -> None:
    truth = truth_of(demo)
    for frame_id in demo.world_from_board:
        assert sum(truth.images[camera, frame_id].whole for camera in truth.cameras) >= 3
    for camera_id in truth.cameras:
        assert len(truth.whole_views(camera_id)) >= 8


def test_some_boards_are_cut_off(demo: Scene) -> None:
    """Pictures of a real recording are not all good."""
    truth = truth_of(demo)
    assert not all(image.whole for image in truth.images.values())


def test_whole_means_all_paper_inside_with_large_squares(demo: Scene) -> None:
    truth = truth_of(demo)
    target = demo.target
    for (camera_id, frame_id), image in truth.images.items():
        if not image.whole:
            continue
        camera = demo.camera(camera_id)
        world_from_board = demo.world_from_board[frame_id]
        cam_from_board = camera.cam_from_world @ world_from_board
        edge = camera.lens.project(cam_from_board.apply(outline_board(target)))
        width, height = camera.size_wh
        assert edge.min() >= -0.5
        assert (edge <= [width - 0.5, height - 0.5]).all()
        corners = square_corners_board(target)
        grid = camera.lens.project(cam_from_board.apply(corners).reshape(-1, 3))
        grid = grid.reshape(corners.shape[0], corners.shape[1], 2)
        sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
        assert min(sides) >= 14


def test_poses_are_tilted_both_ways_turned_near_and_far(demo: Scene) -> None:
    eye = _eyes(demo).mean(axis=0)
    tilts, rolls, distances = [], [], []
    for world_from_board in demo.world_from_board.values():
        middle = world_from_board.apply(demo.target.corners_board.mean(axis=0))
        line = (middle - eye) / np.linalg.norm(middle - eye)
        # The board's normal in a level frame that looks along the line
        x = np.cross([0, 1.0, 0], line)
        x /= np.linalg.norm(x)
        normal = world_from_board.rotation[:, 2]
        tilts.append([normal @ x, normal @ np.cross(line, x)])
        rolls.append(np.arctan2(world_from_board.rotation[:, 0] @ np.cross(line, x), 1))
        distances.append(np.linalg.norm(middle - eye))
        angle = np.degrees(np.arccos(normal @ line))
        # The paper's middle, from which tilts are measured, is half a square off the corners'.
        assert 8 < angle < 42
    assert (np.min(tilts, axis=0) < -0.2).all()
    assert (np.max(tilts, axis=0) > 0.2).all()
    assert min(rolls) < -0.1
    assert max(rolls) > 0.1
    assert max(distances) / min(distances) > 1.5


def test_corners_fill_the_pictures(demo: Scene) -> None:
    """The corners of whole boards come into the outer quarter at all four sides."""
    truth = truth_of(demo)
    for camera_id, camera in truth.cameras.items():
        views = truth.whole_views(camera_id)
        points = np.concatenate([truth.images[camera_id, frame].corners_px for frame in views])
        share = points / camera.size_wh
        assert (share.min(axis=0) < 0.25).all()
        assert (share.max(axis=0) > 0.75).all()


def test_poses_follow_from_the_seed(target: Target) -> None:
    first, again, other = (random_scene(target, 1, 2, (480, 360), seed) for seed in (1, 1, 2))
    for frame_id, pose in first.world_from_board.items():
        np.testing.assert_array_equal(pose.trans_m, again.world_from_board[frame_id].trans_m)
        assert not np.allclose(pose.trans_m, other.world_from_board[frame_id].trans_m)


def test_board_too_fine_for_the_pictures_is_refused(pair: Scene, target: Target) -> None:
    rules = PoseRules(n_frames=3, min_square_px=200)
    with pytest.raises(SceneError, match="use larger pictures, fewer squares"):
        hold_board(target, pair.cameras, np.array([0, 0, 0.9]), rules, np.random.default_rng(0))


def test_cameras_that_see_too_little_are_named(pair: Scene, target: Target) -> None:
    turned = Pose.from_rotvec([0, np.pi, 0], [0, 0, 0])
    away = replace(
        pair.cameras[1], camera_id="away", cam_from_world=turned @ pair.cameras[1].cam_from_world
    )
    rules = PoseRules(n_frames=3, whole_cameras=1)
    centre = np.array([0, 0, 1.0])
    with pytest.raises(SceneError, match=r"fewer than 2 of 3 frames: (cam0|away) \(1\)"):
        hold_board(target, (pair.cameras[0], away), centre, rules, np.random.default_rng(0))


def test_points_beyond_the_fold_are_not_in_the_picture(pair: Scene) -> None:
    lens = BrownConrady(fx=560, fy=560, cx=319.5, cy=239.5, k1=-0.25)
    camera = replace(pair.cameras[0], lens=lens, cam_from_world=Pose.identity())
    point = np.array([[1.9, 0.0, 1.0]])  # x g(x) = 0.185: the lens equation puts it at 423 px
    assert 0 < lens.project(point)[0, 0] < 640
    assert np.isnan(project_visible(camera, point)).all()
    behind = np.array([[0.0, 0.0, -1.0]])
    assert np.isnan(project_visible(camera, behind)).all()

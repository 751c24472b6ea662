"""A synthetic rig that is recorded live gives what a written recording holds."""

import time

import numpy as np

from calichrome.synthetic import Renderer, Scene, SyntheticCamera, picture


def test_each_shot_shows_the_next_pose_to_every_camera(pair: Scene) -> None:
    renderer = Renderer(pair)
    cameras = {
        camera.camera_id: SyntheticCamera(renderer, camera.camera_id) for camera in pair.cameras
    }
    for frame in list(pair.world_from_board)[:2]:
        for camera_id, camera in cameras.items():
            for _ in range(3):  # frames that nobody retrieves pass by
                assert camera.grab()
            np.testing.assert_array_equal(camera.retrieve(), picture(renderer, camera_id, frame))


def test_cameras_of_a_scene_tick_together(pair: Scene) -> None:
    renderer = Renderer(pair)
    cameras = [SyntheticCamera(renderer, camera.camera_id) for camera in pair.cameras]
    assert all(item.locked for item in cameras[0].lock())
    began = time.monotonic()
    for _ in range(3):
        assert cameras[0].grab()
    assert time.monotonic() - began > 2 / 30
    cameras[0].release()

"""Boards rendered without noise, in even light: what is measured can be exact."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.imaging import Image
from calichrome.synthetic import Ambient, Renderer, Scene, exposed, random_scene, truth_of
from calichrome.target import Target

Rendered = Callable[..., tuple[Image, FloatArray, Scene]]
_SIZE_WH = (480, 360)


@pytest.fixture(scope="session")
def render() -> Rendered:
    """Return a picture of a target, its true corners, and the scene (camera cam0, frame 0)."""

    def picture(
        target: Target, *, turn_deg: float = 0, tilt_deg: float = 20, gain: float = 1.0
    ) -> tuple[Image, FloatArray, Scene]:
        scene = random_scene(target, 1, 1, _SIZE_WH, 2, noise=0, mosaic=False)
        camera = scene.cameras[0]
        centre = Pose(np.eye(3), target.corners_board.mean(axis=0))
        turned = Rotation.from_euler("zx", [turn_deg, tilt_deg], degrees=True).as_matrix()
        width_m = max(target.squares) * max(target.square_m)
        cam_from_centre = Pose(turned, np.array([0.01, -0.005, 1.55 * width_m]))
        world_from_board = camera.cam_from_world.inverse() @ cam_from_centre @ centre.inverse()
        ideal = replace(
            camera,
            sensor=replace(camera.sensor, adc_bits=None),
            vignetting_power=0.0,
            flare=0.0,
            white_balance=(1.0, 1.0, 1.0),
        )
        scene = exposed(
            replace(
                scene,
                cameras=(ideal,),
                world_from_board={"0": world_from_board},
                lights=(),
                ambients=(Ambient(spectrum="D65", irradiance=1.0),),
            )
        )
        camera = scene.cameras[0]
        electrons = Renderer(scene).electrons("cam0", "0")
        linear = gain * electrons / camera.sensor.full_well_e * camera.white_balance
        image = Image(pixels=np.clip(linear, 0, 1).astype(np.float32), encoding="linear", bits=32)
        return image, truth_of(scene).images["cam0", "0"].corners_px, scene

    return picture

"""Exposure and white balance, set once per camera for the whole recording."""

from dataclasses import replace

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.synthetic.scene import (
    Scene,
    SceneCamera,
    SceneError,
    cosine_vignetting,
    faces,
    irradiance,
)
from calichrome.synthetic.spectra import camera_response, printed_palette
from calichrome.synthetic.visibility import project_visible, square_corners_board

__all__ = ["exposed"]

_WHITE_LEVEL = 0.85  # of full scale, for the brightest white square of the recording
_DISC_LEVEL = 0.93  # of full scale, for the brightest disc: leaves room for its noise


def exposed(scene: Scene) -> Scene:
    """Return the scene with each camera's exposure and white balance set.

    The brightest white square in any frame comes to 85 % of full scale in its strongest channel,
    and no disc above 93 %. `SceneCamera.white_balance` is taken as the error of each channel about
    the gains that make a perfect diffuser neutral in the middle of the boards.

    Raises
    ------
    SceneError
        If a camera sees no lit board.
    """
    return replace(scene, cameras=tuple(_exposed(scene, camera) for camera in scene.cameras))


def _exposed(scene: Scene, camera: SceneCamera) -> SceneCamera:
    palette = printed_palette(scene.target, scene.palette_error_lab_sd, scene.seed)
    surfaces = np.concatenate([palette.white[None], palette.discs, np.ones((1, 81))])
    responses = camera_response(scene, camera.sensor.sensitivity, surfaces)
    white, discs, diffuser = responses[0], responses[1:-1], responses[-1]
    light = _light_in_picture(scene, camera)  # (n, n_sources)
    if not len(light) or light.sum() <= 0:
        raise SceneError(
            f"camera {camera.camera_id} sees no lit board in any frame; move it, the lights or "
            f"the boards"
        )
    neutral = np.median(light, axis=0) @ diffuser
    gains = np.array(camera.white_balance) * neutral[1] / neutral
    # The smallest gain is 1: the picture then clips before the sensor does.
    gains /= gains.min()
    white_peak = (light @ white * gains).max()
    disc_peak = max((float((light @ disc * gains).max()) for disc in discs), default=0.0)
    level = min(_WHITE_LEVEL / white_peak, _DISC_LEVEL / max(disc_peak, 1e-12))
    red, green, blue = (float(gain) for gain in gains)
    return replace(
        camera,
        exposure_e=float(camera.sensor.full_well_e * level),
        white_balance=(red, green, blue),
    )


def _light_in_picture(scene: Scene, camera: SceneCamera) -> FloatArray:
    """Light behind the lens at all points of all boards that are in the picture, by source."""
    points_board = square_corners_board(scene.target).reshape(-1, 3)
    parts = []
    for world_from_board in scene.world_from_board.values():
        if not faces(camera, world_from_board):
            continue
        points_world = world_from_board.apply(points_board)
        seen = np.isfinite(project_visible(camera, points_world)).all(axis=1)
        points_world = points_world[seen]
        rays_cam = camera.cam_from_world.apply(points_world)
        share = cosine_vignetting(camera, rays_cam / rays_cam[:, 2:])
        light = irradiance(scene, points_world, -world_from_board.rotation[:, 2])
        parts.append(light * share[:, None])
    return np.concatenate(parts) if parts else np.zeros((0, len(scene.spectra)))

"""Ready-made scenes: the rig of the paper's joint adjustment, and rigs of any number of cameras.

All lengths follow from the target: a rig looks at its board from where it fills about four tenths
of the picture's width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic.exposure import exposed
from calichrome.synthetic.poses import PoseRules, facing, hold_board
from calichrome.synthetic.render import sheet_bounds
from calichrome.synthetic.scene import (
    Ambient,
    Light,
    Panel,
    Scene,
    SceneCamera,
    SceneError,
    SceneSensor,
    image_rng,
)
from calichrome.synthetic.spectra import random_reflectance
from calichrome.target import Target

__all__ = [
    "SENSORS",
    "Mount",
    "demo_scene",
    "mounted_camera",
    "noisy_sensor",
    "random_scene",
]

SENSORS = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
"""Sensors with measured sensitivities in colour-science, in the order that rigs use them."""

STACKED = "Sigma SDMerill (NPL)"  # measures all three colours in each pixel: it has no mosaic

_FOCAL_SHARE = 0.88  # focal length over picture width: about 59 degrees across
_BOARD_SHARE = 0.42  # of the picture's width, at the middle of the workspace
_MIN_SQUARE_PX = 21.0  # there; nearer to the least size hardly a tilted board would do
_SPREAD_RAD = np.deg2rad(28)  # of the cameras about the workspace, to either side


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """One camera of a rig: how it sits, and what it is.

    `azimuth_rad` and `elevation_rad` are seen from the workspace, right and up; `distance` is a
    share of the rig's.
    """

    camera_id: str
    size_wh: tuple[int, int]
    sensor: SceneSensor
    azimuth_rad: float
    elevation_rad: float
    distance: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    encoding: Literal["srgb", "linear"] = "srgb"


def demo_scene(target: Target, seed: int = 0, *, n_frames: int = 12) -> Scene:
    """Return two stereo pairs of different sensors and a single camera around one workspace.

    Parameters
    ----------
    seed
        Of lenses, places, poses, surroundings and noise.
    n_frames
        Number of board poses.

    Raises
    ------
    SceneError
        If the board cannot be seen well enough.
    """
    nikon = SceneSensor(sensitivity=SENSORS[0])
    sigma = SceneSensor(sensitivity=STACKED, mosaic=False)
    sizes = {nikon: (640, 480), sigma: (720, 540)}
    mounts = [
        Mount(
            camera_id=camera_id,
            size_wh=sizes[sensor],
            sensor=sensor,
            azimuth_rad=np.deg2rad(azimuth_deg),
            elevation_rad=np.deg2rad(elevation_deg),
            distance=distance,
            white_balance=balance,
        )
        for camera_id, sensor, azimuth_deg, elevation_deg, distance, balance in (
            ("pair1-left", nikon, -26, 0, 1.0, (1.0, 1.0, 1.0)),
            ("pair1-right", nikon, -14, 1, 1.0, (1.0, 1.0, 1.0)),
            ("pair2-left", sigma, 11, 3, 1.08, (1.05, 1.0, 0.95)),
            ("pair2-right", sigma, 24, 3, 1.08, (1.05, 1.0, 0.95)),
        )
    ]
    single = Mount(
        camera_id="single",
        size_wh=(640, 512),
        sensor=nikon,
        azimuth_rad=np.deg2rad(-2),
        elevation_rad=np.deg2rad(24),
        distance=0.95,
        white_balance=(0.92, 1.0, 1.09),
        encoding="linear",
    )
    return _scene(target, [*mounts, single], n_frames, seed)


def random_scene(
    target: Target,
    n_cameras: int = 2,
    n_frames: int = 12,
    size_wh: tuple[int, int] = (640, 480),
    seed: int = 0,
    *,
    noise: float = 1.0,
    mosaic: bool = True,
    palette_error_lab_sd: float = 0.0,
) -> Scene:
    """Return cameras spread about one workspace, with the sensors of `SENSORS` in turn.

    Parameters
    ----------
    n_cameras, n_frames
        Number of cameras, named cam0, cam1 ..., and of board poses.
    size_wh : (2,) int, pixels
        Of every picture.
    seed
        Of lenses, places, poses, surroundings and noise.
    noise
        Standard deviation of shot and read noise, as a multiple of a good small camera's
        (14000 electrons full well, 6 electrons read noise); 0 for none.
    mosaic
        False measures all three colours in each pixel; a stacked sensor always does.
    palette_error_lab_sd
        Standard deviation of the printed colours about the target's, per Lab axis.

    Raises
    ------
    SceneError
        If the board cannot be seen well enough.
    """
    if n_cameras < 1 or n_frames < 1:
        raise SceneError(f"{n_cameras} cameras and {n_frames} frames: both must be at least 1")
    if min(size_wh) < 64:
        raise SceneError(f"pictures of {size_wh[0]}x{size_wh[1]} px are too small for any board")
    rng = image_rng(seed, "mounts")
    mounts = []
    for index in range(n_cameras):
        side = 0.0 if n_cameras == 1 else 2 * index / (n_cameras - 1) - 1
        spread = _SPREAD_RAD * min(1.0, 0.35 + 0.15 * n_cameras)
        mounts.append(
            Mount(
                camera_id=f"cam{index}",
                size_wh=size_wh,
                sensor=noisy_sensor(SENSORS[index % len(SENSORS)], noise, mosaic=mosaic),
                azimuth_rad=side * spread,
                elevation_rad=rng.uniform(-0.1, 0.25),
                distance=rng.uniform(0.95, 1.05),
                white_balance=(rng.uniform(0.92, 1.08), 1.0, rng.uniform(0.92, 1.08)),
            )
        )
    return _scene(target, mounts, n_frames, seed, palette_error_lab_sd)


def noisy_sensor(sensitivity: str, noise: float, *, mosaic: bool) -> SceneSensor:
    """Return a sensor with a multiple of a good small camera's noise, see `random_scene`."""
    mosaic = mosaic and sensitivity != STACKED
    if noise < 0:
        raise SceneError(f"noise={noise}: must be 0 (none) or more")
    standard = SceneSensor(sensitivity=sensitivity)
    if noise == 0:
        return replace(standard, mosaic=mosaic, noise=False)
    return replace(
        standard,
        mosaic=mosaic,
        # Shot noise in shares of full scale goes with one over the root of the full well.
        full_well_e=standard.full_well_e / noise**2,
        # In electrons, for the same share of full scale times `noise`.
        read_noise_e=standard.read_noise_e / noise,
    )


def _scene(
    target: Target,
    mounts: Sequence[Mount],
    n_frames: int,
    seed: int,
    palette_error_lab_sd: float = 0.0,
) -> Scene:
    u0, u1, _, _ = sheet_bounds(target)
    width_px = min(mount.size_wh[0] for mount in mounts)
    share = max(_BOARD_SHARE, _MIN_SQUARE_PX * (u1 - u0) / min(target.square_m) / width_px)
    distance_m = _FOCAL_SHARE * (u1 - u0) / share
    centre_world = np.array([0, 0, distance_m])
    cameras = tuple(
        mounted_camera(mount, centre_world, image_rng(seed, "camera", mount.camera_id))
        for mount in mounts
    )
    rules = PoseRules(n_frames=n_frames)
    poses = hold_board(target, cameras, centre_world, rules, image_rng(seed, "poses"))
    digits = max(3, len(str(n_frames - 1)))
    frames = [f"{index:0{digits}d}" for index in range(n_frames)]
    scene = Scene(
        target=target,
        cameras=cameras,
        world_from_board=dict(zip(frames, poses, strict=True)),
        lights=_lights(distance_m),
        ambients=(
            Ambient(spectrum="LED-B4", irradiance=0.12),
            Ambient(spectrum="D65", irradiance=0.05),
        ),
        panels=_surroundings(distance_m, image_rng(seed, "surroundings")),
        jpeg_frames=frozenset(frames[(n_frames + 1) // 2 :]),
        palette_error_lab_sd=palette_error_lab_sd,
        seed=seed,
    )
    return exposed(scene)


def mounted_camera(mount: Mount, centre_world: FloatArray, rng: np.random.Generator) -> SceneCamera:
    """Put a camera with a lens drawn from `rng` where its mount says, seen from the workspace."""
    width, height = mount.size_wh
    focal = _FOCAL_SHARE * width * rng.uniform(0.97, 1.03)
    lens = BrownConrady(
        fx=focal,
        fy=focal * rng.uniform(0.998, 1.002),
        cx=(width - 1) / 2 + rng.uniform(-0.02, 0.02) * width,
        cy=(height - 1) / 2 + rng.uniform(-0.02, 0.02) * width,
        k1=rng.uniform(-0.25, -0.1),
        k2=rng.uniform(0.04, 0.08),
        p1=rng.normal(0, 5e-4),
        p2=rng.normal(0, 5e-4),
        k3=rng.uniform(-0.01, 0),
    )
    distance_m = centre_world[2] * mount.distance
    azimuth, elevation = mount.azimuth_rad, mount.elevation_rad
    towards = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            -np.cos(azimuth) * np.cos(elevation),
        ]
    )
    eye_world = centre_world + distance_m * towards
    aim_world = centre_world + rng.uniform(-0.03, 0.03, 3) * distance_m
    roll = Rotation.from_rotvec([0, 0, rng.uniform(-0.06, 0.06)]).as_matrix()
    world_from_cam = Pose(facing(aim_world - eye_world) @ roll, eye_world)
    return SceneCamera(
        camera_id=mount.camera_id,
        size_wh=mount.size_wh,
        lens=lens,
        cam_from_world=world_from_cam.inverse(),
        sensor=mount.sensor,
        psf_sigma_px=rng.uniform(0.55, 0.75),
        vignetting_power=rng.uniform(1.2, 2.5),
        white_balance=mount.white_balance,
        encoding=mount.encoding,
        bits=8 if mount.encoding == "srgb" else 16,
    )


def _lights(distance_m: float) -> tuple[Light, ...]:
    """Return a strong warm panel above left and a weak cold one at the right, before the board."""
    d = distance_m
    main, side = np.array([-0.7, -0.8, -0.2]), np.array([1.0, -0.25, -0.1])
    centre = np.array([0, 0, 1.0])
    return tuple(
        Light(
            spectrum=spectrum,
            power=power * d**2,
            centre_world=(place[0] * d, place[1] * d, place[2] * d),
            axis_world=tuple(centre + aside - place),
        )
        for spectrum, power, place, aside in (
            ("LED-B4", 2.2, main, np.array([0.1, 0.0, 0.0])),
            ("D65", 0.6, side, np.array([0.0, 0.1, 0.0])),
        )
    )


def _surroundings(distance_m: float, rng: np.random.Generator) -> tuple[Panel, ...]:
    """Return a wall, a few sheets before it at several depths, and a row of books."""
    d = distance_m
    panels = [
        Panel(
            world_from_panel=Pose(np.eye(3), np.array([0, 0, 2.6 * d])),
            half_size_m=(12 * d, 12 * d),
            reflectance=0.25 + 0.5 * random_reflectance(rng),
            texture_contrast=0.06,
            texture_m=0.15 * d,
        )
    ]
    places = [
        (rng.uniform(-1.7, 1.7), rng.uniform(-1.0, 1.0), depth, *rng.uniform(0.1, 0.4, 2))
        for depth in np.linspace(2.5, 2.0, 10)
    ]
    shelf = rng.uniform(-0.9, 0.2)
    places += [(shelf + 0.09 * k, 0.75, 1.95, 0.042, rng.uniform(0.2, 0.3)) for k in range(9)]
    for x, y, z, half_width, half_height in places:
        turn = Rotation.from_rotvec(rng.normal(0, 0.12, 3)).as_matrix()
        panels.append(
            Panel(
                world_from_panel=Pose(turn, d * np.array([x, y, z])),
                half_size_m=(half_width * d, half_height * d),
                reflectance=random_reflectance(rng),
                texture_contrast=0.08,
                texture_m=0.05 * d,
            )
        )
    return tuple(panels)

"""A ready-made workspace: cameras in a ring around and above it, balls, boxes, two lamps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.colorimetry.reference import colour_fidelity_spectra
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.synthetic.exposure import exposed
from calichrome.synthetic.poses import PoseRules, hold_board
from calichrome.synthetic.scene import (
    Ambient,
    Light,
    Panel,
    Scene,
    SceneCamera,
    SceneError,
    image_rng,
)
from calichrome.synthetic.setups import SENSORS, Mount, mounted_camera, noisy_sensor
from calichrome.synthetic.spectra import random_reflectance
from calichrome.synthetic.workspace.scene import Ball, Box, HarmonicPath, Workspace
from calichrome.target import Target, colour_checker_palette, design_target

__all__ = ["large_board", "workspace_scene"]

_DISTANCE_M = 2.2  # of the cameras from the middle of the workspace
_MIDDLE_WORLD = np.array([0.0, 0.0, _DISTANCE_M])
_FLOOR_M = 0.85  # below the middle
_WALL_M = 4.0  # from the middle
_SIZES_WH = ((640, 480), (720, 540), (640, 480), (800, 600), (640, 512), (704, 528))
_MAX_STEP_RAD = np.deg2rad(60)  # between neighbours in the ring: both must see one board
_VIEWS_PER_PAIR = 6  # poses of the board that each two neighbours in the ring see wholly
_ELEVATION_RAD = np.deg2rad((20.0, 42.0))  # of every other camera

_REACH_M = (0.68, 0.42)  # of balls from the middle: aside and up or down
_GAP_M = 0.02  # between the surfaces of two balls
_TRIALS = 4000  # of a path, before the workspace is called full
_RADII_M = (0.035, 0.055)
_RMS_SPEEDS_M_S = (0.35, 0.9)

# Numbers of CIE 224:2017 for real surfaces of high chroma. Of the first twelve, four pairs are of
# nearly one hue: 5-7, 53-57, 10-12 and 76-81 are 6.6, 9.7, 10.0 and 15.0 dE2000 apart; two sensors
# that are only white-balanced differ by as much about one surface.
_SURFACES = (5, 29, 76, 10, 53, 98, 7, 42, 81, 12, 57, 25, 67, 87, 99, 22)


def large_board() -> Target:
    """Return a board of 10x9 squares of 80 mm with the 24 colours of the ColorChecker (A0)."""
    return design_target(squares=(10, 9), square_m=(0.08, 0.08), palette=colour_checker_palette())


def workspace_scene(
    seed: int = 0,
    *,
    target: Target | None = None,
    n_cameras: int = 6,
    n_balls: int = 12,
    n_frames: int = 200,
    rate_hz: float = 25.0,
    n_background: int = 20,
    size_wh: tuple[int, int] | None = None,
    noise: float = 1.0,
    palette_error_lab_sd: float = 0.0,
) -> Workspace:
    """Return a workspace of 1.4 m with balls of a few centimetres on paths that never touch.

    Parameters
    ----------
    seed
        Of lenses, places, paths, surroundings and noise.
    target
        Board for the calibration; default: `large_board`.
    n_cameras
        In the ring, with the sensors of `SENSORS` in turn.
    n_balls
        At most 16.
    n_frames, n_background
        Frames with the balls and of the empty workspace.
    rate_hz
        Frames per second.
    size_wh : (2,) int, pixels
        Of every picture; default: different from camera to camera.
    noise, palette_error_lab_sd
        As in `calichrome.synthetic.random_scene`.

    Raises
    ------
    SceneError
        If the numbers cannot be, or there is no room for so many balls.
    """
    if n_cameras < 2 or not 1 <= n_balls <= len(_SURFACES) or n_frames < 1 or rate_hz <= 0:
        raise SceneError(
            f"{n_cameras} cameras, {n_balls} balls, {n_frames} frames at {rate_hz:g} Hz: a "
            f"workspace needs 2 cameras or more, 1 to {len(_SURFACES)} balls, and frames"
        )
    cameras = _ring(seed, n_cameras, size_wh, noise)
    target = target or large_board()
    rules = PoseRules(
        n_frames=_VIEWS_PER_PAIR,
        distance=(0.6, 1.15),
        tilt_rad=(np.deg2rad(5), np.deg2rad(25)),
        min_square_px=12.0,
        whole_cameras=2,
        whole_views=_VIEWS_PER_PAIR,
    )
    neighbours = list(pairwise(cameras))
    if n_cameras * _MAX_STEP_RAD >= 2 * np.pi - 1e-9:
        neighbours.append((cameras[-1], cameras[0]))
    poses = [
        pose
        for index, pair in enumerate(neighbours)
        for pose in hold_board(
            target, pair, _MIDDLE_WORLD, rules, image_rng(seed, "poses", str(index))
        )
    ]
    scene = Scene(
        target=target,
        cameras=cameras,
        world_from_board={f"{index:03d}": pose for index, pose in enumerate(poses)},
        lights=_lamps(),
        ambients=(
            Ambient(spectrum="LED-B4", irradiance=0.22),
            Ambient(spectrum="D65", irradiance=0.10),
        ),
        panels=_room(image_rng(seed, "surroundings")),
        palette_error_lab_sd=palette_error_lab_sd,
        seed=seed,
    )
    workspace = Workspace(
        scene=exposed(scene),
        boxes=_boxes(cameras, image_rng(seed, "boxes")),
        balls=(),
        floor_m=_FLOOR_M,
        rate_hz=rate_hz,
        n_frames=n_frames,
        n_background=n_background,
    )
    return replace(workspace, balls=_balls(workspace, n_balls, image_rng(seed, "balls")))


def _ring(
    seed: int, n_cameras: int, size_wh: tuple[int, int] | None, noise: float
) -> tuple[SceneCamera, ...]:
    rng = image_rng(seed, "ring")
    step = min(_MAX_STEP_RAD, 2 * np.pi / n_cameras)
    cameras = []
    for index in range(n_cameras):
        sensitivity = SENSORS[index % len(SENSORS)]
        mount = Mount(
            camera_id=f"cam{index}",
            size_wh=size_wh or _SIZES_WH[index % len(_SIZES_WH)],
            sensor=noisy_sensor(sensitivity, noise * rng.uniform(0.8, 1.4), mosaic=True),
            azimuth_rad=index * step + rng.uniform(-0.06, 0.06),
            elevation_rad=_ELEVATION_RAD[index % 2] + rng.uniform(-0.06, 0.06),
            distance=rng.uniform(0.95, 1.08),
            white_balance=(rng.uniform(0.85, 1.15), 1.0, rng.uniform(0.85, 1.15)),
        )
        rng_camera = image_rng(seed, "camera", mount.camera_id)
        cameras.append(mounted_camera(mount, _MIDDLE_WORLD, rng_camera))
    return tuple(cameras)


def _lamps() -> tuple[Light, ...]:
    """Return a warm lamp above, off the middle, and the cold light of a window."""
    x, y, z = (float(value) for value in _MIDDLE_WORLD)
    return (
        Light(
            spectrum="LED-B4",
            power=7.5,
            centre_world=(x + 0.5, y - 2.8, z + 0.4),
            axis_world=(-0.1, 1.0, -0.1),
            radius_m=0.25,
        ),
        Light(
            spectrum="D65",
            power=5.0,
            centre_world=(x - 3.4, y - 0.9, z - 1.2),
            axis_world=(1.0, 0.25, 0.35),
            radius_m=0.6,
        ),
    )


def _room(rng: np.random.Generator) -> tuple[Panel, ...]:
    """Return the floor, four walls, sheets that lie about and sheets on the walls."""
    x, y, z = _MIDDLE_WORLD
    height = 2.5 + _FLOOR_M
    panels = [
        _panel(
            (x, y + _FLOOR_M, z),
            (0, 1, 0),
            (_WALL_M, _WALL_M),
            0.2 + 0.4 * random_reflectance(rng),
            0.10,
        )
    ]
    for dx, dz in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        centre = (x + dx * _WALL_M, y + _FLOOR_M - height / 2, z + dz * _WALL_M)
        colour = 0.3 + 0.45 * random_reflectance(rng)
        panels.append(_panel(centre, (dx, 0, dz), (_WALL_M, height / 2), colour, 0.06))
        for _ in range(3):
            aside, up = rng.uniform(-1.8, 1.8), rng.uniform(0.3, 1.6)
            place = (
                x + dx * (_WALL_M - 0.02) - dz * aside,
                y + _FLOOR_M - up,
                z + dz * (_WALL_M - 0.02) + dx * aside,
            )
            half = tuple(rng.uniform(0.15, 0.5, 2))
            panels.append(_panel(place, (dx, 0, dz), half, random_reflectance(rng), 0.08))
    for layer in range(14):
        aside, away = rng.uniform(-1.7, 1.7, 2)
        place = (x + aside, y + _FLOOR_M - 0.001 * (layer + 1), z + away)
        half = tuple(rng.uniform(0.06, 0.35, 2))
        turn = rng.uniform(-np.pi, np.pi)
        panels.append(_panel(place, (0, 1, 0), half, random_reflectance(rng), 0.08, turn))
    return tuple(panels)


def _panel(
    centre_world: tuple[float, float, float],
    z_world: tuple[float, float, float],
    half_size_m: tuple[float, ...],
    reflectance: FloatArray,
    contrast: float,
    turn_rad: float = 0.0,
) -> Panel:
    z = np.array(z_world, dtype=np.float64)
    x = np.array([1.0, 0, 0]) if z[1] else np.cross([0.0, 1.0, 0.0], z)
    basis = np.column_stack([x, np.cross(z, x), z])
    turn = Rotation.from_rotvec([0, 0, turn_rad]).as_matrix()
    return Panel(
        world_from_panel=Pose(basis @ turn, np.array(centre_world)),
        half_size_m=(half_size_m[0], half_size_m[1]),
        reflectance=reflectance,
        texture_contrast=contrast,
        texture_m=0.12,
    )


def _boxes(cameras: tuple[SceneCamera, ...], rng: np.random.Generator) -> tuple[Box, ...]:
    """Return a post before the first camera, one before the third, and a crate on the floor.

    They stand outside the reach of the balls, 0.9 to 1.1 m from the middle.
    """
    boxes = []
    for camera, half, height in (
        (cameras[0], 0.05, 1.35),
        (cameras[2 % len(cameras)], 0.06, 1.2),
        (None, 0.18, 0.3),
    ):
        if camera is None:
            angle = rng.uniform(-np.pi, np.pi)
        else:
            towards = camera.cam_from_world.inverse().trans_m - _MIDDLE_WORLD
            angle = np.arctan2(towards[0], towards[2]) + rng.uniform(-0.2, 0.2)
        radius = rng.uniform(0.95, 1.1)
        centre = _MIDDLE_WORLD + np.array(
            [radius * np.sin(angle), _FLOOR_M - height / 2, radius * np.cos(angle)]
        )
        boxes.append(
            Box(
                world_from_box=Pose.from_rotvec([0, rng.uniform(0, np.pi / 2), 0], centre),
                half_size_m=(half, height / 2, half),
                reflectance=random_reflectance(rng),
            )
        )
    return tuple(boxes)


def _balls(workspace: Workspace, n_balls: int, rng: np.random.Generator) -> tuple[Ball, ...]:
    """Draw paths one after the other and keep those that stay clear of all before."""
    spectra = colour_fidelity_spectra()
    # Between two frames a ball moves by 6 cm at most; four times finer nothing slips through.
    times_s = np.arange(4 * workspace.n_frames) / (4 * workspace.rate_hz)
    balls: list[Ball] = []
    taken = np.empty((0, len(times_s), 3))
    for surface in _SURFACES[:n_balls]:
        radius_m = float(rng.uniform(*_RADII_M))
        radii = np.array([ball.radius_m for ball in balls])
        for _ in range(_TRIALS):
            path = _path(rng)
            places = path.positions_world(times_s)
            apart = np.linalg.norm(taken - places, axis=-1).min(axis=1, initial=np.inf)
            if _within_reach(places) and (apart > radii + radius_m + _GAP_M).all():
                break
        else:
            raise SceneError(f"no room for ball {len(balls) + 1} of {n_balls}; ask for fewer")
        taken = np.concatenate([taken, places[None]])
        balls.append(
            Ball(
                name=f"CES {surface}",
                radius_m=radius_m,
                reflectance=spectra[surface - 1],
                path=path,
            )
        )
    return tuple(balls)


def _within_reach(places_world: FloatArray) -> bool:
    x, y, z = (places_world - _MIDDLE_WORLD).T
    return bool((np.hypot(x, z) <= _REACH_M[0]).all() and (np.abs(y) <= _REACH_M[1]).all())


def _path(rng: np.random.Generator) -> HarmonicPath:
    """Draw a circle, a Lissajous figure, an arc like a pendulum's, or a crossing."""
    kind = rng.integers(4)
    heading = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(heading), 0, np.sin(heading)])
    phase = rng.uniform(0, 2 * np.pi)
    if kind == 0:
        size = rng.uniform(0.15, 0.55)
        amplitude = size * np.array([1, rng.uniform(0, 0.5), 1])
        ratio = np.ones(3)
        phases = phase + np.array([0, rng.uniform(0, 2 * np.pi), rng.choice([-1, 1]) * np.pi / 2])
    elif kind == 1:
        amplitude = rng.uniform(0.15, 0.5, 3) * [1, 0.6, 1]
        ratio = rng.permutation([1.0, 1.5, 2.0])
        phases = rng.uniform(0, 2 * np.pi, 3)
    elif kind == 2:
        amplitude = rng.uniform(0.3, 0.6) * along + [0, rng.uniform(0.05, 0.2), 0]
        # Twice as fast in height: lowest in the middle, highest at both ends.
        ratio = np.array([1.0, 2.0, 1.0])
        phases = phase + np.array([0, phase + np.pi / 2, 0])
    else:
        amplitude = rng.uniform(0.5, 0.65) * along + [0, rng.uniform(0.0, 0.3), 0]
        ratio, phases = np.ones(3), np.full(3, phase)
    speed = rng.uniform(*_RMS_SPEEDS_M_S)
    rate = speed / np.sqrt(((amplitude * ratio) ** 2).sum() / 2)
    centre = _MIDDLE_WORLD + rng.uniform(-1, 1, 3) * [_REACH_M[0], _REACH_M[1], _REACH_M[0]]
    return HarmonicPath(
        centre_world=centre, amplitude_m=amplitude, rate_rad_s=rate * ratio, phase_rad=phases
    )

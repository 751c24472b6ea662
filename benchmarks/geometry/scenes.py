"""The scenes that are measured, and how boards are held before cameras.

A scene is drawn from a seed and stays; noise is drawn for it again and again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from benchmarks.geometry.rigs import BOARD, SIGMA_PX, SIZE_WH, Scene, bare_scene, whole_views
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.target import Target

__all__ = [
    "SIGMA_PX",
    "Propose",
    "Scene",
    "board_turn",
    "converging",
    "hold",
    "in_reference",
    "looking",
    "mono",
    "placed",
    "ring",
    "stereo",
]

MAX_TILT_RAD = np.radians(40)
_CANDIDATES = 12  # poses of which the one that covers most of what is still blank is taken
_CELLS = (16, 12)


def board_turn(rng: np.random.Generator, max_tilt_rad: float, max_roll_rad: float) -> Rotation:
    """Return a turn of a board that faces the camera: a roll, then a tilt in any direction."""
    direction = rng.uniform(0, 2 * np.pi)
    tilt = rng.uniform(0, max_tilt_rad)
    roll = rng.uniform(-max_roll_rad, max_roll_rad)
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    return Rotation.from_rotvec(tilt * axis) * Rotation.from_rotvec([0, 0, roll])


Propose = Callable[[int], tuple[Pose, Sequence[str]]]
"""Draws ref_from_board of a frame, given its number, and names the cameras that shall see it."""


def hold(bare: Scene, propose: Propose, n_frames: int, *, candidates: int = _CANDIDATES) -> Scene:
    """Hold the board where the pictures are still blank, like one who has done it before.

    Parameters
    ----------
    bare
        A scene without boards.
    propose
        Its poses are taken only if the whole board is inside the pictures of its cameras.
    """
    blank = {camera: np.ones(_CELLS, dtype=bool) for camera in bare.lenses}
    boards: dict[str, Pose] = {}
    seen: dict[str, list[str]] = {camera: [] for camera in bare.lenses}
    for index in range(n_frames):
        best: tuple[int, Pose, dict[str, FloatArray]] | None = None
        n_inside = n_tried = 0
        while n_inside < candidates and n_tried < 100_000:
            n_tried += 1
            ref_from_board, cameras = propose(index)
            pixels = whole_views(bare, ref_from_board, cameras)
            if pixels is None:
                continue
            n_inside += 1
            new = sum(
                int((blank[camera] & _touched(at, bare.size_wh)).sum())
                for camera, at in pixels.items()
            )
            if best is None or new > best[0]:
                best = new, ref_from_board, pixels
        if best is None:
            raise ValueError("no board fits into the pictures of these cameras")
        frame = f"{index:03d}"
        boards[frame] = best[1]
        for camera, at in best[2].items():
            seen[camera].append(frame)
            blank[camera] &= ~_touched(at, bare.size_wh)
            if not blank[camera].any():
                blank[camera] = np.ones(_CELLS, dtype=bool)
    return replace(
        bare,
        ref_from_boards=boards,
        seen={camera: tuple(frames) for camera, frames in seen.items()},
    )


def _touched(pixels: FloatArray, size_wh: tuple[int, int]) -> BoolArray:
    touched = np.zeros(_CELLS, dtype=bool)
    column, row = (pixels / np.array(size_wh) * np.array(_CELLS)).astype(int).T
    touched[column, row] = True
    return touched


def _lens(rng: np.random.Generator) -> BrownConrady:
    """Draw a lens of 65 degrees."""
    focal = 1000 * rng.uniform(0.97, 1.03)
    cx, cy = (np.array(SIZE_WH) - 1) / 2 + rng.uniform(-15, 15, 2)
    return BrownConrady(
        fx=focal,
        fy=focal * rng.uniform(0.998, 1.002),
        cx=cx,
        cy=cy,
        k1=-0.25 * rng.uniform(0.9, 1.1),
        k2=0.12 * rng.uniform(0.9, 1.1),
        k3=-0.03 * rng.uniform(0.9, 1.1),
        p1=rng.uniform(-5e-4, 5e-4),
        p2=rng.uniform(-5e-4, 5e-4),
    )


def _before_camera(
    rng: np.random.Generator, scene: Scene, camera: str, fill: tuple[float, float]
) -> Pose:
    """Draw cam_from_board whose middle lies anywhere in the picture.

    Parameters
    ----------
    fill
        Width of the board over width of the picture, if it faced the camera.
    """
    lens = scene.lenses[camera]
    turn = board_turn(rng, MAX_TILT_RAD, np.radians(20)).as_matrix()
    middle = scene.target.corners_board.mean(axis=0)
    width_m = np.ptp(scene.target.corners_board[:, 0])
    depth = lens.fx * width_m / (rng.uniform(*fill) * scene.size_wh[0])
    pixel = rng.uniform(0, 1, 2) * scene.size_wh
    ray = lens.unproject(pixel[None])[0]
    return Pose(turn, depth * np.nan_to_num(ray, nan=1e3) - turn @ middle)


def mono(seed: int, n_frames: int = 40) -> Scene:
    """One camera; the board fills 30-70 % of the width."""
    rng = np.random.default_rng([seed, 1])
    bare = bare_scene({"cam0": Pose.identity()}, {"cam0": _lens(rng)})
    return hold(
        bare, lambda _: (_before_camera(rng, bare, "cam0", (0.3, 0.7)), ("cam0",)), n_frames
    )


def stereo(seed: int, n_frames: int = 40) -> Scene:
    """Two cameras 150 mm apart that see every board."""
    rng = np.random.default_rng([seed, 2])
    right_from_left = Pose.from_rotvec([0.01, -0.12, 0.015], [-0.15, 0.002, 0.01])
    cameras = {"left": Pose.identity(), "right": right_from_left}
    bare = bare_scene(cameras, {camera: _lens(rng) for camera in cameras})
    both = ("left", "right")
    return hold(bare, lambda _: (_before_camera(rng, bare, "left", (0.25, 0.6)), both), n_frames)


def looking(position_m: FloatArray, at_m: FloatArray) -> Pose:
    """Return cam_from_world of a camera whose picture is upright, y of the world being down."""
    forward = (at_m - position_m) / np.linalg.norm(at_m - position_m)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Pose(rotation, -rotation @ position_m)


def _on_arc(
    azimuths_rad: Sequence[float], heights_m: Sequence[float], radius_m: float
) -> dict[str, Pose]:
    """Return cams_from_world of cameras around the origin that look at it."""
    cameras = {}
    for index, (azimuth, height) in enumerate(zip(azimuths_rad, heights_m, strict=True)):
        position = np.array([radius_m * np.sin(azimuth), height, -radius_m * np.cos(azimuth)])
        cameras[f"cam{index}"] = looking(position, np.zeros(3))
    return cameras


def in_reference(cams_from_world: Mapping[str, Pose]) -> tuple[dict[str, Pose], Pose]:
    """Return cams_from_ref of the first camera, and ref_from_world."""
    ref_from_world = next(iter(cams_from_world.values()))
    world_from_ref = ref_from_world.inverse()
    cams = {camera: pose @ world_from_ref for camera, pose in cams_from_world.items()}
    cams[next(iter(cams))] = Pose.identity()
    return cams, ref_from_world


def ring(seed: int, n_frames: int = 80) -> Scene:
    """Cameras around a table, 45 degrees apart; each board is seen by two neighbours."""
    rng = np.random.default_rng([seed, 3])
    n_cameras = 8
    azimuths = [2 * np.pi * index / n_cameras for index in range(n_cameras)]
    heights = rng.uniform(-0.15, 0.05, n_cameras).tolist()
    cams_from_ref, ref_from_world = in_reference(_on_arc(azimuths, heights, 0.8))
    names = list(cams_from_ref)
    bare = bare_scene(cams_from_ref, {camera: _lens(rng) for camera in names})

    def propose(index: int) -> tuple[Pose, Sequence[str]]:
        first = index * n_cameras // n_frames
        middle_rad = azimuths[first] + np.pi / n_cameras
        turn = Rotation.from_rotvec([0, -middle_rad, 0])
        facing = turn * board_turn(rng, np.radians(20), np.radians(20))
        place = rng.uniform(-1, 1, 3) * [0.3, 0.2, 0.3]
        pair = names[first], names[(first + 1) % n_cameras]
        return placed(ref_from_world, facing, place), pair

    return hold(bare, propose, n_frames)


def placed(
    ref_from_world: Pose, facing: Rotation, middle_world: FloatArray, target: Target = BOARD
) -> Pose:
    """Return ref_from_board of a board turned by `facing` about its middle."""
    rotation = facing.as_matrix()
    middle = target.corners_board.mean(axis=0)
    return ref_from_world @ Pose(rotation, middle_world - rotation @ middle)


def converging(seed: int, n_frames: int = 40) -> Scene:
    """Four cameras 2 m from where they look; every board is seen by all."""
    rng = np.random.default_rng([seed, 4])
    azimuths = np.radians([-36, -12, 12, 36]).tolist()
    heights = [-0.35, 0.1, -0.15, 0.25]
    cams_from_ref, ref_from_world = in_reference(_on_arc(azimuths, heights, 1.95))
    names = list(cams_from_ref)
    bare = bare_scene(cams_from_ref, {camera: _lens(rng) for camera in names})

    def propose(_: int) -> tuple[Pose, Sequence[str]]:
        facing = board_turn(rng, np.radians(35), np.radians(20))
        place = rng.uniform(-1, 1, 3) * [0.8, 0.6, 0.8]
        return placed(ref_from_world, facing, place), names

    return hold(bare, propose, n_frames)

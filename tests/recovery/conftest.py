"""Corners as known rigs see them: projected, and moved by Gaussian noise. No pictures."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.adjustment import Scene
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import BoardView, Dataset
from calichrome.target import Target, chessboard

_SIZE_WH = (640, 480)
_DISTANCE_M = 0.65


@pytest.fixture(scope="session")
def board() -> Target:
    """9x6 corners of 30 mm: turned by half it is another board."""
    return chessboard((9, 6), (0.03, 0.03))


@pytest.fixture(scope="session")
def make_rig() -> Callable[[Target, int, int], Scene]:
    """Return a function (target, n_cameras, n_boards) -> rig; every camera sees every board."""
    return _make_rig


@pytest.fixture(scope="session")
def observe() -> Callable[[Scene, Target, float, np.random.Generator], Dataset]:
    """Return a function (rig, target, sigma_px, rng) -> dataset; cameras a, b; frames 00, 01."""
    return _observe


def _looking_at(position: FloatArray, point: FloatArray) -> Pose:
    z_axis = (point - position) / np.linalg.norm(point - position)
    x_axis = np.cross([0.0, 1.0, 0.0], z_axis)
    x_axis /= np.linalg.norm(x_axis)
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return Pose(rotation, -rotation @ position)


def _make_rig(target: Target, n_cameras: int, n_boards: int) -> Scene:
    rng = np.random.default_rng(1998)
    middle = np.array([0.0, 0.0, _DISTANCE_M])
    cams_from_ref = [Pose.identity()] + [
        _looking_at(np.array([0.4 * index / (n_cameras - 1), 0.02 * index, 0.01]), middle)
        for index in range(1, n_cameras)
    ]
    lenses = [
        BrownConrady(
            fx=600.0 + 10 * index, fy=602.0 + 9 * index, cx=322.0 + index, cy=238.0 - index,
            k1=-0.2 + 0.02 * index, k2=0.08, p1=1e-3, p2=-5e-4, k3=-0.01,
        )
        for index in range(n_cameras)
    ]  # fmt: skip
    boards: list[Pose] = []
    while len(boards) < n_boards:
        azimuth = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0.2, 0.6) * np.array([np.cos(azimuth), np.sin(azimuth), 0])
        turn = Rotation.from_rotvec(tilt) * Rotation.from_euler("z", rng.uniform(-0.5, 0.5))
        rotation = turn.as_matrix()
        centre = middle + rng.uniform(-1, 1, 3) * [0.15, 0.1, 0.15]
        ref_from_board = Pose(rotation, centre - rotation @ target.corners_board.mean(axis=0))
        corners_ref = ref_from_board.apply(target.corners_board)
        pixels = np.concatenate(
            [
                lens.project(cam_from_ref.apply(corners_ref))
                for lens, cam_from_ref in zip(lenses, cams_from_ref, strict=True)
            ]
        )
        if ((pixels >= 0) & (pixels <= np.array(_SIZE_WH) - 1)).all():
            boards.append(ref_from_board)
    return Scene(tuple(lenses), tuple(cams_from_ref), tuple(boards))


def _observe(scene: Scene, target: Target, sigma_px: float, rng: np.random.Generator) -> Dataset:
    views: dict[str, dict[str, BoardView]] = {}
    for index, (lens, cam_from_ref) in enumerate(
        zip(scene.lenses, scene.cams_from_ref, strict=True)
    ):
        views["abcdef"[index]] = {
            f"{frame:02}": BoardView(
                corner_ids=np.arange(target.n_corners),
                corners_px=lens.project((cam_from_ref @ pose).apply(target.corners_board))
                + rng.normal(0, sigma_px, (target.n_corners, 2)),
                half_turn_ambiguous=not target.has_unique_orientation,
            )
            for frame, pose in enumerate(scene.ref_from_boards)
        }
    return Dataset(sizes_wh=dict.fromkeys(views, _SIZE_WH), views=views)

"""Board poses that a person would hold: drawn at random, kept if they are of use.

Candidates are aimed at all parts of all pictures, near and far, tilted and turned; of those that
enough cameras see wholly the ones are taken that fill the pictures best.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.synthetic.render import sheet_bounds
from calichrome.synthetic.scene import SceneCamera, SceneError
from calichrome.synthetic.visibility import (
    all_inside,
    outline_board,
    project_visible,
    smallest_square_px,
    square_corners_board,
)
from calichrome.target import Target

__all__ = ["PoseRules", "facing", "hold_board"]

_BATCH = 200
_MAX_BATCHES = 100
_HOPELESS_BATCHES = 8  # without a single candidate
_CANDIDATES_PER_FRAME = 40
_CELLS_XY = (6, 5)  # of a picture, for counting how much of it the corners fill
_VIEW_BONUS = 12.0  # cells that a whole view is worth to a camera that lacks views
_VARIETY_BONUS = 8.0  # cells that a new tilt or distance is worth


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseRules:
    """What makes a set of poses useful.

    Parameters
    ----------
    n_frames
        Number of poses.
    distance : (2,) float
        Nearest and farthest, as shares of the distance at which the cameras' axes meet.
    tilt_rad, roll_rad
        Smallest and largest angle between the board's normal and the line from the rig; largest
        turn of the board in its plane.
    border_px
        Free space between the paper and the edge of a picture that sees it wholly.
    min_square_px
        Shortest side of a square in any picture that sees the whole board.
    whole_cameras
        Cameras that must see the whole board; all, if there are fewer.
    whole_views
        Whole boards that each camera must see; two thirds of the frames, if there are fewer.
    """

    n_frames: int = 12
    distance: tuple[float, float] = (0.62, 1.45)
    tilt_rad: tuple[float, float] = (np.deg2rad(10), np.deg2rad(40))
    roll_rad: float = np.deg2rad(25)
    border_px: float = 3.0
    min_square_px: float = 14.0
    whole_cameras: int = 3
    whole_views: int = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Poses that keep the rules for one frame.

    `whole` (n, n_cameras); `cells` (n, n_cameras, cells): which cells corners fall into;
    `traits` (n, 4): tilt about two axes, log distance, roll, scaled to about -1..1.
    """

    poses: tuple[Pose, ...]
    whole: BoolArray
    cells: BoolArray
    traits: FloatArray

    @classmethod
    def joined(cls, parts: Sequence["_Candidates"]) -> "_Candidates":
        return cls(
            tuple(pose for part in parts for pose in part.poses),
            np.concatenate([part.whole for part in parts]),
            np.concatenate([part.cells for part in parts]),
            np.concatenate([part.traits for part in parts]),
        )


def hold_board(
    target: Target,
    cameras: Sequence[SceneCamera],
    centre_world: FloatArray,
    rules: PoseRules,
    rng: np.random.Generator,
) -> tuple[Pose, ...]:
    """Choose `world_from_board` for each frame.

    Parameters
    ----------
    centre_world : (3,) float, metres
        Middle of the workspace.

    Raises
    ------
    SceneError
        If these cameras cannot see this board as often and as large as the rules say.
    """
    n_frames = rules.n_frames
    wanted = _CANDIDATES_PER_FRAME * n_frames
    parts: list[_Candidates] = []
    for batch in range(_MAX_BATCHES):
        parts.append(_draw(target, cameras, centre_world, rng, rules))
        found = sum(len(part.poses) for part in parts)
        if found >= wanted or (found == 0 and batch >= _HOPELESS_BATCHES):
            break
    candidates = _Candidates.joined(parts)
    if len(candidates.poses) < n_frames:
        raise SceneError(
            f"only {len(candidates.poses)} of {_BATCH * len(parts)} board poses are seen wholly "
            f"by {min(rules.whole_cameras, len(cameras))} cameras with squares of "
            f"{rules.min_square_px:g} px; use larger pictures, fewer squares or cameras that look "
            f"at the same place"
        )
    needed = min(rules.whole_views, max(1, 2 * n_frames // 3))
    chosen = _choose(candidates, n_frames, needed)
    views = candidates.whole[chosen].sum(axis=0)
    if views.min() < needed:
        short = ", ".join(
            f"{camera.camera_id} ({count})"
            for camera, count in zip(cameras, views, strict=True)
            if count < needed
        )
        raise SceneError(
            f"some cameras see the whole board in fewer than {needed} of {n_frames} frames: "
            f"{short}; add frames, or let the cameras look at the same place"
        )
    # Chosen greedily, the most useful come first: a person does not sort.
    return tuple(candidates.poses[index] for index in rng.permutation(chosen))


def _draw(
    target: Target,
    cameras: Sequence[SceneCamera],
    centre_world: FloatArray,
    rng: np.random.Generator,
    rules: PoseRules,
) -> _Candidates:
    """Draw one batch and keep the poses that obey the rules for single frames."""
    # Aimed at the pictures' corners more often than at their middle: whole boards cannot get far
    # out, so most of these are rejected.
    aims = (
        0.5
        + 0.45 * np.sign(rng.uniform(-1, 1, (_BATCH, 2))) * rng.uniform(0, 1, (_BATCH, 2)) ** 0.7
    )
    chosen = rng.integers(len(cameras), size=_BATCH)
    nearest, farthest = rules.distance
    distance = nearest * (farthest / nearest) ** rng.uniform(0, 1, _BATCH)
    tilt, about = rng.uniform(*rules.tilt_rad, _BATCH), rng.uniform(0, 2 * np.pi, _BATCH)
    roll = rng.uniform(-rules.roll_rad, rules.roll_rad, _BATCH)

    eyes = np.array([camera.cam_from_world.inverse().trans_m for camera in cameras])
    middles_world = np.empty((_BATCH, 3))
    for index, camera in enumerate(cameras):
        mine = chosen == index
        rays_cam = camera.lens.unproject(aims[mine] * np.array(camera.size_wh))
        depth_m = distance[mine, None] * np.linalg.norm(centre_world - eyes[index])
        middles_world[mine] = camera.cam_from_world.inverse().apply(rays_cam * depth_m)
    zero = np.zeros(_BATCH)
    direction = np.stack([np.cos(about), np.sin(about), zero], axis=-1)
    turns = (
        Rotation.from_matrix(facing(middles_world - eyes.mean(axis=0)))
        * Rotation.from_rotvec(tilt[:, None] * direction)
        * Rotation.from_rotvec(np.stack([zero, zero, roll], axis=-1))
    ).as_matrix()
    u0, u1, v0, v1 = sheet_bounds(target)
    origins_world = middles_world - turns @ np.array([(u0 + u1) / 2, (v0 + v1) / 2, 0])
    tilts = (tilt / rules.tilt_rad[1])[:, None] * direction[:, :2]
    traits = np.column_stack([tilts, 2 * np.log(distance), roll / rules.roll_rad / 2])

    whole, cells, large = _seen(target, cameras, turns, origins_world, rules)
    keep = large & (whole.sum(axis=1) >= min(rules.whole_cameras, len(cameras)))
    poses = [Pose(turns[index], origins_world[index]) for index in np.flatnonzero(keep)]
    return _Candidates(tuple(poses), whole[keep], cells[keep], traits[keep])


def _seen(
    target: Target,
    cameras: Sequence[SceneCamera],
    turns: FloatArray,
    origins_world: FloatArray,
    rules: PoseRules,
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Return whole (n, n_cameras), cells (n, n_cameras, n_cells), squares large enough (n,)."""
    grid_board = square_corners_board(target)
    turned = grid_board.reshape(-1, 3) @ turns.swapaxes(1, 2) + origins_world[:, None]
    grids_world = turned.reshape(len(turns), *grid_board.shape)
    outlines_world = outline_board(target) @ turns.swapaxes(1, 2) + origins_world[:, None]
    n_cells = _CELLS_XY[0] * _CELLS_XY[1]
    whole = np.zeros((len(turns), len(cameras)), dtype=bool)
    cells = np.zeros((len(turns), len(cameras), n_cells), dtype=bool)
    large = np.ones(len(turns), dtype=bool)
    for column, camera in enumerate(cameras):
        whole[:, column] = all_inside(project_visible(camera, outlines_world, rules.border_px))
        grids_px = project_visible(camera, grids_world)
        small = smallest_square_px(grids_px) < rules.min_square_px  # nan, not whole: not small
        large &= ~(small & whole[:, column])
        inner = grids_px[:, 1:-1, 1:-1].reshape(len(turns), -1, 2)
        rows, points = np.nonzero(np.isfinite(inner[..., 0]))
        cell = ((inner[rows, points] + 0.5) / camera.size_wh * _CELLS_XY).astype(int)
        cell = np.clip(cell, 0, np.array(_CELLS_XY) - 1)
        cells[rows, column, cell[:, 1] * _CELLS_XY[0] + cell[:, 0]] = True
    return whole, cells & whole[..., None], large


def _choose(candidates: _Candidates, n_frames: int, needed: int) -> list[int]:
    """Take one after the other the candidate that adds most."""
    filled = np.zeros(candidates.cells.shape[1:], dtype=bool)
    views = np.zeros(candidates.whole.shape[1], dtype=int)
    chosen: list[int] = []
    for frame in range(n_frames):
        gain = (candidates.cells & ~filled).sum(axis=(1, 2)).astype(float)
        # A camera that must see every remaining frame outweighs one that has time.
        urgency = np.clip((needed - views) / (n_frames - frame), 0, 1)
        gain += _VIEW_BONUS * (candidates.whole * (urgency + urgency**8 * 10)).sum(axis=1)
        if chosen:
            apart = candidates.traits[:, None] - candidates.traits[chosen]
            gain += _VARIETY_BONUS * np.linalg.norm(apart, axis=-1).min(axis=1)
            gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        filled |= candidates.cells[best]
        views += candidates.whole[best]
    return chosen


def facing(directions: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) with z along `directions` (..., 3) and a level x."""
    z = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)

"""Problems of five sizes with a known truth: cameras around a volume in which a board is shown."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from benchmarks.solver.exchange import Geometry, Problem
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.geometry.lenses import BrownConrady

__all__ = ["SPECS", "Spec", "make_problem"]

_SIZE_WH = (1920, 1200)
_SQUARE_M = 0.03
_FOCAL_PX = 1300.0
_LENS = (_FOCAL_PX, _FOCAL_PX, 959.5, 599.5, -0.25, 0.12, 0.0, 0.0, -0.03)
_LENS_SPREAD = (8.0, 8.0, 8.0, 8.0, 0.01, 0.01, 3e-4, 3e-4, 0.005)
_BOARD_SHARE = 0.45  # of the width of the image, when the board faces the camera at its centre
_TILT_DEG = (8.0, 40.0)
_ROLL_DEG = 30.0
_CENTRE_SHARE = ((0.3, 0.7), (0.35, 0.65))  # of the image: where the board's centre is shown
_DEPTH = (0.9, 1.15)  # times the distance of the pivot
_MAX_VIEW_DEG = 60.0  # between the board's normal and the axis of a camera that still reads it
_MARGIN_PX = 5.0
_SIGMA_PX = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """Size of a problem.

    Parameters
    ----------
    n_views
        Board views of all cameras together: as many as are hidden from view are left out.
    spacing_deg
        Between neighbours on the circle around the volume.
    """

    n_cameras: int
    n_frames: int
    corners_xy: tuple[int, int]
    n_views: int
    spacing_deg: float

    def with_frames(self, n_frames: int) -> "Spec":
        """Return the same rig with more or fewer frames, the views per frame being kept."""
        n_views = round(self.n_views * n_frames / self.n_frames)
        return replace(self, n_frames=n_frames, n_views=n_views)


SPECS: Mapping[str, Spec] = MappingProxyType(
    {
        "small": Spec(n_cameras=1, n_frames=20, corners_xy=(8, 7), n_views=20, spacing_deg=0),
        "stereo": Spec(n_cameras=2, n_frames=30, corners_xy=(8, 7), n_views=60, spacing_deg=15),
        "rig": Spec(n_cameras=8, n_frames=150, corners_xy=(11, 8), n_views=903, spacing_deg=8),
        "large": Spec(
            n_cameras=32, n_frames=500, corners_xy=(11, 8), n_views=3495, spacing_deg=360 / 32
        ),
        "huge": Spec(
            n_cameras=64, n_frames=2000, corners_xy=(15, 10), n_views=15281, spacing_deg=360 / 64
        ),
    }
)
"""Numbers of cameras, frames, corners and views: those of the prototype's measurements."""


def make_problem(spec: Spec, seed: int = 1) -> Problem:
    """Draw a problem; the same seed gives the same one."""
    rng = np.random.default_rng(seed)
    nx, ny = spec.corners_xy
    board_m = np.zeros((nx * ny, 3))
    board_m[:, 0] = np.tile(np.arange(nx), ny) * _SQUARE_M
    board_m[:, 1] = np.repeat(np.arange(ny), nx) * _SQUARE_M
    pivot_m = _FOCAL_PX * (nx - 1) * _SQUARE_M / (_BOARD_SHARE * _SIZE_WH[0])
    rig = _draw_cameras(spec, pivot_m, rng)
    truth, seen = _draw_frames(spec, rig, board_m, pivot_m, rng)
    frame_index, camera_index = np.nonzero(_hide(seen, spec.n_views, rng))
    pixels = np.empty((spec.n_views, len(board_m), 2))
    for camera in range(spec.n_cameras):
        views = np.nonzero(camera_index == camera)[0]
        pixels[views] = _pixels(truth, camera, frame_index[views], board_m)
    pixels += rng.normal(0.0, _SIGMA_PX, pixels.shape)
    return Problem(
        corners_xy=np.array(spec.corners_xy),
        board_m=board_m,
        camera_index=camera_index,
        frame_index=frame_index,
        pixels=pixels,
        sigma_px=np.array(_SIGMA_PX),
        size_wh=np.array(_SIZE_WH),
        truth=truth,
        start=_start(truth, board_m, pivot_m, rng),
    )


def _draw_cameras(spec: Spec, pivot_m: float, rng: np.random.Generator) -> Geometry:
    """Draw lenses, and cameras on a circle around the pivot, `pivot_m` before each of them."""
    n = spec.n_cameras
    euler_deg = rng.normal(0.0, 2.0, (n, 3))
    euler_deg[:, 0] += spec.spacing_deg * np.arange(n)
    euler_deg[0] = 0.0
    rotation = Rotation.from_euler("yxz", euler_deg, degrees=True).as_matrix()
    pivot = np.array([0.0, 0.0, pivot_m])
    trans_m = pivot - rotation @ pivot
    trans_m[1:] += rng.normal(0.0, 0.02 * pivot_m, (n - 1, 3))
    lens = np.array(_LENS) + np.array(_LENS_SPREAD) * rng.normal(size=(n, 9))
    return Geometry(lens, rotation, trans_m, np.empty((0, 3, 3)), np.empty((0, 3)))


def _draw_frames(
    spec: Spec, rig: Geometry, board_m: FloatArray, pivot_m: float, rng: np.random.Generator
) -> tuple[Geometry, BoolArray]:
    """Show the board to one camera after the other; return the poses and who sees them, (F, C).

    A frame that too few cameras see whole to reach the wanted number of views is drawn again.
    """
    enough = -(-spec.n_views // spec.n_frames)
    rotation, trans_m = np.empty((0, 3, 3)), np.empty((0, 3))
    seen = np.empty((0, spec.n_cameras), dtype=bool)
    while len(seen) < spec.n_frames:
        shown_to = np.arange(2 * spec.n_frames) % spec.n_cameras
        drawn = _draw_poses(rig, shown_to, board_m, pivot_m, rng)
        sees = np.stack([_sees(drawn, camera, board_m) for camera in range(spec.n_cameras)], axis=1)
        good = sees.sum(axis=1) >= enough
        rotation = np.concatenate([rotation, drawn.ref_from_board_rotation[good]])
        trans_m = np.concatenate([trans_m, drawn.ref_from_board_m[good]])
        seen = np.concatenate([seen, sees[good]])
    n = spec.n_frames
    truth = replace(rig, ref_from_board_rotation=rotation[:n], ref_from_board_m=trans_m[:n])
    return truth, seen[:n]


def _draw_poses(
    rig: Geometry,
    shown_to: IntArray,
    board_m: FloatArray,
    pivot_m: float,
    rng: np.random.Generator,
) -> Geometry:
    """Draw a tilted board in the picture of the camera that each frame is shown to."""
    n = len(shown_to)
    axis_rad = rng.uniform(0.0, 2 * np.pi, n)
    axis = np.stack([np.cos(axis_rad), np.sin(axis_rad), np.zeros(n)], axis=1)
    tilt = Rotation.from_rotvec(np.radians(rng.uniform(*_TILT_DEG, n))[:, None] * axis)
    roll = Rotation.from_euler("z", rng.uniform(-_ROLL_DEG, _ROLL_DEG, (n, 1)), degrees=True)
    rotation = (tilt * roll).as_matrix()
    share = np.stack([rng.uniform(*limits, n) for limits in _CENTRE_SHARE], axis=1)
    plane = (share - 0.5) * _SIZE_WH / _FOCAL_PX
    depth_m = pivot_m * rng.uniform(*_DEPTH, n)
    centre_cam = np.concatenate([plane, np.ones((n, 1))], axis=1) * depth_m[:, None]
    trans_m = centre_cam - rotation @ board_m.mean(axis=0)
    back = rig.cam_from_ref_rotation[shown_to].transpose(0, 2, 1)
    offset_m = trans_m - rig.cam_from_ref_m[shown_to]
    return replace(
        rig,
        ref_from_board_rotation=back @ rotation,
        ref_from_board_m=np.einsum("nij,nj->ni", back, offset_m),
    )


def _sees(geometry: Geometry, camera: int, board_m: FloatArray) -> BoolArray:
    """Tell in which frames the camera sees the whole board, and not too obliquely, (F,)."""
    turned = geometry.cam_from_ref_rotation[camera] @ geometry.ref_from_board_rotation
    seen = turned[:, 2, 2] > np.cos(np.radians(_MAX_VIEW_DEG))
    facing = np.nonzero(seen)[0]
    pixels = _pixels(geometry, camera, facing, board_m)
    inside = (pixels > _MARGIN_PX) & (pixels < np.array(_SIZE_WH) - 1 - _MARGIN_PX)
    seen[facing] = inside.all(axis=(1, 2))
    return np.asarray(seen)


def _pixels(geometry: Geometry, camera: int, frames: IntArray, board_m: FloatArray) -> FloatArray:
    """Project the board of some frames, (F, N, 2); nan behind the camera and beyond the fold."""
    rotation, trans_m = geometry.ref_from_board_rotation[frames], geometry.ref_from_board_m[frames]
    points_ref = board_m @ rotation.transpose(0, 2, 1) + trans_m[:, None]
    turn = geometry.cam_from_ref_rotation[camera]
    points_cam = points_ref @ turn.T + geometry.cam_from_ref_m[camera]
    lens = BrownConrady.from_parameters(geometry.lens[camera])
    return np.where(lens.sees(points_cam)[..., None], lens.project(points_cam), np.nan)


def _hide(seen: BoolArray, n_views: int, rng: np.random.Generator) -> BoolArray:
    """Leave `n_views` of the views that are possible, one of each frame at least, (F, C)."""
    chance = np.where(seen, rng.uniform(size=seen.shape), np.inf)
    chance[np.arange(len(seen)), chance.argmin(axis=1)] = 0.0
    return np.asarray(chance <= np.sort(chance, axis=None)[n_views - 1])


def _start(
    truth: Geometry, board_m: FloatArray, pivot_m: float, rng: np.random.Generator
) -> Geometry:
    """Start off the truth by 3 % (focal length), 1 deg (cameras), 2 deg (boards) and 2 % of depth.

    Cameras turn about their own centre of projection, boards about their middle.
    """
    n_cameras, n_frames = len(truth.lens), len(truth.ref_from_board_m)
    lens = np.zeros_like(truth.lens)
    lens[:, :2] = truth.lens[:, :2] * (1 + 0.03 * rng.choice([-1, 1], (n_cameras, 1)))
    lens[:, 2:4] = (np.array(_SIZE_WH) - 1) / 2
    turn = Rotation.from_rotvec(np.radians(1.0) * _directions(n_cameras, rng)).as_matrix()
    step_m = 0.02 * pivot_m * _directions(n_cameras, rng)
    turn[0], step_m[0] = np.eye(3), 0.0
    middle_m = board_m.mean(axis=0)
    tilt = Rotation.from_rotvec(np.radians(2.0) * _directions(n_frames, rng)).as_matrix()
    board_rotation = tilt @ truth.ref_from_board_rotation
    board_step_m = 0.02 * pivot_m * _directions(n_frames, rng)
    middle_shift_m = (truth.ref_from_board_rotation - board_rotation) @ middle_m
    return Geometry(
        lens=lens,
        cam_from_ref_rotation=turn @ truth.cam_from_ref_rotation,
        cam_from_ref_m=np.einsum("nij,nj->ni", turn, truth.cam_from_ref_m) + step_m,
        ref_from_board_rotation=board_rotation,
        ref_from_board_m=truth.ref_from_board_m + middle_shift_m + board_step_m,
    )


def _directions(n: int, rng: np.random.Generator) -> FloatArray:
    """Draw unit vectors, (N, 3)."""
    vectors = rng.normal(size=(n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

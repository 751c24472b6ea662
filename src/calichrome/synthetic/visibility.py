"""What a camera sees of a board: points inside the picture, whole boards, size of the squares."""

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.synthetic.render import sheet_bounds
from calichrome.synthetic.scene import Scene, SceneCamera, faces
from calichrome.target import Target

__all__ = ["outline_board", "project_visible", "sees_whole", "square_corners_board"]

_STEPS_PER_EDGE = 12  # a distorted edge bows outwards between the corners of the paper


def outline_board(target: Target) -> FloatArray:
    """Points along the edge of the paper, (n, 3), metres."""
    u0, u1, v0, v1 = sheet_bounds(target)
    corners = np.array([[u0, v0, 0], [u1, v0, 0], [u1, v1, 0], [u0, v1, 0]])
    share = np.linspace(0, 1, _STEPS_PER_EDGE, endpoint=False)[:, None]
    edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    return np.concatenate(edges)


def square_corners_board(target: Target) -> FloatArray:
    """All points where squares begin or end, (squares_y + 1, squares_x + 1, 3), metres."""
    x = (np.arange(target.squares[0] + 1) - 1) * target.square_m[0]
    y = (np.arange(target.squares[1] + 1) - 1) * target.square_m[1]
    u, v = np.meshgrid(x, y)
    return np.stack([u, v, np.zeros_like(u)], axis=-1)


def project_visible(
    camera: SceneCamera, points_world: FloatArray, border_px: float = 0.0
) -> FloatArray:
    """Project points (..., 3), metres, to pixels (..., 2); nan where the picture ends.

    Points behind the camera or beyond the fold of its distortion are not in the picture, though
    the lens equation may put them there.
    """
    width, height = camera.size_wh
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    reach = np.linalg.norm(camera.lens.unproject(corners)[:, :2], axis=1).max()
    points_cam = camera.cam_from_world.apply(points_world).reshape(-1, 3)
    depth = np.where(points_cam[:, 2] > 0, points_cam[:, 2], np.nan)
    near_axis = np.linalg.norm(points_cam[:, :2], axis=1) / depth <= reach
    pixels = camera.lens.project(points_cam)
    least = border_px - 0.5  # pixels end half a pixel beyond their centres
    inside = (pixels >= least) & (pixels <= np.array(camera.size_wh) - 1 - least)
    seen = near_axis & inside.all(axis=1)
    return np.where(seen[:, None], pixels, np.nan).reshape(*points_world.shape[:-1], 2)


def sees_whole(scene: Scene, camera: SceneCamera, world_from_board: Pose) -> bool:
    """Whether all of the paper is in the picture, printed side in front."""
    if not faces(camera, world_from_board):
        return False
    outline = project_visible(camera, world_from_board.apply(outline_board(scene.target)))
    return bool(np.isfinite(outline).all())


def smallest_square_px(grid_px: FloatArray) -> FloatArray:
    """Shortest side of any square, from `square_corners_board` projected, (..., ny, nx, 2)."""
    across = np.linalg.norm(np.diff(grid_px, axis=-2), axis=-1).min(axis=(-2, -1))
    down = np.linalg.norm(np.diff(grid_px, axis=-3), axis=-1).min(axis=(-2, -1))
    return np.asarray(np.minimum(across, down))


def all_inside(points_px: FloatArray) -> BoolArray:
    """Whether all points (..., n, 2) of each set are in the picture, (...)."""
    return np.asarray(np.isfinite(points_px).all(axis=(-2, -1)))

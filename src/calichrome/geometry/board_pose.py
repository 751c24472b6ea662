"""One board, seen by one camera or by several whose places are known."""

from collections.abc import Mapping

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.homography import fit_homography
from calichrome.core.pose import Pose
from calichrome.geometry.adjustment import (
    Adjustment,
    Free,
    PlanarView,
    Scene,
    Sightings,
    adjust,
)
from calichrome.geometry.lenses import BrownConrady

__all__ = ["pose_from_homography", "solve_board_pose", "start_board_pose"]


def pose_from_homography(homography: FloatArray) -> Pose:
    """Return cam_from_board of a plane whose normalised image is ``homography @ (X, Y, 1)``.

    References
    ----------
    .. [1] Z. Zhang, "A Flexible New Technique for Camera Calibration", IEEE PAMI 22 (11), 2000,
       section 3.1 and appendix C (nearest rotation).
    """
    scale = 2 / (np.linalg.norm(homography[:, 0]) + np.linalg.norm(homography[:, 1]))
    if homography[2, 2] < 0:
        scale = -scale  # the board lies before the camera
    first, second, trans_m = (scale * homography).T
    u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return Pose(rotation, trans_m)


def start_board_pose(view: PlanarView, lens: BrownConrady) -> Pose:
    """Closed-form cam_from_board of one view; corners without a ray are left out.

    The homography is fitted about the middle of the board, where it is best known.
    """
    rays = lens.unproject(view.pixels)
    seen = np.isfinite(rays).all(axis=1)
    middle = view.points_board[:, :2].mean(axis=0)
    homography = fit_homography(view.points_board[seen, :2] - middle, rays[seen, :2])
    pose = pose_from_homography(homography)
    return Pose(pose.rotation, pose.trans_m - pose.rotation[:, :2] @ middle)


def solve_board_pose(
    views: Mapping[str, PlanarView],
    lenses: Mapping[str, BrownConrady],
    cams_from_ref: Mapping[str, Pose],
) -> Adjustment:
    """Least-squares ref_from_board of one frame from all cameras that see it.

    Parameters
    ----------
    views, lenses, cams_from_ref
        By camera id; `views` holds the cameras that see the board.
    """
    cameras = list(views)
    sightings = Sightings.collect([(index, 0, views[cam]) for index, cam in enumerate(cameras)])

    def scene(ref_from_board: Pose) -> Scene:
        return Scene(
            tuple(lenses[camera] for camera in cameras),
            tuple(cams_from_ref[camera] for camera in cameras),
            (ref_from_board,),
        )

    free = Free.only_boards(len(cameras))
    starts = [
        cams_from_ref[camera].inverse() @ start_board_pose(views[camera], lenses[camera])
        for camera in cameras
    ]
    solved: list[Adjustment] = []
    for start in starts:  # the view of one camera alone may suggest the mirrored pose
        try:
            solved.append(adjust(sightings, scene(start), free))
        except ValueError:  # this start puts the board behind another camera
            continue
    if not solved:
        raise ValueError("board pose: every start lies behind a camera")
    return min(solved, key=lambda item: item.variance)

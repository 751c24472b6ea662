"""Two cameras turned by calculation until their rows (or columns) correspond."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady

__all__ = ["Rectification", "rectify_pair"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectification:
    """R1, R2, P1, P2 and Q as OpenCV's ``stereoRectify`` defines them.

    Parameters
    ----------
    rotation_a, rotation_b : (3, 3) float
        rect_from_cam of each camera.
    projection_a, projection_b : (3, 4) float
        Pinholes of the rectified cameras in the frame of the first; metres.
    disparity_to_depth : (4, 4) float
        Q: (x, y, disparity, 1) to homogeneous points of the first rectified camera, metres.
    size_wh
        Of both rectified pictures.
    vertical
        True if the cameras stand above each other: columns correspond instead of rows.
    """

    rotation_a: FloatArray
    rotation_b: FloatArray
    projection_a: FloatArray
    projection_b: FloatArray
    disparity_to_depth: FloatArray
    size_wh: tuple[int, int]
    vertical: bool

    @property
    def matrix(self) -> FloatArray:
        """The pinhole matrix that both rectified cameras share, (3, 3)."""
        return self.projection_a[:, :3]


def rectify_pair(
    lens_a: BrownConrady,
    lens_b: BrownConrady,
    b_from_a: Pose,
    size_a_wh: tuple[int, int],
    size_b_wh: tuple[int, int],
) -> Rectification:
    """Turn both cameras by half of their relative rotation, then onto their baseline.

    Both get one pinhole: the mean focal length, a size that holds both pictures, and a principal
    point that keeps the middle of both pictures as near to the middle as one point can.

    References
    ----------
    .. [1] J.-Y. Bouguet, "Camera Calibration Toolbox for Matlab", stereo rectification (least
       distortion by halving the rotation); conventions of R, P, Q as in OpenCV.
    """
    half = Rotation.from_rotvec(-0.5 * b_from_a.rotvec_rad).as_matrix()
    baseline = half @ b_from_a.trans_m
    vertical = bool(abs(baseline[1]) > abs(baseline[0]))
    axis = np.zeros(3)
    axis[int(vertical)] = np.sign(baseline[int(vertical)]) or 1.0
    turn_axis = np.cross(baseline, axis)
    sine, cosine = np.linalg.norm(turn_axis), baseline @ axis
    direction = turn_axis / sine if sine > 0 else turn_axis
    onto = Rotation.from_rotvec(direction * np.arctan2(sine, cosine)).as_matrix()
    rotation_a, rotation_b = onto @ half.T, onto @ half
    offset = float((rotation_b @ b_from_a.trans_m)[int(vertical)])

    focal = float(np.mean([lens_a.fx, lens_a.fy, lens_b.fx, lens_b.fy]))
    size_wh = max(size_a_wh[0], size_b_wh[0]), max(size_a_wh[1], size_b_wh[1])
    middles = [
        focal * _middle(lens_a, size_a_wh, rotation_a),
        focal * _middle(lens_b, size_b_wh, rotation_b),
    ]
    centre = (np.array(size_wh) - 1) / 2 - np.mean(middles, axis=0)
    projection_a = np.zeros((3, 4))
    projection_a[:, :3] = [[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]]
    projection_b = projection_a.copy()
    projection_b[int(vertical), 3] = focal * offset
    q = np.zeros((4, 4))
    q[0, 0] = q[1, 1] = 1
    q[0, 3], q[1, 3], q[2, 3] = -centre[0], -centre[1], focal
    q[3, 2] = -1 / offset
    return Rectification(
        rotation_a=rotation_a,
        rotation_b=rotation_b,
        projection_a=projection_a,
        projection_b=projection_b,
        disparity_to_depth=q,
        size_wh=size_wh,
        vertical=vertical,
    )


def _middle(lens: BrownConrady, size_wh: tuple[int, int], rotation: FloatArray) -> FloatArray:
    """Where the middle of a picture lies on the rectified plane z = 1, (2,)."""
    ray = rotation @ lens.unproject((np.array([size_wh], dtype=np.float64) - 1) / 2)[0]
    return np.asarray(ray[:2] / ray[2])

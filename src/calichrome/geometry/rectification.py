"""Two cameras turned by calculation until their rows (or columns) correspond."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray, frozen
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rectified_area import Framing, TurnedCamera, framed

__all__ = ["Rectification", "RectifiedCamera", "Side", "rectify_pair"]

Side = Literal["a", "b"]

# Choice: beyond 60 degrees from the common axis a plane picture stretches its middle over 4 times
# as long as wide, and no matcher finds the same things in two such pictures.
_MOST_OBLIQUE_RAD = np.deg2rad(60)
_SMALLEST_BASELINE_M = 1e-6  # choice: no rig of cameras is known to a micrometre
_SHARE_GRID = 64  # points along each side that measure how much of a picture is shown


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedCamera:
    """One camera of a rectified pair.

    Parameters
    ----------
    turned
        Lens, picture size and turn.
    projection : (3, 4) float
        Pinhole of the rectified camera in the frame of the first rectified one; metres.
    share
        How much of the recorded picture the rectified one shows, 0..1.
    """

    turned: TurnedCamera
    projection: FloatArray
    share: float

    @property
    def rect_from_cam(self) -> FloatArray:
        """The turn, (3, 3)."""
        return self.turned.rect_from_cam

    @property
    def matrix(self) -> FloatArray:
        """The pinhole matrix K, (3, 3)."""
        return self.projection[:, :3]

    def rectify_points(self, pixels: FloatArray) -> FloatArray:
        """Move pixels (..., 2) as recorded to where the rectified picture shows them.

        nan where no ray of the lens reaches the pixel or the ray does not meet the plane.
        """
        plane = self.turned.plane_from_pixels(np.asarray(pixels, dtype=np.float64), np.pi / 2)
        return np.asarray(plane * self.matrix[0, 0] + self.matrix[:2, 2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectification:
    """R1, R2, P1, P2 and Q as OpenCV's ``stereoRectify`` defines them.

    Parameters
    ----------
    a, b
        The cameras. They share the focal length and, with common principal points, all of K. The
        fourth column of b's projection holds focal length times position of a as b sees it along
        the common axis: minus the baseline if b is right of a (below), plus if left (above).
    disparity_to_depth : (4, 4) float
        Q: (x, y, disparity, 1) to homogeneous points of the first rectified camera, metres. The
        disparity is x_a - x_b (y_a - y_b for a vertical pair). With common principal points it is
        positive for every point before the cameras if b is right of a (below), else negative; Q
        wants it with this sign.
    size_wh
        Of both rectified pictures.
    vertical
        True if the cameras stand above each other: columns correspond instead of rows.
    """

    a: RectifiedCamera
    b: RectifiedCamera
    disparity_to_depth: FloatArray
    size_wh: tuple[int, int]
    vertical: bool

    @property
    def focal_px(self) -> float:
        """Focal length of both rectified cameras."""
        return float(self.a.projection[0, 0])

    @property
    def baseline_m(self) -> float:
        """Position of b along the common axis as a sees it: negative if left of a, or above."""
        return float(-self.b.projection[int(self.vertical), 3] / self.focal_px)

    def rectify_points(self, side: Side, pixels: FloatArray) -> FloatArray:
        """Move pixels (..., 2) of camera "a" or "b" into its rectified picture; nan if nowhere."""
        return (self.a if side == "a" else self.b).rectify_points(pixels)


def rectify_pair(
    lens_a: Lens,
    lens_b: Lens,
    b_from_a: Pose,
    size_a_wh: tuple[int, int],
    size_b_wh: tuple[int, int],
    framing: Framing | None = None,
) -> Rectification:
    """Turn both cameras by half of their relative rotation, then onto their baseline.

    Any two cameras, in any order; the rectified pictures are as large as the larger of both.

    Parameters
    ----------
    lens_a, lens_b, size_a_wh, size_b_wh
        The cameras, as calibrated.
    b_from_a
        Their relative pose.
    framing
        Which part of the pictures is shown, and with what principal points; None: all of both, with
        one.

    Raises
    ------
    SolveError
        If no plane shows both pictures: the cameras stand at one place, look too differently (as
        when they face each other), one stands before the other, or they share no field of view;
        or if the framing has no solution.

    References
    ----------
    .. [1] J.-Y. Bouguet, "Camera Calibration Toolbox for Matlab", stereo rectification (least
       distortion by halving the rotation); conventions of R, P, Q as in OpenCV.
    """
    if not np.linalg.norm(b_from_a.trans_m) > _SMALLEST_BASELINE_M:
        raise SolveError("the cameras stand at one place: no baseline along which to rectify")
    half = Rotation.from_rotvec(-0.5 * b_from_a.rotvec_rad).as_matrix()
    baseline = half @ b_from_a.trans_m
    along = int(abs(baseline[1]) > abs(baseline[0]))
    axis = np.zeros(3)
    axis[along] = np.sign(baseline[along]) or 1.0  # the nearer end: pictures are not turned over
    turn_axis = np.cross(baseline, axis)
    sine, cosine = np.linalg.norm(turn_axis), baseline @ axis
    direction = turn_axis / sine if sine > 0 else turn_axis
    onto = Rotation.from_rotvec(direction * np.arctan2(sine, cosine)).as_matrix()
    camera_a = TurnedCamera(lens_a, size_a_wh, frozen(onto @ half.T))
    camera_b = TurnedCamera(lens_b, size_b_wh, frozen(onto @ half))
    offset = float((camera_b.rect_from_cam @ b_from_a.trans_m)[along])
    _check_views((camera_a, camera_b), along, offset)

    size_wh = max(size_a_wh[0], size_b_wh[0]), max(size_a_wh[1], size_b_wh[1])
    focal, centres = framed((camera_a, camera_b), size_wh, along, framing or Framing())
    projections = np.zeros((2, 3, 4))
    projections[:, [0, 1], [0, 1]] = focal
    projections[:, :2, 2] = centres
    projections[:, 2, 2] = 1
    projections[1, along, 3] = focal * offset
    # with x_b = x_a - d: x_a - d - c_b = f (X + offset) / Z and x_a - c_a = f X / Z, so that
    # f / Z = (c_a - c_b - d) / offset
    q = np.zeros((4, 4))
    q[0, 0] = q[1, 1] = 1
    q[:2, 3], q[2, 3] = -centres[0], focal
    q[3, 2] = -1 / offset
    q[3, 3] = (centres[0] - centres[1])[along] / offset
    rectified = [
        RectifiedCamera(camera, frozen(projection), _share(camera, projection, size_wh))
        for camera, projection in zip((camera_a, camera_b), projections, strict=True)
    ]
    return Rectification(
        a=rectified[0],
        b=rectified[1],
        disparity_to_depth=frozen(q),
        size_wh=size_wh,
        vertical=bool(along),
    )


def _check_views(cameras: tuple[TurnedCamera, TurnedCamera], along: int, offset: float) -> None:
    """Refuse cameras that no plane shows together."""
    for camera in cameras:
        middle = camera.plane_from_pixels(camera.middle_px, _MOST_OBLIQUE_RAD)
        if np.isnan(middle).any():
            raise SolveError(
                f"no plane shows both pictures: halfway between their directions and at right "
                f"angles to the baseline, a camera looks more than "
                f"{np.rad2deg(_MOST_OBLIQUE_RAD):.0f} degrees aside; rectify cameras that stand "
                f"beside or above each other and look about the same way"
            )
    outline_a, outline_b = (camera.outline() for camera in cameras)
    low_a, high_a = outline_a.min(axis=0), outline_a.max(axis=0)
    low_b, high_b = outline_b.min(axis=0), outline_b.max(axis=0)
    across = 1 - along
    same_rows = low_a[across] < high_b[across] and low_b[across] < high_a[across]
    # a point before the cameras lies further along the baseline in the camera it comes from
    disparity = (high_a - low_b)[along] if offset < 0 else (high_b - low_a)[along]
    if not same_rows or disparity <= 0:
        raise SolveError(
            "the cameras share no field of view: nothing corresponds; rectify cameras that look at "
            "the same things"
        )


def _share(camera: TurnedCamera, projection: FloatArray, size_wh: tuple[int, int]) -> float:
    ticks = [np.linspace(0, end - 1, _SHARE_GRID) for end in camera.size_wh]
    pixels = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 2)
    plane = camera.plane_from_pixels(pixels, np.pi / 2)
    shown = plane * projection[0, 0] + projection[:2, 2]
    # half a pixel of grace: a border that just fits is inside whatever rounding says
    inside = (shown >= -0.5) & (shown <= np.array(size_wh) - 0.5)
    return float(inside.all(axis=1).mean())

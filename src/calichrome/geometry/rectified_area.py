"""Which part of two pictures their common rectified plane shows, and at which scale."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import distance_transform_cdt

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.errors import SolveError
from calichrome.geometry.lenses import Lens

__all__ = ["Framing", "PrincipalPoints", "TurnedCamera", "ValidArea", "framed"]

ValidArea = Literal["all", "valid"]
PrincipalPoints = Literal["common", "own"]

# Choice: a plane picture stretches its border by 1 / cos^2; at 75 degrees 15 times, and every
# further degree costs the middle more pixels than it shows.
_WIDEST_RAD = np.deg2rad(75)
_BORDER_STEP_PX = 2.0  # between points of a picture's border, which bends far less in that length
_GRID = 800  # cells along the field of both: so finely the middle of the largest frame is placed
_BISECTIONS = 60  # halve an interval down to the rounding of float64
_MARGIN = 1e-9  # of the scale: who computes the same place otherwise rounds otherwise


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """What rectified pictures show; both have one focal length in any case.

    Parameters
    ----------
    area
        "all": the largest scale at which every pixel of both pictures is shown, but for those
        further than 75 degrees from the common axis; "valid": the smallest at which every pixel of
        both rectified pictures comes from inside its picture.
    principal_points
        "common": one for both, so that points at infinity have no disparity; "own": they may differ
        along the baseline, so that cameras which converge keep their scale. Q knows the difference.
    """

    area: ValidArea = "all"
    principal_points: PrincipalPoints = "common"


@dataclass(frozen=True, slots=True, eq=False)
class TurnedCamera:
    """A camera and the turn that makes it parallel to its partner.

    Parameters
    ----------
    lens, size_wh
        As calibrated.
    rect_from_cam : (3, 3) float
        The turn.
    """

    lens: Lens
    size_wh: tuple[int, int]
    rect_from_cam: FloatArray

    @property
    def middle_px(self) -> FloatArray:
        """The middle of the picture, (2,)."""
        return (np.array(self.size_wh, dtype=np.float64) - 1) / 2

    def plane_from_pixels(self, pixels: FloatArray, widest_rad: float) -> FloatArray:
        """Return points (..., 2) on the plane z = 1 in rect of pixels (..., 2).

        nan where no ray of the lens reaches the pixel, or one further than `widest_rad` from z.
        """
        rays = self.lens.unproject(pixels) @ self.rect_from_cam.T
        cosine = rays[..., 2] / np.linalg.norm(rays, axis=-1)
        depth = np.where(cosine > np.cos(widest_rad), rays[..., 2], np.nan)
        return np.asarray(rays[..., :2] / depth[..., None])

    def shows(self, plane: FloatArray) -> BoolArray:
        """Tell which points (..., 2) of the plane z = 1 in rect lie in this picture, (...,)."""
        flat = plane.reshape(-1, 2)
        rays_cam = np.column_stack([flat, np.ones(len(flat))]) @ self.rect_from_cam
        near = np.hypot(flat[:, 0], flat[:, 1]) < np.tan(_WIDEST_RAD)
        inside = np.asarray(self.lens.sees(rays_cam) & near)
        pixels = self.lens.project(rays_cam[inside])
        last = np.array(self.size_wh) - 1
        inside[inside] = ((pixels >= 0) & (pixels <= last)).all(axis=1)
        return np.asarray(inside.reshape(plane.shape[:-1]))

    def outline(self) -> FloatArray:
        """Return the border of what the camera shows of the plane z = 1, (N, 2).

        Where the border of the picture has no ray, or one beyond 75 degrees from z, the last place
        on the way there from the middle of the picture stands for it.
        """
        border = _border(self.middle_px, _BORDER_STEP_PX)
        plane = self.plane_from_pixels(border, _WIDEST_RAD)
        lost = np.isnan(plane).any(axis=1)
        if lost.any():
            way = border[lost] - self.middle_px
            good, bad = np.zeros((len(way), 1)), np.ones((len(way), 1))
            for _ in range(_BISECTIONS):
                half = (good + bad) / 2
                reached = self.plane_from_pixels(self.middle_px + half * way, _WIDEST_RAD)
                seen = np.isfinite(reached).all(axis=1, keepdims=True)
                good, bad = np.where(seen, half, good), np.where(seen, bad, half)
            plane[lost] = self.plane_from_pixels(self.middle_px + good * way, _WIDEST_RAD)
        return plane


def framed(
    cameras: tuple[TurnedCamera, TurnedCamera],
    size_wh: tuple[int, int],
    along: int,
    framing: Framing,
) -> tuple[float, FloatArray]:
    """Choose the focal length and both principal points of a rectified pair.

    Parameters
    ----------
    cameras
        Turned, so that points differ along one axis only.
    size_wh
        Of both rectified pictures.
    along
        0 if rows correspond, 1 if columns do.
    framing
        What is to be seen.

    Returns
    -------
    focal_px : float
    centres_px : (2, 2) float, pixels
        Principal point of each.

    Raises
    ------
    SolveError
        If "valid" is asked for and no rectangle fits.
    """
    outlines = [camera.outline() for camera in cameras]
    half_wh = (np.array(size_wh, dtype=np.float64) - 1) / 2
    common = framing.principal_points == "common"
    if framing.area == "all":
        middles, focal = _around(outlines, half_wh, along, common=common)
    else:
        middles, focal = _within(cameras, outlines, half_wh, along, common=common)
    return focal, half_wh - focal * middles


def _around(
    outlines: list[FloatArray], half_wh: FloatArray, along: int, *, common: bool
) -> tuple[FloatArray, float]:
    """Middles (2, 2) on the plane and focal length of the smallest frame around both outlines."""
    low = np.stack([outline.min(axis=0) for outline in outlines])
    high = np.stack([outline.max(axis=0) for outline in outlines])
    joined = np.array([True, True])
    joined[along] = common
    low = np.where(joined, low.min(axis=0), low)
    high = np.where(joined, high.max(axis=0), high)
    focal = float((2 * half_wh / (high - low).max(axis=0)).min())
    return (low + high) / 2, focal


def _within(
    cameras: tuple[TurnedCamera, TurnedCamera],
    outlines: list[FloatArray],
    half_wh: FloatArray,
    along: int,
    *,
    common: bool,
) -> tuple[FloatArray, float]:
    """Middles (2, 2) on the plane and focal length of the largest frame within both pictures.

    On a grid whose cells have the shape of the frame, the largest square around a cell is its
    chessboard distance to what lies outside. The scale is then made exact for the best middle.
    """
    low = np.min([outline.min(axis=0) for outline in outlines], axis=0)
    high = np.max([outline.max(axis=0) for outline in outlines], axis=0)
    step = ((high - low) / half_wh).max() / _GRID * half_wh
    axes = [np.arange(low[k], high[k] + step[k], step[k]) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1)
    room = [_room(camera.shows(grid)) for camera in cameras]
    aims = np.stack([item.plane_from_pixels(item.middle_px, np.pi / 2) for item in cameras])
    if common:
        both = _room((room[0] > 0) & (room[1] > 0))
        room = [both, both]
        aims[:] = aims.mean(axis=0)
    across = np.minimum(*(item.max(axis=1 - along) for item in room))
    if across.max() == 0:
        raise SolveError(
            "no place of the rectified plane is covered by both pictures; choose the area all, or "
            "give each camera its own principal point"
        )
    # of places with equal room the one nearest to the middle of the picture
    level = axes[1 - along]
    line = _nearest(level, across == across.max(), aims[:, 1 - along].mean())
    middles = np.empty((2, 2))
    middles[:, 1 - along] = level[line]
    for middle, item, aim in zip(middles, room, aims, strict=True):
        wide = np.take(item, line, axis=along) >= across[line]
        middle[along] = axes[along][_nearest(axes[along], wide, aim[along])]
    frame = _border(half_wh, 1.0) - half_wh
    fits, fails = np.inf, 0.0  # focal lengths: at infinity the frame is one point, which is inside
    focal = 1 / float(step.max())
    for _ in range(_BISECTIONS):
        inside = all(
            camera.shows(middle + frame / focal).all()
            for camera, middle in zip(cameras, middles, strict=True)
        )
        fits, fails = (focal, fails) if inside else (fits, focal)
        focal = 2 * focal if np.isinf(fits) else (fits + fails) / 2
    return middles, float(fits) * (1 + _MARGIN)


def _room(inside: BoolArray) -> IntArray:
    """Chessboard distance of every cell to the nearest one that is not `inside`, in cells."""
    distance = distance_transform_cdt(np.pad(inside, 1), metric="chessboard")
    return np.asarray(distance[1:-1, 1:-1], dtype=np.int64)


def _nearest(places: FloatArray, allowed: BoolArray, aim: float) -> int:
    """Index of the allowed place nearest to `aim`."""
    return int(np.where(allowed, np.abs(places - aim), np.inf).argmin())


def _border(half_wh: FloatArray, step_px: float) -> FloatArray:
    """Points once round a picture, through the centres of its outermost pixels, (N, 2)."""
    width, height = 2 * half_wh
    x, y = (np.linspace(0, end, int(np.ceil(end / step_px)) + 1) for end in (width, height))
    top, left = np.zeros_like(x), np.zeros_like(y)
    sides = [(x, top), (left + width, y), (x[::-1], top + height), (left, y[::-1])]
    return np.concatenate([np.column_stack(side) for side in sides])

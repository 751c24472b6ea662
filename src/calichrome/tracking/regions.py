"""Foreground regions of one picture: where each points, how large it looks, what colour it has."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.tracking.background import Background, Picture
from calichrome.tracking.surface_colour import SurfaceColour, surface_colour
from calichrome.tracking.view import PixelRays, View

__all__ = ["Region", "find_regions", "measure_region"]

_BAND_PX = 2  # the edge of a region: from this far inside to this far outside
_HALF = 0.5
_ALPHA_SIGMA = 0.1
"""Of the share of an edge pixel that the object covers, besides noise: demosaicing, shading between
the edge and the inside. Only a start: the scatter of tracks tells the true scale."""
_UNKNOWN = 12**-0.5  # standard deviation of a share of which nothing is known but 0..1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """One foreground region.

    Parameters
    ----------
    camera
        Which one sees it.
    centre_px : (2,) float
        Pixel of its mean direction.
    cov_px2 : (2, 2) float
        From the noise at its edge.
    solid_angle_sr : float
        How large it looks.
    n_px : int
        Number of its pixels.
    box : (4,) int
        Left, top, right, bottom; right and bottom are the first pixels outside.
    mask : (bottom - top, right - left) bool
        Its pixels within the box: those of which it covers half or more.
    whole : bool
        It does not touch the border of the picture.
    colour
        None if the camera has no colour calibration.
    """

    camera: str
    centre_px: FloatArray
    cov_px2: FloatArray
    solid_angle_sr: float
    n_px: int
    box: tuple[int, int, int, int]
    mask: BoolArray
    whole: bool
    colour: SurfaceColour | None

    @property
    def half_angle_rad(self) -> float:
        """Half the apex angle of the circular cone of the same solid angle, 2 pi (1 - cos)."""
        return float(np.arccos(np.clip(1 - self.solid_angle_sr / (2 * np.pi), -1, 1)))

    def covers(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Tell which pixels (N, 2) lie on it."""
        left, top, right, bottom = self.box
        with np.errstate(invalid="ignore"):
            whole = np.where(np.isfinite(pixels), np.rint(pixels), -1).astype(np.int64)
        x, y = whole[:, 0] - left, whole[:, 1] - top
        inside = (x >= 0) & (y >= 0) & (x < right - left) & (y < bottom - top)
        covered = np.zeros(len(pixels), dtype=bool)
        covered[inside] = self.mask[y[inside], x[inside]]
        return covered


def find_regions(
    picture: Picture,
    background: Background,
    view: View,
    rays: PixelRays,
    *,
    min_area_px: int,
    darkest_shadow: float,
    in_colour: bool,
) -> tuple[Region, ...]:
    """Find what is in front of the empty scene.

    Parameters
    ----------
    picture : (H, W, 3) float32
        Linear light; XYZ under D65 if `in_colour`.
    background
        Learnt from pictures of the same kind.
    view, rays
        Of the camera.
    min_area_px
        Smaller regions are left out.
    darkest_shadow
        See `Background.foreground`.
    in_colour
        Whether the picture is corrected.
    """
    mask = background.foreground(picture, darkest_shadow)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S
    )
    regions = []
    for label in range(1, count):
        left, top, width, height, area = (int(value) for value in stats[label])
        if area < min_area_px:
            continue
        box = left, top, left + width, top + height
        own = labels[top : top + height, left : left + width] == label
        region = measure_region(
            picture, background, view, rays, box=box, mask=own, in_colour=in_colour
        )
        if region is not None:
            regions.append(region)
    return tuple(regions)


def measure_region(
    picture: Picture,
    background: Background,
    view: View,
    rays: PixelRays,
    *,
    box: tuple[int, int, int, int],
    mask: BoolArray,
    in_colour: bool,
) -> Region | None:
    """Measure the pixels of `mask`, which fills `box`; None where the lens has no rays.

    Notes
    -----
    The centre is the mean of the unit vectors to all points of the region, weighted by solid angle,
    projected back into the picture. Seen from a point, a sphere fills a circular cone, whose axis
    goes through its centre: by symmetry the mean is that axis, through any lens. (The centroid of
    pixels is not: through a pinhole it lies a^2 tan t / cos^2 t farther out, for a cone of half
    angle a at the angle t from the axis: the mean of tan(t + a) and tan(t - a), less tan t.)

    The weights are alpha * solid angle. With errors of alpha at the edge alone and independent, and
    w_e the solid angle of an edge's pixel p_e, its covariance is
    ``sum sigma_e^2 w_e^2 (p_e - c)(p_e - c)' / (sum alpha w)^2``; sigma_e grows where object and
    background look alike.
    """
    height, width = picture.shape[:2]
    left, top = max(box[0] - _BAND_PX, 0), max(box[1] - _BAND_PX, 0)
    right, bottom = min(box[2] + _BAND_PX, width), min(box[3] + _BAND_PX, height)
    window = slice(top, bottom), slice(left, right)
    wide = np.zeros((bottom - top, right - left), dtype=np.uint8)
    wide[box[1] - top : box[3] - top, box[0] - left : box[2] - left] = mask
    inner = cv2.erode(wide, _disc(_BAND_PX), borderValue=0)
    outer = cv2.dilate(wide, _disc(_BAND_PX))
    alpha, alpha_sigma = _coverage(
        picture[window], background.mean[window], background.sigma[window], wide, inner, outer
    )
    weight = alpha * rays.solid_angle_sr[window].astype(np.float64)
    total = float(weight.sum())
    # pixels that noise alone keeps out of the background reach beyond the edge: half covered counts
    covered = alpha >= _HALF
    if total <= 0 or not covered.any():
        return None
    rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
    tight = covered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    direction = np.einsum("yx,yxi->i", weight, rays.directions[window])
    centre = view.lens.project(direction[None])[0]
    edge = np.nonzero((outer > 0) & (inner == 0))
    from_centre = np.stack([edge[1] + left, edge[0] + top], axis=1) - centre
    lever = (alpha_sigma * rays.solid_angle_sr[window])[edge][:, None] * from_centre
    return Region(
        camera=view.camera,
        centre_px=centre,
        cov_px2=lever.T @ lever / total**2,
        solid_angle_sr=total,
        n_px=int(tight.sum()),
        box=(
            left + int(columns[0]),
            top + int(rows[0]),
            left + int(columns[-1]) + 1,
            top + int(rows[-1]) + 1,
        ),
        mask=tight,
        whole=box[0] > 0 and box[1] > 0 and box[2] < width and box[3] < height,
        colour=surface_colour(picture[window], inner, background) if in_colour else None,
    )


def _coverage(
    seen: Picture,
    empty: Picture,
    noise: Picture,
    mask: NDArray[np.uint8],
    inner: NDArray[np.uint8],
    outer: NDArray[np.uint8],
) -> tuple[FloatArray, FloatArray]:
    """Share (h, w) of each pixel that the object covers, and how uncertain it is.

    Inside 1, outside 0. In between a pixel mixes the light of object and background, so its share
    is how far it has come from the one to the other; the object's light is that of the inside
    nearby.
    """
    if not inner.any():
        return np.asarray(mask, dtype=np.float64), np.full(mask.shape, _UNKNOWN)
    size = 4 * _BAND_PX + 1
    weight = cv2.boxFilter(inner.astype(np.float32), -1, (size, size), normalize=False)
    light = cv2.boxFilter(seen * inner[..., None], -1, (size, size), normalize=False)
    known = weight > 0
    step = light / np.maximum(weight, 1)[..., None] - empty
    moved = ((seen - empty) * step).sum(axis=2)
    length = np.maximum((step**2).sum(axis=2), 1e-12)
    share = np.where(known, np.clip(moved / length, 0, 1), mask)
    spread = np.sqrt(((noise * step) ** 2).sum(axis=2)) / length
    sigma = np.where(known, np.minimum(np.hypot(_ALPHA_SIGMA, spread), _UNKNOWN), _UNKNOWN)
    alpha = np.where(inner > 0, 1.0, np.where(outer > 0, share, 0.0))
    return alpha.astype(np.float64), sigma.astype(np.float64)


def _disc(radius_px: int) -> NDArray[np.uint8]:
    side = 2 * radius_px + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))

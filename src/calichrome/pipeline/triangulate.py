"""Points found in pictures, located in the world."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import chdtri

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.errors import FileFormatError
from calichrome.geometry.triangulation import TriangulatedPoints
from calichrome.observations.points import ImagePoints
from calichrome.observations.table import write_table
from calichrome.rig import Evidence, Rig

__all__ = ["LocatedPoints", "locate_points", "point_table", "write_points"]

_SCALE_SIGMA = 0.005  # of an unmeasured board: as `calibrate` has it
# What starts the search for the noise; choice: so large that no view is taken for an outlier before
# the noise is known.
_LARGE_PX = 2.0
_ROUNDS = 5  # from 2 px to 0.05 px; each takes up what the last one attributed wrongly
_FEWEST_POINTS = 20  # choice: their median tells a variance to 35 %
_HEADER = (
    *("frame", "point", "x", "y", "z", "sxx", "sxy", "sxz", "syy", "syz", "szz"),
    *("cameras", "residual_px", "angle_rad", "left_out", "remark"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocatedPoints:
    """N points in the world, and how far they are to be trusted.

    Parameters
    ----------
    names : N times (frame, point)
    points_world : (N, 3) float, metres
        nan where there is none.
    cov_m2 : (N, 3, 3) float, metres squared
        From the pixels, the calibration if its covariance is known, and the scale of the board if
        its size was not measured; `world_from_ref` counts as exact.
    cameras
        Those that have points.
    used, left_out : (N, C) bool
        Views that a point stands on, and those that contradict them.
    residual_px : (N,) float
        Root mean square of the distances between its projections and its used pixels.
    angle_rad : (N,) float
        Largest angle between two used rays.
    remarks : N times words
        "few_views", "behind", "inconsistent", "small_angle": see `TriangulatedPoints`.
    with_covariance
        False: the calibration was taken as exact, since its evidence is not there.
    sigma_px
        Of positions that state none.
    sigma_found
        Whether it was found from the residuals, or is that of the corners of the calibration.
    all_stated
        Whether every position stated its own.
    """

    names: tuple[tuple[str, str], ...]
    points_world: FloatArray
    cov_m2: FloatArray
    cameras: tuple[str, ...]
    used: BoolArray
    left_out: BoolArray
    residual_px: FloatArray
    angle_rad: FloatArray
    remarks: tuple[tuple[str, ...], ...]
    with_covariance: bool
    sigma_px: float
    sigma_found: bool
    all_stated: bool

    @property
    def located(self) -> BoolArray:
        """Which points have a place, (N,)."""
        return np.asarray(np.isfinite(self.points_world).all(axis=1))


def locate_points(rig: Rig, evidence: Evidence | None, seen: ImagePoints) -> LocatedPoints:
    """Triangulate points in coordinates of `world_from_ref`.

    Parameters
    ----------
    rig, evidence
        The calibration; without evidence it is taken as exact.
    seen
        Pixels; where no covariance is said, it is found from how far the views miss each other.

    Raises
    ------
    FileFormatError
        If fewer than two cameras have points.

    Notes
    -----
    A board of unmeasured size makes every length wrong by one factor, of standard deviation
    s = 0.005: to the covariance of a point X it adds s^2 X X'.

    Positions without a stated covariance have one sigma in all cameras: that with which half of the
    points that state none have a chi-square above its median, which outliers do not move, but not
    less than that of the corners of the calibration; this one with fewer than 20 such points.
    """
    cameras = tuple(name for name in rig.cameras if name in seen.pixels)
    if len(cameras) < 2:
        raise FileFormatError(
            f"only {cameras[0] if cameras else 'no camera'} has points; a place needs the same "
            f"point in two cameras"
        )
    pixels = {name: seen.pixels[name] for name in cameras}
    joint = None if evidence is None else evidence.joint
    cov_px2 = np.stack([seen.cov_px2[name] for name in cameras], axis=1)
    unstated = np.asarray(np.isnan(cov_px2).any(axis=(2, 3)))

    def solved_with(sigma_px: float) -> TriangulatedPoints:
        filled = np.where(np.isnan(cov_px2), sigma_px**2 * np.eye(2), cov_px2)
        return rig.triangulate(pixels, cov_px2=filled, covariance=joint)

    corners_px = float(np.sqrt(np.mean([rig.cameras[name].rms_px ** 2 / 2 for name in cameras])))
    found_px = _noise_px(solved_with, unstated, corners_px)
    sigma_px = found_px or corners_px
    found = solved_with(sigma_px)
    to_world = rig.world_from_ref
    points_world = to_world.apply(found.points_ref)
    cov = to_world.rotation @ found.cov_m2 @ to_world.rotation.T
    if any(item.code == "scale_unverified" for item in rig.findings):
        cov = cov + _SCALE_SIGMA**2 * points_world[:, :, None] * points_world[:, None, :]
    off = [rig.cameras[name].project(found.points_ref) - own for name, own in pixels.items()]
    squares = np.where(found.used, (np.stack(off, axis=1) ** 2).sum(axis=2), 0.0)
    solved = np.isfinite(points_world).all(axis=1)
    n_used = np.maximum(found.used.sum(axis=1), 1)
    marked = {
        "few_views": found.few_views,
        "behind": found.behind,
        "inconsistent": found.inconsistent,
        "small_angle": found.small_angle,
    }
    seen_by = np.stack([np.isfinite(own).all(axis=1) for own in pixels.values()], axis=1)
    return LocatedPoints(
        names=seen.names,
        points_world=points_world,
        cov_m2=cov,
        cameras=cameras,
        used=found.used,
        left_out=seen_by & ~found.used,
        residual_px=np.where(solved, np.sqrt(squares.sum(axis=1) / n_used), np.nan),
        angle_rad=found.angle_rad,
        remarks=tuple(
            tuple(word for word, flags in marked.items() if flags[row])
            for row in range(len(seen.names))
        ),
        with_covariance=joint is not None,
        sigma_px=sigma_px,
        sigma_found=found_px is not None,
        all_stated=not (unstated & seen_by).any(),
    )


def _noise_px(
    solved_with: Callable[[float], TriangulatedPoints], unstated: BoolArray, least_px: float
) -> float | None:
    """Sigma of positions that state none; None if the points are too few to tell."""
    sigma_px = max(_LARGE_PX, least_px)
    for _ in range(_ROUNDS):
        found = solved_with(sigma_px)
        judged = np.isfinite(found.chi_square) & (~found.used | unstated).all(axis=1)
        if judged.sum() < _FEWEST_POINTS:
            return None
        medians = chdtri(found.freedom[judged], 0.5)
        sigma_px *= float(np.sqrt(np.median(found.chi_square[judged] / medians)))
        sigma_px = max(sigma_px, least_px)
    return sigma_px


def point_table(points: LocatedPoints) -> Iterator[list[str]]:
    """Yield the header and a row of each point, as written to CSV."""
    yield list(_HEADER)
    upper = np.triu_indices(3)
    located = points.located
    for row, (frame, point) in enumerate(points.names):
        there = located[row]
        numbers = [*points.points_world[row], *points.cov_m2[row][upper]]
        yield [
            frame,
            point,
            *(f"{value:.9g}" if there else "" for value in numbers),
            _names(points.cameras, points.used[row]),
            f"{points.residual_px[row]:.4g}" if there else "",
            f"{points.angle_rad[row]:.6g}" if there else "",
            _names(points.cameras, points.left_out[row]),
            ";".join(points.remarks[row]),
        ]


def write_points(points: LocatedPoints, path: Path, *, force: bool = False) -> None:
    """Write `point_table` as CSV."""
    header, *rows = point_table(points)
    write_table(path, header, rows, force=force)


def _names(cameras: Sequence[str], chosen: BoolArray) -> str:
    return ";".join(name for name, taken in zip(cameras, chosen, strict=True) if taken)

"""New objects: regions of several cameras at one instant that one object would explain."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.triangulation import triangulate
from calichrome.rig import CameraCovariance
from calichrome.tracking.likelihood import AssociationSettings, RegionTable, gate

__all__ = ["Hypothesis", "find_objects"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """An object as several cameras see it at one instant.

    Parameters
    ----------
    regions : camera -> index of its region
    position_ref : (3,) float, metres
    cov_m2 : (3, 3) float
    """

    regions: Mapping[str, int]
    position_ref: FloatArray
    cov_m2: FloatArray


def find_objects(
    tables: Mapping[str, RegionTable],
    settings: AssociationSettings,
    *,
    covariance: CameraCovariance | None = None,
    free: Mapping[str, Collection[int]] | None = None,
) -> tuple[Hypothesis, ...]:
    """Explain regions of one instant by objects, the best supported first.

    Parameters
    ----------
    tables
        camera -> its regions.
    settings
        What the regions of one object may differ by.
    covariance
        Of the cameras; None: they are exact.
    free
        camera -> regions that may be used; None: all.

    Notes
    -----
    Every pair of regions of two cameras that agrees in epipolar distance, colour and size is a
    candidate; it looks for its best region in each further camera. The candidate that the most
    cameras support wins, of equals that with the lowest cost; its regions are taken and the rest
    compete on. An object must be found in three cameras, or in all that could see it if they are
    two.
    """
    if free is None:
        free = {camera: range(len(table.regions)) for camera, table in tables.items()}
    left = {camera: {i for i in own if tables[camera].regions[i].whole} for camera, own in
            free.items()}  # fmt: skip
    cameras = list(tables)
    if len(cameras) < 2:
        return ()
    cameras_cov = None if covariance is None else covariance.of(*cameras)
    candidates = _candidates(tables, left, settings, cameras_cov)
    found: list[Hypothesis] = []
    while True:
        best = None
        for views, cost, visible in candidates:
            alive = {camera: i for camera, i in views.items() if i in left[camera]}
            if len(alive) < len(views) or len(views) < min(3, max(visible, 2)):
                continue
            rank = (-len(views), cost)
            if best is None or rank < best[0]:
                best = rank, views
        if best is None:
            return tuple(found)
        chosen = best[1]
        hypothesis = _solved(tables, cameras, chosen, cameras_cov)
        candidates = [item for item in candidates if item[0] is not chosen]
        if hypothesis is None:
            continue
        found.append(hypothesis)
        for camera, index in chosen.items():
            left[camera].discard(index)


_Candidate = tuple[dict[str, int], float, int]


def _candidates(
    tables: Mapping[str, RegionTable],
    left: Mapping[str, set[int]],
    settings: AssociationSettings,
    cameras_cov: FloatArray | None,
) -> list[_Candidate]:
    cameras = list(tables)
    pairs = [
        (first, i, second, j)
        for first, second in combinations(cameras, 2)
        for i in sorted(left[first])
        for j in sorted(left[second])
    ]
    colour = np.array([_colour_distance(tables[a], i, tables[b], j) for a, i, b, j in pairs])
    alike = np.flatnonzero(colour <= gate(3, settings.false_alarm))
    if not alike.size:
        return []
    chosen = [{a: i, b: j} for a, i, b, j in (pairs[index] for index in alike)]
    points, cov, chi_square = _triangulated(tables, cameras, chosen, cameras_cov)
    found = [
        _supported(
            tables, left, chosen[k], points[k], cov[k], colour[alike[k]] + chi_square[k], settings
        )
        for k in np.flatnonzero(np.isfinite(chi_square))
    ]
    unique: dict[tuple[tuple[str, int], ...], _Candidate] = {}
    for item in found:
        if item is not None:
            key = tuple(sorted(item[0].items()))
            if key not in unique or item[1] < unique[key][1]:
                unique[key] = item
    return list(unique.values())


def _colour_distance(a: RegionTable, i: int, b: RegionTable, j: int) -> float:
    """Squared difference of two colours in units of its covariance; 0 where one is not known."""
    difference = a.lab[i] - b.lab[j]
    if not np.isfinite(difference).all():
        return 0.0
    return float(difference @ np.linalg.solve(a.lab_cov[i] + b.lab_cov[j], difference))


def _triangulated(
    tables: Mapping[str, RegionTable],
    cameras: Sequence[str],
    chosen: Sequence[Mapping[str, int]],
    cameras_cov: FloatArray | None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points, covariances and chi-square, infinite where the views do not agree."""
    pixels = np.full((len(chosen), len(cameras), 2), np.nan)
    cov = np.tile(np.eye(2), (len(chosen), len(cameras), 1, 1))
    for row, views in enumerate(chosen):
        for camera, index in views.items():
            column = cameras.index(camera)
            pixels[row, column] = tables[camera].centres_px[index]
            cov[row, column] = tables[camera].cov_px2[index]
    result = triangulate(
        pixels,
        [tables[camera].view.lens for camera in cameras],
        [tables[camera].view.cam_from_ref for camera in cameras],
        cov_px2=cov,
        cameras_cov=cameras_cov,
    )
    n_views = np.array([len(views) for views in chosen])
    good = ~result.inconsistent & ~result.small_angle & (result.used.sum(axis=1) == n_views)
    with np.errstate(invalid="ignore"):
        chi_square = np.where(good & np.isfinite(result.chi_square), result.chi_square, np.inf)
    return result.points_ref, result.cov_m2, chi_square


def _supported(  # noqa: PLR0917
    tables: Mapping[str, RegionTable],
    left: Mapping[str, set[int]],
    pair: Mapping[str, int],
    point: FloatArray,
    cov_m2: FloatArray,
    cost: float,
    settings: AssociationSettings,
) -> _Candidate | None:
    """Look for the pair's object in all cameras; None if the two regions differ in size."""
    radii, labs, lab_covs = [], [], []
    for camera, index in pair.items():
        table = tables[camera]
        radii.append(table.log_radius(index, point))
        labs.append(table.lab[index])
        lab_covs.append(table.lab_cov[index])
    size = (radii[0] - radii[1]) ** 2 / (2 * settings.size_sigma**2)
    if size > gate(1, settings.false_alarm):
        return None
    views, visible = dict(pair), 0
    cost += size
    for camera, table in tables.items():
        seen = table.view.look(point[None])
        if not table.view.holds(seen.pixels)[0]:
            continue
        visible += 1
        if not left[camera] or (camera in pair):
            continue
        slope = seen.d_points
        chi_square, freedom, _ = table.cost(
            pixels=seen.pixels,
            cov_px2=slope @ cov_m2 @ slope.swapaxes(1, 2),
            lab=np.mean(labs, axis=0)[None],
            lab_cov=np.mean(lab_covs, axis=0)[None] / 2,
            log_radius=np.array([np.mean(radii)]),
            radius_sigma=np.array([settings.size_sigma * np.sqrt(1.5)]),
            distance_m=seen.distance_m,
        )
        choices = sorted(left[camera])
        best = min(choices, key=lambda index: chi_square[0, index])
        if chi_square[0, best] <= gate(int(freedom[0, best]), settings.false_alarm):
            views[camera] = best
            cost += float(chi_square[0, best])
    return views, cost / len(views), visible


def _solved(
    tables: Mapping[str, RegionTable],
    cameras: Sequence[str],
    views: Mapping[str, int],
    cameras_cov: FloatArray | None,
) -> Hypothesis | None:
    """Return the object of all its views, or None if they contradict each other."""
    points, cov, chi_square = _triangulated(tables, cameras, [views], cameras_cov)
    if not np.isfinite(chi_square[0]):
        return None
    return Hypothesis(regions=views, position_ref=points[0], cov_m2=cov[0])

"""Which saddles are neighbours on a chessboard, and the patches they make.

A saddle has four rays along its two edges. Counted with the angle, an even ray has the bright
sector ahead of it and an odd one behind. Seen from the other end, ahead and behind change places:
an edge joins an even ray to an odd one. Beyond each corner the edge goes on with bright and dark
exchanged, so that no edge skips a corner.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pyramid import Pyramid
from calichrome.detection.saddles import Saddles

__all__ = ["STEPS", "Patch", "edges_hold", "grow_patches"]

STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
"""On the lattice, in the order of the rays."""

_NOBODY = -1
_N_NEAREST = 24
"""The four neighbours are among them where squares are foreshortened to a quarter (12 nearer
corners) and as many marks lie between."""
_CONTRAST_OCTAVES = 2
"""Saddles are neighbours of others of a contrast of 0.7 to 1.4 times theirs at least, up to 0.35 to
2.8 times."""
_LEAST_SPACING_PX = 3.5  # of the level: the ring of a saddle ends here
_CONE_RAD = 0.45
"""Between ray and neighbour. Blur draws the edges of acute corners apart: at 44 deg, with a PSF of
1.25 px, the rays are off by 18 deg."""
_CONE_SHARE = 0.35  # of the angle between the rays: no neighbour is in two cones

_ALONG = np.array([0.2, 0.35, 0.5, 0.65, 0.8])  # an edge: where its two sides are compared
_ASIDE = 0.12  # of its length: clear of discs of up to 0.7 of a square
_ASIDE_PX = (1.0, 2.0)  # of the level, at least and at most
_LEAST_STEP = 0.65
"""Across an edge, everywhere, of the contrast of the saddles at its ends. In a picture with acute
corners edges have 1.1 to 2.9, lines from a corner to the gap between a disc and the rim of its
square mostly 0.3 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Saddles that closed cells of four join.

    Parameters
    ----------
    members : (N,) int
        Positions in the saddles.
    indices : (N, 2) int
        (i, j) on the lattice, (0, 0) for the first; the square towards (+i, +j) of corners with an
        even sum is bright.
    """

    members: IntArray
    indices: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Links:
    """Per saddle and ray (N, 4): the neighbour, or `_NOBODY`, and its ray that returns."""

    neighbour: IntArray
    back: IntArray


def grow_patches(saddles: Saddles) -> list[Patch]:
    """Join saddles to patches, the largest first."""
    links = _link(saddles)
    return _number(links, _sides_of_cells(links))


def _link(saddles: Saddles) -> _Links:
    """Join each saddle along each ray to the nearest that fits, if both choose each other."""
    count = len(saddles)
    first, second = _near_pairs(saddles)
    points, pitch = saddles.points_px, saddles.pyramid.pitch
    level = np.maximum(saddles.level[first], saddles.level[second])
    away = points[second] - points[first]
    apart = np.linalg.norm(away, axis=1) > _LEAST_SPACING_PX * pitch(level)
    first, second, level, away = first[apart], second[apart], level[apart], away[apart]
    heading = np.arctan2(away[:, 1], away[:, 0])
    ray, miss = _nearest_ray(saddles.angles_rad[first], heading)
    back, miss_back = _nearest_ray(saddles.angles_rad[second], heading + np.pi)
    opening = saddles.angles_rad[:, 1] - saddles.angles_rad[:, 0]
    cone = np.minimum(_CONE_RAD, _CONE_SHARE * np.minimum(opening, np.pi - opening))
    fits = (miss < cone[first]) & (miss_back < cone[second]) & ((ray + back) % 2 == 1)
    first, second, ray, back, level = (part[fits] for part in (first, second, ray, back, level))
    least = _LEAST_STEP * np.minimum(saddles.contrast[first], saddles.contrast[second])
    holds = edges_hold(saddles.pyramid, points[first], points[second], ray % 2 == 0, least, level)
    first, second, ray, back = (part[holds] for part in (first, second, ray, back))
    # Pairs of one saddle are in the order of their distance
    _, nearest = np.unique(first * 4 + ray, return_index=True)
    links = _Links(np.full((count, 4), _NOBODY), np.zeros((count, 4), dtype=np.int64))
    links.neighbour[first[nearest], ray[nearest]] = second[nearest]
    links.back[first[nearest], ray[nearest]] = back[nearest]
    returns = links.neighbour[links.neighbour, links.back] == np.arange(count)[:, None]
    links.neighbour[~returns] = _NOBODY
    return links


def _near_pairs(saddles: Saddles) -> tuple[IntArray, IntArray]:
    """Pair each saddle with the nearest of similar contrast, near ones first, (P,) twice.

    Without regard to contrast the noise in a large dark square would be all that is near.
    """
    octave = np.log2(np.maximum(saddles.contrast, 1e-3))
    lowest = np.floor(octave - 0.5)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for low in np.unique(lowest).tolist():
        members = np.flatnonzero((octave >= low) & (octave < low + _CONTRAST_OCTAVES))
        asking = np.flatnonzero(lowest == low)
        n_nearest = min(_N_NEAREST + 1, len(members))
        _, near = cKDTree(saddles.points_px[members]).query(
            saddles.points_px[asking], k=np.arange(1, n_nearest + 1)
        )
        pairs.append(np.stack([np.repeat(asking, n_nearest), members[near].ravel()], axis=1))
    first, second = np.concatenate(pairs).T
    others = first != second
    return first[others], second[others]


def _nearest_ray(angles_rad: FloatArray, heading: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the ray (N,) of saddles next to a heading, and the angle between."""
    rays = np.concatenate([angles_rad, angles_rad + np.pi], axis=1)
    miss = np.abs(np.mod(heading[:, None] - rays + np.pi, 2 * np.pi) - np.pi)
    return miss.argmin(axis=1), miss.min(axis=1, initial=np.inf)


def edges_hold(
    pyramid: Pyramid,
    starts_px: FloatArray,
    ends_px: FloatArray,
    bright_ahead: BoolArray,
    least: FloatArray,
    level: IntArray,
) -> BoolArray:
    """Tell which segments are edges, bright all along one side and dark along the other.

    Parameters
    ----------
    starts_px, ends_px : (E, 2) float
    bright_ahead : (E,) bool
        Whether the bright side is the one towards growing angles, seen from the start.
    least : (E,) float
        By how much the bright side is to exceed the dark one everywhere, DN.
    level : (E,) int
        Of the pyramid.
    """
    away = ends_px - starts_px
    length = np.linalg.norm(away, axis=1)
    normal = np.stack([-away[:, 1], away[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    normal[~bright_ahead] *= -1
    pitch = pyramid.pitch(level)
    aside = np.clip(_ASIDE * length, _ASIDE_PX[0] * pitch, _ASIDE_PX[1] * pitch)
    places = starts_px[:, None] + _ALONG[:, None] * away[:, None]
    shift = (aside[:, None] * normal)[:, None]
    values = pyramid.sample(np.stack([places + shift, places - shift], axis=1), level)
    return np.asarray((values[:, 0] - values[:, 1]).min(axis=1) > least)


def _sides_of_cells(links: _Links) -> BoolArray:
    """Tell which links (N, 4) are a side of a closed cell of four."""
    count = len(links.neighbour)
    start, leaving = np.repeat(np.arange(count), 4), np.tile(np.arange(4), count)
    sides = np.zeros(4 * count, dtype=bool)
    for turn in (1, 3):
        at, ray = start, leaving
        alive = links.neighbour[at, ray] != _NOBODY
        for _ in range(4):
            following, arrived = links.neighbour[at, ray], links.back[at, ray]
            at, ray = np.where(alive, following, 0), (arrived + 2 + turn) % 4
            alive = alive & (links.neighbour[at, ray] != _NOBODY)
        sides |= alive & (at == start) & (ray == leaving)
    return sides.reshape(count, 4)


def _number(links: _Links, sides: BoolArray) -> list[Patch]:
    """Walk the sides of cells and count steps."""
    neighbour, back, holds = links.neighbour.tolist(), links.back.tolist(), sides.tolist()
    steps = STEPS.tolist()
    place: dict[int, tuple[int, int, int]] = {}  # i, j, and the ray that is +i
    patches: list[Patch] = []
    for start in np.flatnonzero(sides.any(axis=1)).tolist():
        if start in place:
            continue
        place[start] = (0, 0, 0)
        queue = [start]
        for node in queue:
            i, j, turn = place[node]
            for ray in range(4):
                other = neighbour[node][ray]
                if not holds[node][ray] or other in place:
                    continue
                heading = (ray - turn) % 4
                di, dj = steps[heading]
                place[other] = i + di, j + dj, (back[node][ray] - heading - 2) % 4
                queue.append(other)
        patches.append(_unique(queue, [place[node][:2] for node in queue]))
    return sorted(patches, key=lambda patch: -len(patch.members))


def _unique(members: list[int], indices: list[tuple[int, int]]) -> Patch:
    """Let the first keep a place that several claim."""
    places, first = np.unique(np.array(indices), axis=0, return_index=True)
    return Patch(np.array(members)[first], places)

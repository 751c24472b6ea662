"""Which saddles are neighbours on a chessboard: joined by an edge that is bright on one side.

A saddle has four rays along its two edges. Counted with the angle, a ray of kind 0 opens a bright
sector and one of kind 1 closes it. An edge that leaves one corner as kind 0 arrives at the next as
kind 1, because the squares alternate: no edge joins two rays of a kind, and none skips a corner.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pyramid import Pyramid
from calichrome.detection.saddle_points import Saddles

__all__ = ["NO_NEIGHBOUR", "Links", "edge_shows", "link_saddles", "ray_angles"]

NO_NEIGHBOUR = -1

_NEAREST = 16
"""Saddles that are tried as neighbours: the four and those of clutter, of discs and of text."""
_LARGEST_TURN = np.deg2rad(32)
"""Between a saddle's ray and its neighbour. Blur draws acute edges apart: 44 degrees look like 80,
so each seems turned by 18; noise and lens add to it."""
_PLACES = np.array([0.2, 0.35, 0.5, 0.65, 0.8])  # along an edge, where its two sides are compared
_ASIDE = 0.1  # of the edge's length: clear of discs of up to 0.7 of a square seen head on
_ASIDE_PX = 1.6  # at least, beyond the blur of the level
_FEWEST_PLACES = 4  # that must show the contrast: a disc, a glint or a finger tip may spoil one
_LEAST_CONTRAST = 0.5
"""Of the saddle's own; within a square black and white change by less than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Neighbours of N saddles.

    Parameters
    ----------
    neighbour : (N, 4) int
        Along each ray, or `NO_NEIGHBOUR`.
    arrival : (N, 4) int
        Ray of the neighbour that leads back.
    """

    neighbour: IntArray
    arrival: IntArray


def ray_angles(angles_rad: FloatArray) -> FloatArray:
    """Return the directions (N, 4) of the rays, growing: kinds 0, 1, 0, 1."""
    return np.concatenate([angles_rad, angles_rad + np.pi], axis=1)


def link_saddles(saddles: Saddles, pyramid: Pyramid) -> Links:
    """Join every saddle along each ray to the nearest that agrees, if both choose each other."""
    count = len(saddles)
    links = Links(np.full((count, 4), NO_NEIGHBOUR), np.full((count, 4), NO_NEIGHBOUR))
    if count < 2:
        return links
    rays = ray_angles(saddles.angles_rad)
    nearest = min(_NEAREST + 1, count)
    _, others = cKDTree(saddles.points_px).query(saddles.points_px, k=nearest)
    others = others[:, 1:]
    offset = saddles.points_px[others] - saddles.points_px[:, None]
    heading = np.arctan2(offset[..., 1], offset[..., 0])
    leave = np.abs(_wrapped(heading[:, None] - rays[:, :, None])) < _LARGEST_TURN
    source, ray, column = np.nonzero(leave)
    goal = others[source, column]
    # The ray of the other kind that points back.
    back = np.abs(_wrapped(heading[source, column, None] + np.pi - rays[goal]))
    back[np.arange(4) % 2 == (ray % 2)[:, None]] = np.inf
    arrival = back.argmin(axis=1)
    fits = back.min(axis=1, initial=np.inf) < _LARGEST_TURN
    source, ray, goal, arrival = (part[fits] for part in (source, ray, goal, arrival))
    shows = edge_shows(
        saddles.points_px[source],
        saddles.points_px[goal],
        np.where(ray % 2 == 0, 1.0, -1.0),
        np.minimum(saddles.contrast[source], saddles.contrast[goal]),
        np.maximum(saddles.level[source], saddles.level[goal]),
        pyramid,
    )
    source, ray, goal, arrival = (part[shows] for part in (source, ray, goal, arrival))
    length = np.linalg.norm(saddles.points_px[goal] - saddles.points_px[source], axis=1)
    order = np.argsort(-length, kind="stable")  # the nearest is written last
    source, ray, goal, arrival = (part[order] for part in (source, ray, goal, arrival))
    links.neighbour[source, ray] = goal
    links.arrival[source, ray] = arrival
    mutual = links.neighbour != NO_NEIGHBOUR
    at, along = np.nonzero(mutual)
    there, returning = links.neighbour[at, along], links.arrival[at, along]
    mutual[at, along] = (links.neighbour[there, returning] == at) & (
        links.arrival[there, returning] == along
    )
    links.neighbour[~mutual] = links.arrival[~mutual] = NO_NEIGHBOUR
    return links


def edge_shows(
    starts_px: FloatArray,
    ends_px: FloatArray,
    bright_side: FloatArray,
    contrast: FloatArray,
    level: IntArray,
    pyramid: Pyramid,
) -> BoolArray:
    """Tell which segments are edges, bright all along one side.

    Parameters
    ----------
    starts_px, ends_px : (E, 2) float
    bright_side : (E,) float
        1 where the side towards growing angles is bright, seen from the start; -1 otherwise.
    contrast : (E,) float
        Of the saddles at the ends, half a step from black to white.
    level : (E,) int
        Of the pyramid, where the saddles were found.
    """
    along = ends_px - starts_px
    length = np.linalg.norm(along, axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    least = _ASIDE_PX * pyramid.reduction * 2.0**level
    aside = np.minimum(np.maximum(_ASIDE * length, least), 0.25 * length)
    places = starts_px[:, None] + _PLACES[:, None] * along[:, None]
    shift = (aside[:, None] * normal)[:, None]
    step = pyramid.sample(places + shift, level) - pyramid.sample(places - shift, level)
    enough = step * bright_side[:, None] > _LEAST_CONTRAST * contrast[:, None]
    return np.asarray(enough.sum(axis=1) >= _FEWEST_PLACES)


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)

"""Lattices grown from squares of linked saddles, a ring of corners at a time.

Squares of four links seed a part; what the corners around a gap predict is looked for among the
saddles there, and taken if an edge joins it.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.pyramid import Pyramid
from calichrome.detection.saddle_links import (
    NO_NEIGHBOUR,
    edge_shows,
    link_saddles,
    ray_angles,
)
from calichrome.detection.saddle_points import Saddles, find_saddles

__all__ = ["SMALL", "STEPS", "Growth", "Part", "find_rows"]

STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
"""Of the lattice along ray 0 to 3 of a saddle whose first ray is +i."""
SMALL = 6  # corners: fewer are no board
_OFF_PREDICTION = 0.25
"""Of the distance to the neighbour: how far from its prediction a corner is looked for."""
_BOARD = 20  # corners that are a board, not clutter
_REACH = 3  # places beside a part that its lines may reach, and what np.roll needs
_STRETCH = (0.5, 2.0)  # of a step to the one before, at most, however steep the view
_LARGEST_TURN = np.deg2rad(35)  # between a ray and its neighbour; the place is known already
_ROUNDS = 12  # of growing, each by a ring of corners


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Corners with places on one lattice.

    Parameters
    ----------
    saddles : (N,) int
        Which points.
    indices : (N, 2) int
        (i, j), from anywhere.
    turn : (N,) int
        The ray of each that points along +i.
    """

    saddles: IntArray
    indices: IntArray
    turn: IntArray

    def __len__(self) -> int:
        return len(self.saddles)

    def only(self, chosen: BoolArray) -> "Part":
        """Return the chosen ones."""
        return Part(self.saddles[chosen], self.indices[chosen], self.turn[chosen])

    def joined(self, other: "Part") -> "Part":
        """Return both."""
        return Part(
            np.concatenate([self.saddles, other.saddles]),
            np.concatenate([self.indices, other.indices]),
            np.concatenate([self.turn, other.turn]),
        )


class Growth:
    """The saddles of a picture, and how they grow together.

    Attributes
    ----------
    saddles, pyramid
        What is grown, and where it is looked at.
    rays : (N, 4) float
        Directions of the rays of each saddle.
    """

    def __init__(self, pyramid: Pyramid) -> None:
        self.pyramid = pyramid
        self.saddles: Saddles = find_saddles(pyramid)
        self.rays = ray_angles(self.saddles.angles_rad)
        self._links = link_saddles(self.saddles, pyramid)
        self._points = self.saddles.points_px
        self._tree = cKDTree(self._points.reshape(-1, 2))

    def parts(self) -> list[Part]:
        """Return all that grows in this picture."""
        return self._grown_apart(self._seeds())

    def _seeds(self) -> list[Part]:
        """Connect saddles over links that are sides of closed squares."""
        firm = self._sides_of_squares()
        seen = np.zeros(len(self.saddles), dtype=bool)
        parts = []
        for start in np.argsort(-firm.sum(axis=1), kind="stable"):
            if not seen[start] and firm[start].any():
                parts.append(self._spread(int(start), firm, seen))  # noqa: PERF401 (marks `seen`)
        return parts

    def _sides_of_squares(self) -> BoolArray:
        """Mark links (N, 4) from which three more links lead back around a square."""
        neighbour, arrival = self._links.neighbour, self._links.arrival
        firm = np.zeros(neighbour.shape, dtype=bool)
        for turn in (1, -1):
            at, ray = np.nonzero(neighbour != NO_NEIGHBOUR)
            here, along = at, ray
            trail = []
            for _ in range(4):
                trail.append((here, along))
                there, back = neighbour[here, along], arrival[here, along]
                valid = there != NO_NEIGHBOUR
                at, ray, there, back = at[valid], ray[valid], there[valid], back[valid]
                trail = [(a[valid], b[valid]) for a, b in trail]
                here, along = there, (back + turn) % 4
            closed = (here == at) & (along == ray)
            for a, b in trail:
                firm[a[closed], b[closed]] = True
                firm[neighbour[a[closed], b[closed]], arrival[a[closed], b[closed]]] = True
        return firm

    def _spread(self, start: int, firm: BoolArray, seen: BoolArray) -> Part:
        """Walk the links from one saddle, nearest first; what contradicts is left out."""
        place: dict[int, tuple[int, int, int]] = {start: (0, 0, 0)}
        taken = {(0, 0)}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            i, j, turn = place[here]
            for ray in np.flatnonzero(firm[here]):
                there = int(self._links.neighbour[here, ray])
                step = (ray - turn) % 4
                di, dj = STEPS[step]
                cell = int(i + di), int(j + dj)
                if there in place or cell in taken:
                    continue
                back = int(self._links.arrival[here, ray])
                place[there] = *cell, int(back - step - 2) % 4
                taken.add(cell)
                queue.append(there)
        members = np.array(list(place), dtype=np.int64)
        seen[members] = True
        values = np.array(list(place.values()), dtype=np.int64)
        return Part(members, values[:, :2], values[:, 2])

    def _grown_apart(self, seeds: list[Part]) -> list[Part]:
        """Grow seeds, the largest first, unless a grown part has reached them.

        Beside a board the smallest are clutter, or pieces of it that need no growing to join.
        """
        used = np.zeros(len(self.saddles), dtype=bool)
        parts: list[Part] = []
        for seed in sorted(seeds, key=len, reverse=True):
            beside = bool(parts) and len(parts[0]) >= _BOARD and len(seed) < SMALL
            part = seed if beside or used[seed.saddles].any() else self.grown(seed)
            if not used[part.saddles].all():
                parts.append(part)
            used[part.saddles] = True
        return parts

    def grown(self, part: Part) -> Part:
        """Add saddles where the corners around predict one."""
        for _ in range(_ROUNDS):
            cells, predicted, reach = self._predictions(part)
            if not len(cells):
                break
            added = self._matching(part, cells, predicted, reach)
            if not len(added):
                break
            part = part.joined(added)
        return part

    def _predictions(self, part: Part) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return empty places beside corners, where they should be, and how far to look."""
        origin = part.indices.min(axis=0) - _REACH
        extent = np.ptp(part.indices, axis=0) + 1 + 2 * _REACH
        points = np.full((*extent, 2), np.nan)
        points[tuple((part.indices - origin).T)] = self._points[part.saddles]
        total, length, count = np.zeros_like(points), np.zeros(extent), np.zeros(extent)
        for step in STEPS:
            one, two, three = (np.roll(points, tuple(k * step), axis=(0, 1)) for k in (1, 2, 3))
            guess = 2 * one - two
            on_line = _next_on_line(three, two, one)
            guess = np.where(np.isnan(on_line), guess, on_line)
            known = ~np.isnan(guess[..., 0])
            total[known] += guess[known]
            length[known] += np.linalg.norm((one - two)[known], axis=1)
            count += known
        empty = np.isnan(points[..., 0]) & (count > 0)
        cells = np.argwhere(empty)
        mean = total[empty] / count[empty][:, None]
        return cells + origin, mean, _OFF_PREDICTION * length[empty] / count[empty]

    def _matching(
        self, part: Part, cells: IntArray, predicted: FloatArray, reach: FloatArray
    ) -> Part:
        """Take the saddles at predicted places whose rays fit and that an edge joins."""
        distance, saddle = self._tree.query(predicted)
        # Each saddle for the place that it is nearest to, if it is free.
        order = np.lexsort((distance, saddle))
        first = np.append(True, np.diff(saddle[order]) > 0)
        best = order[first]
        free = ~np.isin(saddle[best], part.saddles) & (distance[best] <= reach[best])
        cells, saddle = cells[best[free]], saddle[best[free]]
        turn = np.full(len(cells), -1)
        for step, offset in enumerate(STEPS):
            open_ = np.flatnonzero(turn < 0)
            beside = find_rows(part.indices, cells[open_] + offset)
            own = open_[beside >= 0]
            turn[own] = self._turns(part, beside[beside >= 0], saddle[own], step)
        joined = turn >= 0
        return Part(saddle[joined], cells[joined], turn[joined])

    def _turns(self, part: Part, beside: IntArray, saddle: IntArray, step: int) -> IntArray:
        """Return the rays of saddles that are +i, told by the edge to a neighbour; else -1.

        The neighbours lie in direction `step`. Their rays back and the saddles' rays to them are
        of different kinds.
        """
        if not len(saddle):
            return np.empty(0, dtype=np.int64)
        other = part.saddles[beside]
        towards = part.turn[beside] + step + 2
        offset = self._points[other] - self._points[saddle]
        heading = np.arctan2(offset[:, 1], offset[:, 0])
        off = np.abs((self.rays[saddle] - heading[:, None] + np.pi) % (2 * np.pi) - np.pi)
        off[np.arange(4) % 2 == (towards % 2)[:, None]] = np.inf
        ray = off.argmin(axis=1)
        shows = edge_shows(
            self._points[saddle],
            self._points[other],
            np.where(ray % 2 == 0, 1.0, -1.0),
            np.minimum(self.saddles.contrast[saddle], self.saddles.contrast[other]),
            np.maximum(self.saddles.level[saddle], self.saddles.level[other]),
            self.pyramid,
        )
        shows &= off.min(axis=1) < _LARGEST_TURN
        return np.where(shows, (ray - step) % 4, -1)


def _next_on_line(p0: FloatArray, p1: FloatArray, p2: FloatArray) -> FloatArray:
    """Continue equal steps on lines seen in perspective, points (..., 2).

    Steps d1, d2 and d3 of a line with equal steps have the cross ratio
    (d1 + d2) (d2 + d3) / (d2 (d1 + d2 + d3)) = 4 / 3, so d3 = d2 (d1 + d2) / (3 d1 - d2).
    """
    d1, d2 = np.linalg.norm(p1 - p0, axis=-1), np.linalg.norm(p2 - p1, axis=-1)
    longer = (d1 + d2) / np.maximum(3 * d1 - d2, 1e-9)  # d3 / d2
    return np.asarray(p2 + (p2 - p1) * np.clip(longer, *_STRETCH)[..., None])


def find_rows(table: IntArray, rows: IntArray) -> IntArray:
    """Return where rows (M, 2) stand in a table (N, 2), -1 where they do not."""
    low = np.minimum(table.min(axis=0), rows.min(axis=0, initial=table.min()))
    span = int(max(table.max(), rows.max(initial=table.max())) - low.min()) + 1
    keys, wanted = ((part - low) @ [1, span] for part in (table, rows))
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    return np.where(keys[order[at]] == wanted, order[at], -1)

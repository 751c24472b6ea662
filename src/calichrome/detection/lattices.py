"""Chessboards grown from saddles: which corners belong together, and where each stands in the grid.

Links join neighbours (`saddle_links`); squares of four links seed lattices; what is predicted from
the corners around a gap is searched there; parts that one map explains, on both sides of a hand,
join.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import BoardMap
from calichrome.detection.pyramid import Plane, Pyramid, build_pyramid
from calichrome.detection.saddle_links import (
    NO_NEIGHBOUR,
    Links,
    edge_shows,
    link_saddles,
    ray_angles,
)
from calichrome.detection.saddle_points import Saddles, find_saddles

__all__ = ["Lattice", "find_lattices"]

_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
"""Of the lattice along ray 0 to 3 of a saddle whose first ray is +i."""
_FEWEST_CORNERS = 6
_SMALLEST_SIDE = 3
_OFF_PREDICTION = 0.25
"""Of the distance to the neighbour: how far from its prediction a corner is looked for."""
_OFF_MAP, _OFF_MAP_PX = 0.03, 0.8
"""Of a square, and at least: farther from the map of the others a corner is not one of them. True
corners are off by up to 0.45 px, what the rim of a hand makes of an edge by 1.5 to 3.5 px."""
_ISLANDS = 3  # squares beyond a part that its map is trusted to
_ISLAND_TURN = np.deg2rad(20)
_OFF_ISLAND = 0.1  # of a square; once it belongs to them, its place must fit like any other
_BOARD = 20  # corners that are a board, not clutter
_NEWTON_STEPS = 5  # to a hundredth of a square from three squares away, at a tilt of 60 degrees
_FARTHEST_FIRST = 0.5  # of the largest excess: corners beyond go at once, nearer ones later
_FEWEST_TO_PREDICT = 12  # corners whose map may be believed beyond a gap
_JOINS = 0.2  # of a square: parts join where the map of one meets the corners of the other
_BESIDE_CORNER = 0.18
"""Of a square, along both edges, where the four squares of a corner are looked at: clear of discs
of up to 0.8 and of most blur."""
_QUADRANTS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
_LEAST_STEP = 0.3  # from black to white across a corner, of the median over the board
_REACH = 3  # places beside a part that its lines may reach, and what np.roll needs
_STRETCH = (0.5, 2.0)  # of a step to the one before, at most, however steep the view
_LARGEST_TURN = np.deg2rad(35)  # between a ray and its neighbour; the place is known already
_ROUNDS = 12  # of growing, each by a ring of corners


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Corners of one chessboard, or of the part of it that is seen.

    Parameters
    ----------
    indices : (N, 2) int
        (i, j) of every corner, from (0, 0); the turn from +i to +j is that from x to y.
    corners_px : (N, 2) float
        To about a third of a pixel.
    black_parity
        The square between (i, j) and (i + 1, j + 1) is black where (i + j) % 2 is this.
    board_map
        Lattice coordinates to pixels, by homography and radial distortion.
    """

    indices: IntArray
    corners_px: FloatArray
    black_parity: int
    board_map: BoardMap

    def __len__(self) -> int:
        return len(self.indices)


@dataclass(slots=True, eq=False)
class _Part:
    """Saddles with places: `turn` is the ray that points along +i."""

    saddles: IntArray
    indices: IntArray
    turn: IntArray

    def __len__(self) -> int:
        return len(self.saddles)


def find_lattices(grey: Plane) -> list[Lattice]:
    """Find chessboards, the largest first.

    Parameters
    ----------
    grey : (H, W) float32, 0..255

    Returns
    -------
    list of Lattice
        Of 3x3 corners at least; each a board or a part of one.
    """
    pyramid = build_pyramid(grey)
    saddles = find_saddles(pyramid)
    links = link_saddles(saddles, pyramid)
    size_wh = grey.shape[1], grey.shape[0]
    search = _Search(saddles, links, pyramid, size_wh)
    parts = search.joined(search.grown_apart(search.seeds()))
    found: list[Lattice] = []
    for part in parts:
        lattice = search.lattice(part)
        if lattice is not None and not any(_overlap(lattice, other) for other in found):
            found.append(lattice)
    return sorted(found, key=len, reverse=True)


def _overlap(one: Lattice, other: Lattice) -> bool:
    """Tell whether two lattices share a corner: then they are one, found twice."""
    distance, _ = cKDTree(other.corners_px).query(one.corners_px)
    return bool(distance.min() < 1.0)


class _Search:
    def __init__(
        self, saddles: Saddles, links: Links, pyramid: Pyramid, size_wh: tuple[int, int]
    ) -> None:
        self.saddles, self.links, self.pyramid, self.size_wh = saddles, links, pyramid, size_wh
        self.rays = ray_angles(saddles.angles_rad)
        self.points = saddles.points_px
        self.tree = cKDTree(self.points.reshape(-1, 2))

    def seeds(self) -> list[_Part]:
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
        neighbour, arrival = self.links.neighbour, self.links.arrival
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

    def _spread(self, start: int, firm: BoolArray, seen: BoolArray) -> _Part:
        """Walk the links from one saddle, nearest first; what contradicts is left out."""
        place: dict[int, tuple[int, int, int]] = {start: (0, 0, 0)}
        taken = {(0, 0)}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            i, j, turn = place[here]
            for ray in np.flatnonzero(firm[here]):
                there = int(self.links.neighbour[here, ray])
                step = (ray - turn) % 4
                di, dj = _STEPS[step]
                cell = int(i + di), int(j + dj)
                if there in place or cell in taken:
                    continue
                back = int(self.links.arrival[here, ray])
                place[there] = *cell, int(back - step - 2) % 4
                taken.add(cell)
                queue.append(there)
        members = np.array(list(place), dtype=np.int64)
        seen[members] = True
        values = np.array(list(place.values()), dtype=np.int64)
        return _Part(members, values[:, :2], values[:, 2])

    def grown_apart(self, seeds: list[_Part]) -> list[_Part]:
        """Grow seeds, the largest first, unless a grown part has reached them.

        Beside a board the smallest are clutter, or pieces of it that need no growing to join.
        """
        used = np.zeros(len(self.saddles), dtype=bool)
        parts: list[_Part] = []
        for seed in sorted(seeds, key=len, reverse=True):
            beside = bool(parts) and len(parts[0]) >= _BOARD and len(seed) < _FEWEST_CORNERS
            part = seed if beside or used[seed.saddles].any() else self.grown(seed)
            if not used[part.saddles].all():
                parts.append(part)
            used[part.saddles] = True
        return parts

    def grown(self, part: _Part) -> _Part:
        """Add saddles where the corners around predict one."""
        for _ in range(_ROUNDS):
            cells, predicted, reach = self._predictions(part)
            if not len(cells):
                break
            added = self._matching(part, cells, predicted, reach)
            if not len(added):
                break
            part = _Part(
                np.concatenate([part.saddles, added.saddles]),
                np.concatenate([part.indices, added.indices]),
                np.concatenate([part.turn, added.turn]),
            )
        return part

    def _predictions(self, part: _Part) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return empty places beside corners, where they should be, and how far to look."""
        origin = part.indices.min(axis=0) - _REACH
        extent = np.ptp(part.indices, axis=0) + 1 + 2 * _REACH
        points = np.full((*extent, 2), np.nan)
        points[tuple((part.indices - origin).T)] = self.points[part.saddles]
        total, length, count = np.zeros_like(points), np.zeros(extent), np.zeros(extent)
        for step in _STEPS:
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
        self, part: _Part, cells: IntArray, predicted: FloatArray, reach: FloatArray
    ) -> _Part:
        """Take the saddles at predicted places whose rays fit and that an edge joins."""
        distance, saddle = self.tree.query(predicted)
        # Each saddle for the place that it is nearest to, if it is free.
        order = np.lexsort((distance, saddle))
        first = np.append(True, np.diff(saddle[order]) > 0)
        best = order[first]
        free = ~np.isin(saddle[best], part.saddles) & (distance[best] <= reach[best])
        cells, saddle = cells[best[free]], saddle[best[free]]
        turn = np.full(len(cells), -1)
        for step, offset in enumerate(_STEPS):
            open_ = np.flatnonzero(turn < 0)
            beside = _find_rows(part.indices, cells[open_] + offset)
            own = open_[beside >= 0]
            turn[own] = self._turns(part, beside[beside >= 0], saddle[own], step)
        joined = turn >= 0
        return _Part(saddle[joined], cells[joined], turn[joined])

    def _turns(self, part: _Part, beside: IntArray, saddle: IntArray, step: int) -> IntArray:
        """Return the rays of saddles that are +i, told by the edge to a neighbour; else -1.

        The neighbours lie in direction `step`. Their rays back and the saddles' rays to them are
        of different kinds.
        """
        if not len(saddle):
            return np.empty(0, dtype=np.int64)
        other = part.saddles[beside]
        towards = part.turn[beside] + step + 2
        offset = self.points[other] - self.points[saddle]
        heading = np.arctan2(offset[:, 1], offset[:, 0])
        off = np.abs((self.rays[saddle] - heading[:, None] + np.pi) % (2 * np.pi) - np.pi)
        off[np.arange(4) % 2 == (towards % 2)[:, None]] = np.inf
        ray = off.argmin(axis=1)
        shows = edge_shows(
            self.points[saddle],
            self.points[other],
            np.where(ray % 2 == 0, 1.0, -1.0),
            np.minimum(self.saddles.contrast[saddle], self.saddles.contrast[other]),
            np.maximum(self.saddles.level[saddle], self.saddles.level[other]),
            self.pyramid,
        )
        shows &= off.min(axis=1) < _LARGEST_TURN
        return np.where(shows, (ray - step) % 4, -1)

    def joined(self, parts: list[_Part]) -> list[_Part]:
        """Join parts that the map of a larger one explains; of overlapping ones keep the larger."""
        parts = sorted(parts, key=len, reverse=True)
        done: list[_Part] = []
        while parts:
            first, *rest = parts
            both = self._first_join(first, rest)
            if both is not None:  # a larger part explains more: start again with it
                joined, other = both
                parts = [self.grown(joined), *(part for part in rest if part is not other)]
                continue
            done.append(first)
            parts = [part for part in rest if not np.isin(part.saddles, first.saddles).any()]
        return done

    def _first_join(self, first: _Part, rest: list[_Part]) -> tuple[_Part, _Part] | None:
        if not rest or len(first) < _FEWEST_TO_PREDICT:
            return None
        theirs = np.unique(np.concatenate([other.saddles for other in rest]))
        where = np.full((len(self.points), 2), np.nan)
        where[theirs] = _inverse(self._map(first), self.points[theirs], first.indices)
        for other in rest:
            both = self._join(first, other, where)
            if both is not None:
                return both, other
        return None

    def _join(self, first: _Part, other: _Part, all_where: FloatArray) -> _Part | None:
        fresh = ~np.isin(other.saddles, first.saddles)
        if not fresh.any():
            return None
        where = all_where[other.saddles]
        nearest = np.rint(where)
        if not (np.abs(where - nearest) < _JOINS).all():
            return None
        places = nearest.astype(np.int64)
        # How the other part's axes lie in the first one's: some quarter turn explains all places.
        for quarter in range(4):
            turned = _quarter_turned(other.indices, quarter)
            shift = places - turned
            if (shift == shift[0]).all() and (_find_rows(first.indices, places[fresh]) < 0).all():
                turn = (other.turn - quarter) % 4
                if not self._same_colours(first, places, turn):
                    return None
                return _Part(
                    np.concatenate([first.saddles, other.saddles[fresh]]),
                    np.concatenate([first.indices, places[fresh]]),
                    np.concatenate([first.turn, turn[fresh]]),
                )
        return None

    def _same_colours(self, first: _Part, places: IntArray, turn: IntArray) -> bool:
        """Tell whether black squares of both parts fall on one parity."""
        parity = (first.indices.sum(axis=1) + first.turn) % 2
        others = (places.sum(axis=1) + turn) % 2
        return bool((others == np.rint(parity.mean())).all())

    def lattice(self, part: _Part) -> Lattice | None:
        """Return the corners of a part that one smooth map explains, None if too few are left."""
        if not _is_large(part):
            return None
        cleaned, board_map = self._without_strays(part)
        if _FEWEST_CORNERS <= len(cleaned) < len(part):
            # A stray may have sat where a corner belongs.
            cleaned, board_map = self._without_strays(self.grown(cleaned))
        if len(cleaned) < _FEWEST_CORNERS or board_map is None:
            return None
        islands = self._with_islands(cleaned, board_map)
        if len(islands) > len(cleaned):
            cleaned, board_map = self._without_strays(self.grown(islands))
            if board_map is None:
                return None
        part = self._alternating(self._filled(cleaned, board_map), board_map)
        if not _is_large(part):
            return None
        origin = part.indices.min(axis=0)
        indices = part.indices - origin
        # Ray 0 opens a bright sector: with an even turn the square towards (+i, +j) is white.
        white = part.turn % 2 == 0
        parities = (indices.sum(axis=1) + white) % 2
        return Lattice(
            indices=indices,
            corners_px=self.points[part.saddles],
            black_parity=int(np.rint(parities.mean())),
            board_map=replace(board_map, origin=board_map.origin - origin),
        )

    def _with_islands(self, part: _Part, board_map: BoardMap) -> _Part:
        """Add saddles that no edge joins, between fingers, if place and directions fit the map."""
        if len(part) < _FEWEST_TO_PREDICT:
            return part
        others = np.setdiff1d(np.arange(len(self.saddles)), part.saddles)
        where = _inverse(board_map, self.points[others], part.indices)
        cells = np.rint(where).astype(np.int64)
        low, high = part.indices.min(axis=0) - _ISLANDS, part.indices.max(axis=0) + _ISLANDS
        near = (np.abs(where - cells) < _OFF_ISLAND).all(axis=1)
        near &= ((cells >= low) & (cells <= high)).all(axis=1)
        near &= _find_rows(part.indices, cells) < 0
        others, cells = others[near], cells[near]
        jacobian = board_map.jacobian(cells.astype(np.float64))
        heading = np.arctan2(jacobian[:, 1], jacobian[:, 0])  # of +i and +j
        off = np.abs((self.rays[others, None] - heading[:, :, None] + np.pi) % (2 * np.pi) - np.pi)
        turn = off[:, 0].argmin(axis=1)
        next_ray = (turn + 1) % 4
        fits = (off[:, 0].min(axis=1) < _ISLAND_TURN) & (
            off[np.arange(len(others)), 1, next_ray] < _ISLAND_TURN
        )
        parity = np.rint(((part.indices.sum(axis=1) + part.turn) % 2).mean())
        fits &= (cells.sum(axis=1) + turn) % 2 == parity
        others, cells, turn = others[fits], cells[fits], turn[fits]
        _, first = np.unique(cells, axis=0, return_index=True)
        islands = _Part(others[first], cells[first], turn[first])
        if not len(islands):
            return part
        # Far out a stray would bend the map, so it must look like a corner before it belongs.
        islands = self._alternating(islands, board_map, like=part)
        return _Part(
            np.concatenate([part.saddles, islands.saddles]),
            np.concatenate([part.indices, islands.indices]),
            np.concatenate([part.turn, islands.turn]),
        )

    def _filled(self, part: _Part, board_map: BoardMap) -> _Part:
        """Add corners that are no clear saddles, where edges of two directions meet."""
        if len(part) < _FEWEST_TO_PREDICT:
            return part
        at = {(i, j): k for k, (i, j) in enumerate(part.indices.tolist())}
        around = (part.indices[:, None] + _STEPS).reshape(-1, 2)
        cells, count = np.unique(around, axis=0, return_counts=True)
        empty = [cell for cell in cells[count >= 2].tolist() if tuple(cell) not in at]
        if not empty:
            return part
        places = board_map(np.array(empty, dtype=np.float64))
        added = [
            (cell, place, turn)
            for cell, place in zip(empty, places, strict=True)
            if (turn := self._turn_where_edges_meet(part, at, cell, place)) is not None
        ]
        if not added:
            return part
        first = len(self.points)
        self.points = np.concatenate([self.points, [place for _, place, _ in added]])
        return _Part(
            np.concatenate([part.saddles, np.arange(first, len(self.points))]),
            np.concatenate([part.indices, [cell for cell, _, _ in added]]),
            np.concatenate([part.turn, [turn for _, _, turn in added]]),
        )

    def _turn_where_edges_meet(
        self, part: _Part, at: dict[tuple[int, int], int], cell: list[int], place: FloatArray
    ) -> int | None:
        """Return the turn of a corner at a place that edges from all its neighbours reach."""
        beside = [
            (step, at[cell[0] + di, cell[1] + dj])
            for step, (di, dj) in enumerate(_STEPS.tolist())
            if (cell[0] + di, cell[1] + dj) in at
        ]
        if len({step % 2 for step, _ in beside}) < 2:
            return None
        steps, neighbours = np.array(beside).T
        own = part.saddles[neighbours]
        if (own >= len(self.saddles)).any():
            return None
        rays = (part.turn[neighbours] + steps + 2) % 4
        shows = edge_shows(
            self.points[own],
            np.broadcast_to(place, (len(own), 2)),
            np.where(rays % 2 == 0, 1.0, -1.0),
            self.saddles.contrast[own],
            self.saddles.level[own],
            self.pyramid,
        )
        # Kinds of rays alternate along an edge: the turn differs by one from the neighbour's.
        return int(part.turn[neighbours[0]] + 1) % 4 if shows.all() else None

    def _alternating(self, part: _Part, board_map: BoardMap, like: _Part | None = None) -> _Part:
        """Keep corners whose four squares are black and white in turn, close to the corner.

        At the rim of the board and of a hand edges may meet as well, but not in four squares.
        """
        step = self._steps(part, board_map)
        usual = step if like is None else self._steps(like, board_map)
        keep = step > _LEAST_STEP * np.median(usual)
        return _Part(part.saddles[keep], part.indices[keep], part.turn[keep])

    def _steps(self, part: _Part, board_map: BoardMap) -> FloatArray:
        """Return by how much the darker white square at a corner outshines the brighter black."""
        away = _BESIDE_CORNER * board_map.jacobian(part.indices.astype(np.float64))
        points = self.points[part.saddles]
        places = points[:, None] + np.einsum("nij,qj->nqi", away, _QUADRANTS)
        levels = self.pyramid.sample(places, 0).astype(np.float64)
        white_first = (part.turn % 2 == 0)[:, None]  # the square towards (+i, +j)
        white = np.where(white_first, levels[:, [0, 2]], levels[:, [1, 3]])
        black = np.where(white_first, levels[:, [1, 3]], levels[:, [0, 2]])
        return np.asarray(white.min(axis=1) - black.max(axis=1))

    def _map(self, part: _Part) -> BoardMap:
        return BoardMap.fit(
            part.indices.astype(np.float64),
            self.points[part.saddles],
            self.size_wh,
            lens_only=True,
        )

    def _without_strays(self, part: _Part) -> tuple[_Part, BoardMap | None]:
        """Drop corners off the map of the others, the farthest first: it bends the map most.

        Returns the part and its map, None if too few are left for one.
        """
        while len(part) >= _FEWEST_CORNERS:
            lattice = part.indices.astype(np.float64)
            board_map = self._map(part)
            off = np.linalg.norm(board_map(lattice) - self.points[part.saddles], axis=1)
            side = np.abs(np.linalg.det(board_map.jacobian(lattice))) ** 0.5
            excess = off / np.maximum(_OFF_MAP * side, _OFF_MAP_PX)
            if excess.max() <= 1:
                return part, board_map
            keep = excess < max(1.0, _FARTHEST_FIRST * excess.max())
            part = _Part(part.saddles[keep], part.indices[keep], part.turn[keep])
        return part, None


def _is_large(part: _Part) -> bool:
    """Tell whether a part may be returned: less than that, textures show as well."""
    return (
        len(part) >= _FEWEST_CORNERS
        and int(np.ptp(part.indices, axis=0).min()) + 1 >= _SMALLEST_SIDE
    )


def _next_on_line(p0: FloatArray, p1: FloatArray, p2: FloatArray) -> FloatArray:
    """Continue equal steps on lines seen in perspective, points (..., 2).

    Steps d1, d2 and d3 of a line with equal steps have the cross ratio
    (d1 + d2) (d2 + d3) / (d2 (d1 + d2 + d3)) = 4 / 3, so d3 = d2 (d1 + d2) / (3 d1 - d2).
    """
    d1, d2 = np.linalg.norm(p1 - p0, axis=-1), np.linalg.norm(p2 - p1, axis=-1)
    longer = (d1 + d2) / np.maximum(3 * d1 - d2, 1e-9)  # d3 / d2
    return np.asarray(p2 + (p2 - p1) * np.clip(longer, *_STRETCH)[..., None])


def _find_rows(table: IntArray, rows: IntArray) -> IntArray:
    """Return where rows (M, 2) stand in a table (N, 2), -1 where they do not."""
    low = np.minimum(table.min(axis=0), rows.min(axis=0, initial=table.min()))
    span = int(max(table.max(), rows.max(initial=table.max())) - low.min()) + 1
    keys, wanted = ((part - low) @ [1, span] for part in (table, rows))
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    return np.where(keys[order[at]] == wanted, order[at], -1)


def _quarter_turned(indices: IntArray, quarters: int) -> IntArray:
    """Turn lattice coordinates by quarters, +i towards +j."""
    for _ in range(quarters):
        indices = np.stack([-indices[:, 1], indices[:, 0]], axis=1)
    return indices


def _inverse(board_map: BoardMap, points: FloatArray, near: IntArray) -> FloatArray:
    """Return lattice coordinates of pixels by Newton's method from the nearest corner."""
    mapped = board_map(near.astype(np.float64))
    _, nearest = cKDTree(mapped).query(points)
    at = near[nearest].astype(np.float64)
    for _ in range(_NEWTON_STEPS):
        off = points - board_map(at)
        step = np.linalg.solve(board_map.jacobian(at), off[..., None])[..., 0]
        at = at + np.clip(step, -2, 2)
    return np.asarray(at)

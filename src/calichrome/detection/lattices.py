"""Chessboards in a picture: which corners belong together, and where each stands in the grid.

Saddles (`saddle_points`) are linked along edges (`saddle_links`) and grown into parts (`growth`).
Parts that one smooth map explains, on both sides of a hand, join; corners that it does not explain
go; and what it predicts is looked for once more.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import BoardMap
from calichrome.detection.growth import SMALL, STEPS, Growth, Part, find_rows
from calichrome.detection.pyramid import Plane, build_pyramid
from calichrome.detection.saddle_links import edge_shows

__all__ = ["Lattice", "find_lattices"]

_SMALLEST_SIDE = 3  # corners
_OFF_MAP, _OFF_MAP_PX = 0.03, 0.8
"""Of a square, and at least: farther from the map of the others a corner is not one of them. True
corners are off by up to 0.45 px, what the rim of a hand makes of an edge by 1.5 to 3.5 px."""
_ISLANDS = 1  # squares beyond a part; farther out the map fits clutter by chance
_ISLAND_TURN = np.deg2rad(20)
_OFF_ISLAND = 0.1  # of a square; once it belongs to them, its place must fit like any other
_NEWTON_STEPS = 5  # to a hundredth of a square from three squares away, at a tilt of 60 degrees
_FLAT_PX2 = 1e-6  # of a square, where a map folds
_FARTHEST_FIRST = 0.5  # of the largest excess: corners beyond go at once, nearer ones later
_FEWEST_TO_PREDICT = 12  # corners whose map may be believed beyond a gap
_JOINS = 0.2  # of a square: parts join where the map of one meets the corners of the other
_BESIDE_CORNER = 0.18
"""Of a square, along both edges, where the four squares of a corner are looked at: clear of discs
of up to 0.8 and of most blur."""
_QUADRANTS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
_LEAST_STEP = 0.3  # from black to white across a corner, of the median over the board


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

    def only(self, chosen: BoolArray) -> "Lattice":
        """Return the chosen corners, numbered from (0, 0) again."""
        origin = self.indices[chosen].min(axis=0)
        return Lattice(
            indices=self.indices[chosen] - origin,
            corners_px=self.corners_px[chosen],
            black_parity=(self.black_parity + int(origin.sum())) % 2,
            board_map=replace(self.board_map, origin=self.board_map.origin - origin),
        )


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
    growth = Growth(build_pyramid(grey))
    search = _Search(growth, (grey.shape[1], grey.shape[0]))
    found: list[Lattice] = []
    for part in search.joined(growth.parts()):
        lattice = search.lattice(part)
        if lattice is not None and not any(_overlap(lattice, other) for other in found):
            found.append(lattice)
    return sorted(found, key=len, reverse=True)


def _overlap(one: Lattice, other: Lattice) -> bool:
    """Tell whether two lattices share a corner: then they are one, found twice."""
    distance, _ = cKDTree(other.corners_px).query(one.corners_px)
    return bool(distance.min() < 1.0)


class _Search:
    """What the maps of parts say: which belong together, what is missing, what is wrong."""

    def __init__(self, growth: Growth, size_wh: tuple[int, int]) -> None:
        self.growth, self.size_wh = growth, size_wh
        self.saddles, self.pyramid = growth.saddles, growth.pyramid
        self.points = self.saddles.points_px

    def joined(self, parts: list[Part]) -> list[Part]:
        """Join parts that the map of a larger one explains; of overlapping ones keep the larger."""
        parts = sorted(parts, key=len, reverse=True)
        done: list[Part] = []
        while parts:
            first, *rest = parts
            both = self._first_join(first, rest)
            if both is not None:  # a larger part explains more: start again with it
                joined, other = both
                parts = [self.growth.grown(joined), *(part for part in rest if part is not other)]
                continue
            done.append(first)
            parts = [part for part in rest if not np.isin(part.saddles, first.saddles).any()]
        return done

    def _first_join(self, first: Part, rest: list[Part]) -> tuple[Part, Part] | None:
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

    def _join(self, first: Part, other: Part, all_where: FloatArray) -> Part | None:
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
            if (shift == shift[0]).all() and (find_rows(first.indices, places[fresh]) < 0).all():
                turn = (other.turn - quarter) % 4
                if not self._same_colours(first, places, turn):
                    return None
                return first.joined(Part(other.saddles[fresh], places[fresh], turn[fresh]))
        return None

    def _same_colours(self, first: Part, places: IntArray, turn: IntArray) -> bool:
        """Tell whether black squares of both parts fall on one parity."""
        parity = (first.indices.sum(axis=1) + first.turn) % 2
        others = (places.sum(axis=1) + turn) % 2
        return bool((others == np.rint(parity.mean())).all())

    def lattice(self, part: Part) -> Lattice | None:
        """Return the corners of a part that one smooth map explains, None if too few are left."""
        if not _is_large(part):
            return None
        cleaned, board_map = self._without_strays(part)
        if SMALL <= len(cleaned) < len(part):
            # A stray may have sat where a corner belongs.
            cleaned, board_map = self._without_strays(self.growth.grown(cleaned))
        if len(cleaned) < SMALL or board_map is None:
            return None
        islands = self._with_islands(cleaned, board_map)
        if len(islands) > len(cleaned):
            cleaned, board_map = self._without_strays(self.growth.grown(islands))
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

    def _with_islands(self, part: Part, board_map: BoardMap) -> Part:
        """Add saddles that no edge joins, between fingers, if place and directions fit the map."""
        if len(part) < _FEWEST_TO_PREDICT:
            return part
        own = self.points[part.saddles]
        margin = 2 * np.abs(board_map.jacobian(part.indices.astype(np.float64))).max()
        around = (
            (self.points > own.min(axis=0) - margin) & (self.points < own.max(axis=0) + margin)
        ).all(axis=1)
        others = np.setdiff1d(np.flatnonzero(around[: len(self.saddles)]), part.saddles)
        if not len(others):
            return part
        where = _inverse(board_map, self.points[others], part.indices)
        cells = np.rint(where).astype(np.int64)
        low, high = part.indices.min(axis=0) - _ISLANDS, part.indices.max(axis=0) + _ISLANDS
        near = (np.abs(where - cells) < _OFF_ISLAND).all(axis=1)
        near &= ((cells >= low) & (cells <= high)).all(axis=1)
        near &= find_rows(part.indices, cells) < 0
        others, cells = others[near], cells[near]
        jacobian = board_map.jacobian(cells.astype(np.float64))
        heading = np.arctan2(jacobian[:, 1], jacobian[:, 0])  # of +i and +j
        apart = self.growth.rays[others, None] - heading[:, :, None]
        off = np.abs((apart + np.pi) % (2 * np.pi) - np.pi)
        turn = off[:, 0].argmin(axis=1)
        next_ray = (turn + 1) % 4
        fits = (off[:, 0].min(axis=1) < _ISLAND_TURN) & (
            off[np.arange(len(others)), 1, next_ray] < _ISLAND_TURN
        )
        parity = np.rint(((part.indices.sum(axis=1) + part.turn) % 2).mean())
        fits &= (cells.sum(axis=1) + turn) % 2 == parity
        others, cells, turn = others[fits], cells[fits], turn[fits]
        _, first = np.unique(cells, axis=0, return_index=True)
        islands = Part(others[first], cells[first], turn[first])
        if not len(islands):
            return part
        # Far out a stray would bend the map, so it must look like a corner before it belongs.
        islands = self._alternating(islands, board_map, like=part)
        return part.joined(islands)

    def _filled(self, part: Part, board_map: BoardMap) -> Part:
        """Add corners that are no clear saddles, where edges of two directions meet."""
        if len(part) < _FEWEST_TO_PREDICT:
            return part
        at = {(i, j): k for k, (i, j) in enumerate(part.indices.tolist())}
        around = (part.indices[:, None] + STEPS).reshape(-1, 2)
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
        cells = np.array([cell for cell, _, _ in added])
        turns = np.array([turn for _, _, turn in added])
        return part.joined(Part(np.arange(first, len(self.points)), cells, turns))

    def _turn_where_edges_meet(
        self, part: Part, at: dict[tuple[int, int], int], cell: list[int], place: FloatArray
    ) -> int | None:
        """Return the turn of a corner at a place that edges from all its neighbours reach."""
        beside = [
            (step, at[cell[0] + di, cell[1] + dj])
            for step, (di, dj) in enumerate(STEPS.tolist())
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

    def _alternating(self, part: Part, board_map: BoardMap, like: Part | None = None) -> Part:
        """Keep corners whose four squares are black and white in turn, close to the corner.

        At the rim of the board and of a hand edges may meet as well, but not in four squares.
        """
        step = self._steps(part, board_map)
        usual = step if like is None else self._steps(like, board_map)
        keep = step > _LEAST_STEP * np.median(usual)
        return part.only(keep)

    def _steps(self, part: Part, board_map: BoardMap) -> FloatArray:
        """Return by how much the darker white square at a corner outshines the brighter black."""
        away = _BESIDE_CORNER * board_map.jacobian(part.indices.astype(np.float64))
        points = self.points[part.saddles]
        places = points[:, None] + np.einsum("nij,qj->nqi", away, _QUADRANTS)
        levels = self.pyramid.sample(places, 0).astype(np.float64)
        white_first = (part.turn % 2 == 0)[:, None]  # the square towards (+i, +j)
        white = np.where(white_first, levels[:, [0, 2]], levels[:, [1, 3]])
        black = np.where(white_first, levels[:, [1, 3]], levels[:, [0, 2]])
        return np.asarray(white.min(axis=1) - black.max(axis=1))

    def _map(self, part: Part) -> BoardMap:
        return BoardMap.fit(
            part.indices.astype(np.float64),
            self.points[part.saddles],
            self.size_wh,
            lens_only=True,
        )

    def _without_strays(self, part: Part) -> tuple[Part, BoardMap | None]:
        """Drop corners off the map of the others, the farthest first: it bends the map most.

        Returns the part and its map, None if too few are left for one.
        """
        while len(part) >= SMALL:
            lattice = part.indices.astype(np.float64)
            board_map = self._map(part)
            off = np.linalg.norm(board_map(lattice) - self.points[part.saddles], axis=1)
            side = np.abs(np.linalg.det(board_map.jacobian(lattice))) ** 0.5
            excess = off / np.maximum(_OFF_MAP * side, _OFF_MAP_PX)
            if excess.max() <= 1:
                return part, board_map
            keep = excess < max(1.0, _FARTHEST_FIRST * excess.max())
            part = part.only(keep)
        return part, None


def _is_large(part: Part) -> bool:
    """Tell whether a part may be returned: less than that, textures show as well."""
    return len(part) >= SMALL and int(np.ptp(part.indices, axis=0).min()) + 1 >= _SMALLEST_SIDE


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
        (a, b), (c, d) = np.moveaxis(board_map.jacobian(at), 0, -1)
        determinant = a * d - b * c
        determinant = np.where(np.abs(determinant) < _FLAT_PX2, np.inf, determinant)
        step = np.stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]], axis=1)
        at = at + np.clip(step / determinant[:, None], -2, 2)
    return np.asarray(at)

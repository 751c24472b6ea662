"""Lattices of corners: boards, or the parts of them that are seen, whichever board it is."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.detection.board_map import BoardMap
from calichrome.detection.growth import (
    ALONE,
    Growth,
    Look,
    contrast_beside,
    extend,
    joined_by_edges,
    start,
)
from calichrome.detection.neighbours import STEPS, grow_patches
from calichrome.detection.pyramid import Plane
from calichrome.detection.saddles import Saddles, find_saddles

__all__ = ["Lattice", "find_lattices", "grow_lattices"]

_LEAST_CORNERS = 6
_LEAST_SIDE = 2
_LEAST_SEED = 4
_SMALL_SEED = 6
"""Patches of fewer corners start a lattice only where no other was found, and must grow to
`_LEAST_FROM_SMALL` corners: of 90 textures and pages of text two hold a false lattice of 6 that
grew from 4, none one from 6."""
_LEAST_FROM_SMALL = 9
_MOST_TRIES = 12  # seeds that came to nothing; clutter has any number of small ones

_OFF_MAP, _OFF_MAP_PX = 0.03, 0.4
"""Of a square, and at least: what does not fit better is no corner of this board. Corners of real
photographs are off by 0.016 of a square at most, of compressed video by 0.044 where the median is
high as well."""
_TIMES_MEDIAN = 6.0
_MOST_OFF_MAP = 0.03  # of a square, for the median
_MAX_REFITS = 5

_GAP = 5  # squares beyond the lattice where more of the board is looked for
_OFF_BEYOND = 0.25  # of a square, from where the map predicts it
_SQUARE_BEYOND = 0.25  # of the usual one, at least
_CONTRAST_BEYOND = (0.5, 2.0)  # of the usual one
_LEAST_BEYOND = 2
_MAX_JUMPS = 4
_BESIDE = 0.9  # of the spacing: what is nearer to a lattice is a part of it or nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Corners of one chessboard, or of the part of it that is seen.

    Parameters
    ----------
    indices : (N, 2) int
        (i, j) of every corner, from 0; the turn from +i to +j is that from x to y.
    corners_px : (N, 2) float
        0.1 px off in the median, on reduced pictures and blurred boards more.
    black_parity
        The square between (i, j) and (i + 1, j + 1) is black where (i + j) % 2 is this.
    board_map
        Lattice coordinates to pixels.
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
    """Find chessboards in a grey picture (H, W), 0..255, the largest first."""
    return grow_lattices(find_saddles(grey))


def grow_lattices(saddles: Saddles) -> list[Lattice]:
    """Find the saddles that are corners of chessboards.

    Returns
    -------
    list of Lattice
        Of 3x2 corners at least, the largest first.
    """
    found: list[Lattice] = []
    patches = grow_patches(saddles)
    tries = 0
    while patches and tries < _MOST_TRIES:
        patch, *patches = patches
        small = len(patch.members) < _SMALL_SEED
        if small and found:
            break
        grown = _grown(start(patch, saddles), saddles)
        if grown is None or (small and len(grown[0]) < _LEAST_FROM_SMALL):
            tries += 1
            continue
        growth, board_map = grown
        found.append(_lattice(growth, board_map))
        tree, limit = cKDTree(growth.points_px), _BESIDE * _spacing(growth)
        patches = [
            other
            for other in patches
            if np.median(tree.query(saddles.points_px[other.members])[0]) > limit
        ]
    return sorted(found, key=len, reverse=True)


def _lattice(growth: Growth, board_map: BoardMap) -> Lattice:
    low = growth.indices.min(axis=0)
    return Lattice(
        indices=growth.indices - low,
        corners_px=growth.points_px,
        black_parity=int((low.sum() + 1) % 2),
        board_map=replace(board_map, origin=board_map.origin - low),
    )


def _grown(growth: Growth, saddles: Saddles) -> tuple[Growth, BoardMap] | None:
    """Add all corners of a board that are certain; None if they are too few."""
    grown = None
    for _ in range(_MAX_JUMPS):
        if len(growth) < _LEAST_SEED:
            return grown
        grown = _consistent(_certain(extend(growth, saddles), saddles), saddles)
        beyond = None if grown is None else _beyond_a_gap(*grown, saddles)
        if beyond is None:
            break
        growth = beyond
    return grown


def _certain(growth: Growth, saddles: Saddles) -> Growth:
    """Drop corners that look unlike their neighbours; sooner where no cell of four holds them."""
    _, basis = growth.predict(growth.indices)
    look = Look.at(saddles.pyramid, growth.points_px, basis, growth.indices)
    rows = growth.rows_at(growth.indices[:, None] + STEPS)
    beside = rows >= 0
    across = growth.rows_at(growth.indices[:, None] + STEPS + np.roll(STEPS, 1, axis=0)) >= 0
    in_cell = (beside & np.roll(beside, 1, axis=1) & across).any(axis=1)
    usual = np.where(beside.any(axis=1), contrast_beside(look.mean, rows), look.mean)
    return growth.where(look.fits(usual) & (in_cell | (look.worst > ALONE * usual)))


def _consistent(growth: Growth, saddles: Saddles) -> tuple[Growth, BoardMap] | None:
    """Drop corners that one smooth map does not explain; None if too few are left."""
    height, width = saddles.pyramid.size_hw
    lens_only = True  # until something is left that a bent board might explain
    for _ in range(_MAX_REFITS):
        if len(growth) < _LEAST_CORNERS or np.ptp(growth.indices, axis=0).min() < _LEAST_SIDE - 1:
            return None
        lattice = growth.indices.astype(np.float64)
        board_map = BoardMap.fit(lattice, growth.points_px, (width, height), lens_only=lens_only)
        slope = board_map.jacobian(lattice)
        if not (np.linalg.det(slope) > 0).all():
            return None
        square = np.linalg.norm(slope, axis=1).min(axis=1)
        off = np.linalg.norm(board_map(lattice) - growth.points_px, axis=1)
        limit = np.maximum(_OFF_MAP * square, _OFF_MAP_PX)
        if not lens_only:
            limit = np.maximum(limit, _TIMES_MEDIAN * np.median(off))
        fits = off < limit
        if fits.all():
            return (growth, board_map) if np.median(off / square) < _MOST_OFF_MAP else None
        if not lens_only:
            growth = growth.where(fits)
        lens_only = False
    return None


def _beyond_a_gap(growth: Growth, board_map: BoardMap, saddles: Saddles) -> Growth | None:
    """Add corners that the map predicts behind something that covers the board."""
    new = _candidates_beyond(growth, board_map, saddles)
    new = new.where(joined_by_edges(new, new, saddles.pyramid)) if len(new) else new
    if len(new) < _LEAST_BEYOND:
        return None
    grown = _consistent(growth.plus(new), saddles)
    if grown is None or len(grown[0]) < len(growth) + _LEAST_BEYOND:
        return None
    keeps_all = bool((grown[0].rows_at(growth.indices) >= 0).all())
    return grown[0] if keeps_all else None


def _candidates_beyond(growth: Growth, board_map: BoardMap, saddles: Saddles) -> Growth:
    pyramid = saddles.pyramid
    cells = _places_around(growth)
    predicted = board_map(cells.astype(np.float64))
    inside = pyramid.holds(predicted)
    cells, predicted = cells[inside], predicted[inside]
    slope = board_map.jacobian(cells.astype(np.float64))
    square = np.linalg.norm(slope, axis=1).min(axis=1)
    distance, which = cKDTree(saddles.points_px).query(predicted)
    near = (distance < _OFF_BEYOND * square) & (np.linalg.det(slope) > 0)
    near &= square > _SQUARE_BEYOND * _spacing(growth)
    cells, points = cells[near], saddles.points_px[which[near]]
    look = Look.at(pyramid, points, np.swapaxes(slope[near], 1, 2), cells)
    least, most = np.array(_CONTRAST_BEYOND) * np.median(growth.contrast)
    good = (look.worst > ALONE * look.mean) & (look.mean > least) & (look.mean < most)
    return Growth(cells, points, look.mean, look.level).where(good)


def _places_around(growth: Growth) -> IntArray:
    """Return the free places (M, 2) of the lattice within the gap that is bridged."""
    low, high = growth.indices.min(axis=0) - _GAP, growth.indices.max(axis=0) + _GAP
    i, j = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    cells = np.stack([i.ravel(), j.ravel()], axis=1)
    return np.asarray(cells[growth.rows_at(cells) < 0])


def _spacing(growth: Growth) -> float:
    """Return the median distance of neighbours, pixels."""
    rows = growth.rows_at(growth.indices[:, None] + STEPS[:2])
    which, ray = np.nonzero(rows >= 0)
    offset: FloatArray = growth.points_px[rows[which, ray]] - growth.points_px[which]
    return float(np.median(np.linalg.norm(offset, axis=1)))

"""Corners with a place on a lattice, and the search for those beside them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.detection.neighbours import STEPS, Patch, edges_hold
from calichrome.detection.pyramid import Pyramid
from calichrome.detection.saddles import Saddles, go_to_saddles

__all__ = ["ALONE", "Growth", "Look", "contrast_beside", "extend", "joined_by_edges", "start"]

_OFF_PREDICTION = 0.25  # of a square: how far from its prediction a corner is looked for
_LEAST_SQUARE_PX = 4.0  # of the reduced picture
_MAX_ROUNDS = 30  # of growing, each by a ring of corners

_WORST = 0.3
"""Step from the darkest bright quarter to the brightest dark one around a corner, of the usual step
from dark to bright. True corners: 0.5 and more on 99.9 % of 5,600, less where compressed pictures
moved. The rim of a board against things behind it: up to 0.4, and then mostly alone."""
ALONE = 0.7  # the same for corners that are in no cell of four
_MEAN = 0.6  # of the usual step, at least, for the mean one, and at most its inverse
_LEAST_STEP = 0.25  # across the edges to the neighbours, everywhere, of the usual contrast
_LEAST_MEAN = 0.4  # of the patch's median, where nothing else is known yet

_QUARTER = np.array([[0.08, 0.2], [0.15, 0.15], [0.2, 0.08]])
"""Where a quarter is looked at, in squares: clear of discs of 0.7, beyond most blur."""
_TURNS = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]])
_QUARTERS = np.concatenate([_QUARTER @ turn.T for turn in _TURNS])
_SQUARE_ON_LEVEL_PX = 20.0  # at least: the blur of a level is then within the quarters

_NUDGES = 3
_N_NEAREST = 4  # corners whose offsets correct the prediction of one beside them


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """N corners of a lattice; beyond those with an even sum of indices a square is bright.

    Parameters
    ----------
    indices : (N, 2) int
    points_px : (N, 2) float
    contrast : (N,) float
        Half the step from dark to bright quarters.
    level : (N,) int
        Of the pyramid, on which a square has 20 to 40 px, or the finest.
    """

    indices: IntArray
    points_px: FloatArray
    contrast: FloatArray
    level: IntArray

    def __len__(self) -> int:
        return len(self.points_px)

    def where(self, chosen: BoolArray) -> "Growth":
        """Return the chosen corners."""
        return Growth(
            self.indices[chosen], self.points_px[chosen], self.contrast[chosen], self.level[chosen]
        )

    def plus(self, other: "Growth") -> "Growth":
        """Return the corners of both."""
        return Growth(
            np.concatenate([self.indices, other.indices]),
            np.concatenate([self.points_px, other.points_px]),
            np.concatenate([self.contrast, other.contrast]),
            np.concatenate([self.level, other.level]),
        )

    def rows_at(self, indices: IntArray) -> IntArray:
        """Return the row of the corner at each place (..., 2), -1 where there is none."""
        low = self.indices.min(axis=0)
        shape = np.ptp(self.indices, axis=0) + 1
        table = np.full(tuple(shape), -1)
        table[tuple((self.indices - low).T)] = np.arange(len(self))
        inside = ((indices >= low) & (indices < low + shape)).all(axis=-1)
        at = np.where(inside[..., None], indices - low, 0)
        return np.where(inside, table[at[..., 0], at[..., 1]], -1)

    def predict(self, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return where places (M, 2) are, and pixels per square along i and j (M, 2 axes, 2).

        A homography of all corners, corrected by how far it is off at the nearest ones.
        """
        homography = fit_homography(self.indices.astype(np.float64), self.points_px)
        step = 0.05
        stencil = cells[:, None] + step * np.concatenate([np.zeros((1, 2)), STEPS])
        mapped = apply_homography(homography, stencil)
        rest = self.points_px - apply_homography(homography, self.indices.astype(np.float64))
        distance, near = cKDTree(self.indices).query(cells, k=min(_N_NEAREST, len(self)))
        weight = 1 / np.maximum(distance, 0.1) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        correction = (rest[near] * weight[..., None]).sum(axis=1)
        basis = (mapped[:, 1:3] - mapped[:, 3:5]) / (2 * step)
        return mapped[:, 0] + correction, basis


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What M points look like: half the step from dark to bright quarters, on average and at worst.

    Parameters
    ----------
    mean, worst : (M,) float
        Negative where bright and dark are exchanged.
    level : (M,) int
        Of the pyramid, where they were looked at.
    """

    mean: FloatArray
    worst: FloatArray
    level: IntArray

    @classmethod
    def at(
        cls, pyramid: Pyramid, points_px: FloatArray, basis: FloatArray, cells: IntArray
    ) -> "Look":
        """Look at points (M, 2) that should be corners at places (M, 2)."""
        level = _level_of(basis, pyramid)
        places = points_px[:, None] + _QUARTERS @ basis
        values = pyramid.sample(places, level).astype(np.float64)
        sign = np.where(cells.sum(axis=1) % 2 == 0, 1.0, -1.0)
        quarters = values.reshape(-1, 4, len(_QUARTER)).mean(axis=2) * sign[:, None]
        bright, dark = quarters[:, [0, 2]], quarters[:, [1, 3]]
        return cls(
            mean=(bright.mean(axis=1) - dark.mean(axis=1)) / 2,
            worst=(bright.min(axis=1) - dark.max(axis=1)) / 2,
            level=level,
        )

    def fits(self, contrast: FloatArray) -> BoolArray:
        """Tell which look like corners of the contrast that is usual around them (M,)."""
        likely = (self.mean > _MEAN * contrast) & (self.mean < contrast / _MEAN)
        return np.asarray(likely & (self.worst > _WORST * contrast))


def start(patch: Patch, saddles: Saddles) -> Growth:
    """Take the corners of a patch that look like corners of a chessboard."""
    members = patch.members
    growth = Growth(
        patch.indices, saddles.points_px[members], saddles.contrast[members], saddles.level[members]
    )
    _, basis = growth.predict(growth.indices)
    look = Look.at(saddles.pyramid, growth.points_px, basis, growth.indices)
    alike = (look.worst > _WORST * look.mean) & (look.mean > _LEAST_MEAN * np.median(look.mean))
    return replace(growth, contrast=look.mean, level=look.level).where(alike)


def extend(growth: Growth, saddles: Saddles) -> Growth:
    """Add corners beside those that are there, until there are no more."""
    tree = cKDTree(saddles.points_px)
    for _ in range(_MAX_ROUNDS):
        around = np.unique((growth.indices[:, None] + STEPS).reshape(-1, 2), axis=0)
        beside = _corners_at(around[growth.rows_at(around) < 0], growth, saddles, tree)
        if len(beside) == 0:
            break
        growth = growth.plus(beside)
    return growth


def _corners_at(cells: IntArray, growth: Growth, saddles: Saddles, tree: cKDTree) -> Growth:
    """Look for corners at places (M, 2), among the saddles or weaker ones."""
    pyramid = saddles.pyramid
    predicted, basis = growth.predict(cells)
    square = np.linalg.norm(basis, axis=2).min(axis=1)
    possible = pyramid.holds(predicted) & (square > _LEAST_SQUARE_PX * pyramid.reduction)
    cells, predicted, basis, square = (part[possible] for part in (cells, predicted, basis, square))
    distance, which = tree.query(predicted)
    seen = (distance < _OFF_PREDICTION * square)[:, None]
    nudged = go_to_saddles(pyramid, predicted, _level_of(basis, pyramid), _NUDGES)
    points = np.where(seen, saddles.points_px[which], nudged)
    look = Look.at(pyramid, points, basis, cells)
    rows = growth.rows_at(cells[:, None] + STEPS)
    contrast = contrast_beside(growth.contrast, rows)
    near = np.linalg.norm(points - predicted, axis=1) < _OFF_PREDICTION * square
    found = Growth(cells, points, contrast, look.level)
    good = near & look.fits(contrast) & joined_by_edges(found, growth, pyramid)
    return replace(found, contrast=look.mean).where(good)


def contrast_beside(contrast: FloatArray, rows: IntArray) -> FloatArray:
    """Return the mean contrast of the neighbours that are there, rows (M, 4) of them or -1."""
    there = rows >= 0
    total = np.where(there, contrast[rows], 0).sum(axis=1)
    return np.asarray(total / np.maximum(there.sum(axis=1), 1))


def joined_by_edges(found: Growth, growth: Growth, pyramid: Pyramid) -> BoolArray:
    """Tell which found corners (M,) have edges to half of their neighbours, and to one at least."""
    rows = growth.rows_at(found.indices[:, None] + STEPS)
    which, ray = np.nonzero(rows >= 0)
    holds = edges_hold(
        pyramid,
        found.points_px[which],
        growth.points_px[rows[which, ray]],
        (found.indices[which].sum(axis=1) + ray) % 2 == 0,
        _LEAST_STEP * found.contrast[which],
        found.level[which],
    )
    n_held = np.bincount(which[holds], minlength=len(found))
    return np.asarray(n_held >= np.maximum(1, np.bincount(which, minlength=len(found)) / 2))


def _level_of(basis: FloatArray, pyramid: Pyramid) -> IntArray:
    """Return the coarsest level (M,) on which squares are large enough to look at."""
    square = np.linalg.norm(basis, axis=2).min(axis=1) / pyramid.reduction
    level = np.floor(np.log2(np.maximum(square, 1) / _SQUARE_ON_LEVEL_PX)).astype(np.int64)
    return np.asarray(np.clip(level, 0, len(pyramid.planes) - 1))

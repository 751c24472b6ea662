"""Which colour on which square, so that a part of the board can be told from every other part.

The criterion and its alternatives: docs/decisions/0001-layout-of-colours.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.errors import TargetError
from calichrome.target.board import SquareColour, Target

__all__ = ["DISCS_IN_WINDOW", "WINDOW", "LayoutQuality", "arrange_colours", "layout_quality"]

WINDOW = (4, 3)
"""Squares along the long and the short side of the smallest part that must be recognised."""

DISCS_IN_WINDOW = 6
"""Discs such a part should show: with white and black of the board 8 points for the 4 unknowns per
channel of an affine colour map, so half of the colour evidence is left to judge the placement."""

_SHARE_OF_SQUARES = 0.6
"""Share of the squares that carry discs. Below one half no window can be promised 6 of 12; the
empty white ones measure the light."""

_MOST_SQUARES = 2000
"""The search compares all pairs of placements; at 2000 squares these are 26 million."""

_WHITE_Y, _BLACK_Y = 0.85, 0.04
"""Luminance factors assumed for paper and ink that were not measured: plain office paper and laser
or pigment black. The test of a layout hardly depends on them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutQuality:
    """How well parts of a board can be told apart.

    A placement is a window of 4x3 or 3x4 squares seen in one of the four rotations. Only
    placements that agree in which squares are black and which are white can be confused.

    Parameters
    ----------
    n_placements
        Number of placements.
    fewest_discs
        Discs in the window that shows the fewest.
    share_with_enough_discs
        Share of the windows that show at least `DISCS_IN_WINDOW` discs.
    least_differing
        The smallest number of squares, of 12, that differ between two placements: a disc in one of
        them only, or discs of two colours.
    least_presence
        The same, counting only squares with a disc in one of the two placements.
    least_residual
        Of the pairs of placements that differ in the presence of at most two discs: the smallest
        relative residual after the colours of one placement, with the board's white and black, were
        mapped on those of the other by the best affine map. 0 would mean that an unknown light and
        camera could explain the exchange; the scale is the scatter of the colours themselves.
        Infinite if there is no such pair.
    """

    n_placements: int
    fewest_discs: int
    share_with_enough_discs: float
    least_differing: int
    least_presence: int
    least_residual: float


def arrange_colours(
    black_squares: BoolArray, backgrounds: Sequence[SquareColour], *, seed: int = 0
) -> IntArray:
    """Choose the colour of every square.

    Every colour is used equally often, on ``round(0.6 n_squares / n_colours)`` squares or as often
    as the squares of its kind allow.

    Parameters
    ----------
    black_squares : (squares_y, squares_x) bool
        Which squares are black.
    backgrounds
        For every colour of the palette, the kind of square it goes on.
    seed
        Equal seeds give equal layouts.

    Returns
    -------
    (squares_y, squares_x) int
        Index of the colour; -1 where there is no disc.

    Raises
    ------
    TargetError
        If there are more colours than squares of their kind, or the board is too large to search.

    Notes
    -----
    Three searches by exchange, each keeping what the one before has reached: which squares hold
    discs so that every window shows enough of them; the same so that the most similar placements
    differ in the presence of discs; which colours they have so that the most similar placements
    differ in as many squares as possible.
    """
    black = black_squares.ravel()
    if black.size > _MOST_SQUARES:
        raise TargetError(
            f"{black_squares.shape[1]}x{black_squares.shape[0]} squares are more than the "
            f"{_MOST_SQUARES} that colours are arranged for; use fewer and larger squares"
        )
    on_black = np.array([background == "black" for background in backgrounds], dtype=bool)
    labels = np.full(black.size, -1, dtype=np.int64)
    if not on_black.size:
        return labels.reshape(black_squares.shape)
    kinds = [
        (np.flatnonzero(black == kind), np.flatnonzero(on_black == kind)) for kind in (True, False)
    ]
    n_times = max(round(_SHARE_OF_SQUARES * black.size / on_black.size), 1)
    for cells, colours in kinds:
        if len(colours) > len(cells):
            raise TargetError(_too_many_colours(black_squares, on_black))
        if len(colours):
            n_times = min(n_times, len(cells) // len(colours))

    rng = np.random.default_rng(seed)
    search = _Search.of_board(black_squares)
    for cells, colours in kinds:
        labels[rng.permutation(cells)[: n_times * len(colours)]] = 0
    search.cover(labels, rng, n_steps=60 * black.size)
    search.separate(labels, rng, n_steps=min(15 * black.size, 4000), move_discs=True)
    for cells, colours in kinds:
        discs = cells[labels[cells] >= 0]
        labels[discs] = rng.permutation(np.repeat(colours, n_times))
    search.separate(labels, rng, n_steps=min(30 * black.size, 8000), move_discs=False)
    return labels.reshape(black_squares.shape)


def _too_many_colours(black_squares: BoolArray, on_black: BoolArray) -> str:
    n_bright, n_dark = int(on_black.sum()), int((~on_black).sum())
    n_black, n_white = int(black_squares.sum()), int((~black_squares).sum())
    need = 2 * max(n_bright, n_dark)
    boards = (
        (nx * ny, nx, ny)
        for ny in range(4, 200)
        for nx in range(ny + 1, 2 * ny, 2)
        if nx * ny >= need
    )
    _, nx, ny = min(boards)
    return (
        f"{n_bright} bright colours for {n_black} black squares and {n_dark} dark ones for "
        f"{n_white} white squares: the palette is too large for this board; print {nx}x{ny} "
        f"squares or more, or choose fewer colours"
    )


def layout_quality(target: Target) -> LayoutQuality | None:
    """Judge the layout of any board with discs.

    Returns
    -------
    LayoutQuality or None
        None if the board has no discs, or too many squares to compare all placements.
    """
    if not target.markers or target.black_squares.size > _MOST_SQUARES:
        return None
    names = {
        name: index for index, name in enumerate(dict.fromkeys(m.name for m in target.markers))
    }
    labels = np.full(target.black_squares.shape, -1, dtype=np.int64)
    rgb = np.zeros((len(names), 3))
    for marker in target.markers:
        ix, iy = marker.square
        labels[iy, ix] = names[marker.name]
        rgb[names[marker.name]] = RGB_FROM_XYZ["srgb"] @ np.array(marker.xyz_d65)
    white = target.paper.white_xyz_d65 or _WHITE_Y * D65
    black = target.paper.black_xyz_d65 or _BLACK_Y * D65
    board_rgb = np.array([white, black]) @ RGB_FROM_XYZ["srgb"].T

    search = _Search.of_board(target.black_squares)
    seen = labels.ravel()[search.cells]
    differing, presence = (search.least_differing(values) for values in (seen, seen >= 0))
    n_discs = (seen >= 0).sum(axis=1)
    return LayoutQuality(
        n_placements=len(seen),
        fewest_discs=int(n_discs.min()),
        share_with_enough_discs=float((n_discs >= DISCS_IN_WINDOW).mean()),
        least_differing=differing,
        least_presence=presence,
        least_residual=_least_residual(seen, search.pairs_alike(seen >= 0, 2), rgb, board_rgb),
    )


def _least_residual(
    seen: IntArray, pairs: IntArray, rgb: FloatArray, board_rgb: FloatArray
) -> float:
    """Return the smallest residual of affine maps between the colours of paired placements.

    `seen` (P, 12) holds colour indices, `pairs` (N, 2) indexes its rows.
    """
    least = np.inf
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    for block in np.array_split(both_ways, len(both_ways) // 20_000 + 1):
        source, target = seen[block[:, 0]], seen[block[:, 1]]
        common = (source >= 0) & (target >= 0)
        shape = (len(block), *board_rgb.shape)
        y = np.concatenate(
            [np.where(common[..., None], rgb[target], 0), np.broadcast_to(board_rgb, shape)], axis=1
        )
        x = np.concatenate(
            [np.where(common[..., None], rgb[source], 0), np.broadcast_to(board_rgb, shape)], axis=1
        )
        used = np.concatenate([common, np.ones(shape[:2], dtype=bool)], axis=1)
        x = np.concatenate([x, used[..., None]], axis=2)
        # The ridge decides what fewer than four independent colours leave open; it lets the fit
        # explain them without a residual, which is what the judgement needs.
        normal = np.swapaxes(x, 1, 2) @ x + 1e-9 * np.eye(4)
        residual = y - x @ np.linalg.solve(normal, np.swapaxes(x, 1, 2) @ y)
        mean = y.sum(axis=1, keepdims=True) / used.sum(axis=1)[:, None, None]
        spread = np.where(used[..., None], y - mean, 0)
        relative = np.sqrt((residual**2).sum(axis=(1, 2)) / (spread**2).sum(axis=(1, 2)))
        least = min(least, float(relative.min(initial=np.inf)))
    return least


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """All placements of a board, and searches by exchanging the contents of two squares.

    Parameters
    ----------
    black : (n_squares,) bool
        Kind of each square, row-major.
    cells : (P, 12) int
        Square at each of the 12 positions of a placement.
    at : (n_squares, 4, 12) int
        The inverse: which placement shows a square at a position, by rotation; -1 for none.
    """

    black: BoolArray
    cells: IntArray
    at: IntArray

    @classmethod
    def of_board(cls, black_squares: BoolArray) -> Self:
        n_squares, n_window = black_squares.size, WINDOW[0] * WINDOW[1]
        grid = np.arange(n_squares).reshape(black_squares.shape)
        at = np.full((n_squares, 4, n_window), -1)
        placements: list[IntArray] = []
        first = 0
        for turn in range(4):
            windows = sliding_window_view(np.rot90(grid, turn), WINDOW[::-1]).reshape(-1, n_window)
            ids = first + np.arange(len(windows))
            at[windows, turn, np.arange(n_window)] = ids[:, None]
            first += len(windows)
            placements.append(windows)
        return cls(black_squares.ravel(), np.concatenate(placements), at)

    def equal_squares(self, seen: NDArray[np.generic]) -> NDArray[np.int8]:
        """Count the squares in which placements agree, shape (P, P).

        Each pair stands once, above the diagonal; -1 elsewhere and for pairs that the kinds of
        their squares already tell apart.
        """
        n_equal = np.zeros((len(seen), len(seen)), dtype=np.int8)
        for column in seen.T:
            n_equal += column[:, None] == column
        kind = self.black[self.cells[:, 0]]
        n_equal[(kind[:, None] != kind) | np.tri(len(seen), dtype=bool)] = -1
        return n_equal

    def least_differing(self, seen: NDArray[np.generic]) -> int:
        return int(self.cells.shape[1] - self.equal_squares(seen).max())

    def pairs_alike(self, seen: NDArray[np.generic], most_differing: int) -> IntArray:
        """Return the pairs of placements that differ in so few squares, shape (N, 2)."""
        return np.argwhere(self.equal_squares(seen) >= self.cells.shape[1] - most_differing)

    def cover(self, labels: IntArray, rng: np.random.Generator, *, n_steps: int) -> None:
        """Move discs until every window shows enough of them, or the steps are used up."""
        n_discs = self._n_discs(labels)
        shortfall = _shortfall(n_discs)
        for _ in range(n_steps):
            if shortfall == 0:
                break
            poor = np.flatnonzero(n_discs < DISCS_IN_WINDOW)
            window = self.cells[_pick(poor, rng)]
            empty = window[labels[window] < 0]
            donors = np.flatnonzero((labels >= 0) & (self.black == self.black[_pick(empty, rng)]))
            takers = empty[self.black[empty] == self.black[donors[0]]] if len(donors) else donors
            if not len(takers):
                continue
            taker, donor = _pick(takers, rng), _pick(donors, rng)
            moved = self._moved(n_discs, donor, taker)
            if _shortfall(moved) <= shortfall:
                n_discs, shortfall = moved, _shortfall(moved)
                labels[taker], labels[donor] = labels[donor], labels[taker]

    def separate(
        self, labels: IntArray, rng: np.random.Generator, *, n_steps: int, move_discs: bool
    ) -> None:
        """Make the most similar placements less similar.

        `move_discs` exchanges discs for empty squares, where no window may lose discs that it
        needs; otherwise discs exchange their colours.
        """
        n_equal = self.equal_squares(labels[self.cells]).ravel()
        # A pair that agrees in one square more weighs three times as much: the search is led by
        # the most similar pairs and still sees the next ones.
        weight = 3.0 ** np.arange(self.cells.shape[1] + 1)
        n_discs = self._n_discs(labels)
        movable = move_discs | (labels >= 0)
        worst = np.empty(0, dtype=np.int64)
        for step in range(n_steps):
            if step % 25 == 0:  # the list goes stale slowly; renewing it costs more than a step
                worst = np.flatnonzero(n_equal == n_equal.max())
            pair = divmod(int(_pick(worst, rng)), len(self.cells))
            first, second = self.cells[list(pair)]
            alike = (labels[first] == labels[second]) & movable[first] & (first != second)
            if not alike.any():
                continue
            cell = _pick((first if rng.integers(2) else second)[alike], rng)
            others = (labels != labels[cell]) & movable & (self.black == self.black[cell])
            if not others.any():
                continue
            other = _pick(np.flatnonzero(others), rng)
            moved = n_discs
            if move_discs:
                donor, taker = (cell, other) if labels[cell] >= 0 else (other, cell)
                moved = self._moved(n_discs, donor, taker)
                if _shortfall(moved) > _shortfall(n_discs):
                    continue
            keys, change = self._changes(labels, cell, other)
            after = n_equal[keys] + change
            if weight[after].sum() <= weight[n_equal[keys]].sum():
                n_equal[keys] = after
                n_discs = moved
                labels[cell], labels[other] = labels[other], labels[cell]

    def _changes(
        self, labels: IntArray, cell: np.int64, other: np.int64
    ) -> tuple[IntArray, NDArray[np.int8]]:
        """Return the pairs of placements that an exchange makes more or less equal, and by what."""
        same_kind = self.black == self.black[cell]
        like_cell = np.flatnonzero(same_kind & (labels == labels[cell]))
        like_other = np.flatnonzero(same_kind & (labels == labels[other]))
        like_cell, like_other = like_cell[like_cell != cell], like_other[like_other != other]
        lost = [self._pairs(cell, like_cell), self._pairs(other, like_other)]
        won = [self._pairs(cell, like_other), self._pairs(other, like_cell)]
        keys, places = np.unique(np.concatenate(lost + won), return_inverse=True)
        signs = np.repeat([-1.0, 1.0], [sum(map(len, lost)), sum(map(len, won))])
        return keys, np.bincount(places, weights=signs, minlength=len(keys)).astype(np.int8)

    def _pairs(self, cell: np.int64, cells: IntArray) -> IntArray:
        """Return the pairs that compare `cell` with one of `cells`, as indices into (P, P)."""
        first, second = self.at[cell][None, :, None, :], self.at[cells][:, None, :, :]
        keys = np.minimum(first, second) * len(self.cells) + np.maximum(first, second)
        return np.asarray(keys[(first >= 0) & (second >= 0)])

    def _n_discs(self, labels: IntArray) -> IntArray:
        return np.asarray((labels[self.cells] >= 0).sum(axis=1))

    def _moved(self, n_discs: IntArray, donor: np.int64, taker: np.int64) -> IntArray:
        moved = n_discs.copy()
        moved[self.at[donor][self.at[donor] >= 0]] -= 1
        moved[self.at[taker][self.at[taker] >= 0]] += 1
        return moved


def _shortfall(n_discs: IntArray) -> int:
    return int(np.sum(np.maximum(DISCS_IN_WINDOW - n_discs, 0) ** 2))


def _pick(values: IntArray, rng: np.random.Generator) -> np.int64:
    return np.int64(values[rng.integers(len(values))])

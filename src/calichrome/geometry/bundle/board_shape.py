"""How a board may differ from a flat grid of squares: bow, aspect and shear."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["ASPECT_TERMS", "BOW_TERMS", "BoardShape"]

BOW_TERMS = ("uu", "uv", "vv", "uuv", "uvv")
"""Curvature along x, twist, curvature along y, and how the curvatures change across the board."""

ASPECT_TERMS = ("aspect", "shear")
"""Squares wider than high, and squares that lean: what a printer's feed does to them."""

_POWERS = ((2, 0), (1, 1), (0, 2), (2, 1), (1, 2))
_SAME = 1e-6  # of heights between -1 and 1: rounding leaves 1e-15, a board of 3x3 corners 0.5


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape:
    """Linear displacements of the points of a board.

    Parameters
    ----------
    names : S names
        Of `BOW_TERMS`, then of `ASPECT_TERMS`.
    basis : (S, 3, n) float
        Displacement of each point by a unit parameter: each is metres.

    Notes
    -----
    Bow terms move points along z. They are orthogonal, over the corners, to a constant, to both
    slopes and to each other, so that no pose of the board can imitate them; each is scaled to a
    range (largest minus smallest height) of 1, which makes a parameter a sagitta.

    Aspect and shear move points in the plane, linearly. They are orthogonal to both shifts, to a
    turn and to a stretch of the whole (the board's pose, and its scale, which is the square's) and
    to each other; the longest displacement is 1. One without the other would depend on how the
    board's axes are drawn.
    """

    names: tuple[str, ...]
    basis: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def flat(cls, points_board: FloatArray) -> "BoardShape":
        """No parameter: the points stay in place."""
        return cls((), np.zeros((0, 3, len(points_board))))

    @classmethod
    def bowed(cls, points_board: FloatArray, n_terms: int, *, aspect: bool = False) -> "BoardShape":
        """Build the first `n_terms` bow terms over `points_board`, (n, 3), metres.

        Terms that the corners cannot tell from the earlier ones are left out (those of a board with
        two rows of corners, for example).

        Parameters
        ----------
        points_board, n_terms
            See above.
        aspect
            Add aspect and shear.
        """
        xy = points_board[:, :2]
        middle = (xy.max(axis=0) + xy.min(axis=0)) / 2
        half = np.maximum((xy.max(axis=0) - xy.min(axis=0)) / 2, 1e-12)
        u, v = ((xy - middle) / half).T
        heights = (u**i * v**j for i, j in _POWERS[:n_terms])
        bows = list(_orthogonal(heights, [np.ones_like(u), u, v]))
        names = [BOW_TERMS[place] for place, _ in bows]
        flat = np.zeros_like(u)
        basis = [np.stack([flat, flat, term / np.ptp(term)]) for _, term in bows]
        if aspect:
            x, y = (xy - xy.mean(axis=0)).T
            one = np.ones_like(x)
            held = [(one, flat), (flat, one), (-y, x), (x, y)]
            fields = (np.concatenate(field) for field in ((u, flat), (flat, u)))
            moves = _orthogonal(fields, [np.concatenate(pair) for pair in held])
            for place, field in moves:
                along_x, along_y = np.split(field, 2)
                names.append(ASPECT_TERMS[place])
                longest = np.hypot(along_x, along_y).max()
                basis.append(np.stack([along_x, along_y, flat]) / longest)
        if not basis:
            return cls.flat(points_board)
        return cls(tuple(names), np.stack(basis))

    def displaced(self, points_board: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the points (n, 3) of a board of this shape."""
        if not self.names:
            return points_board
        return np.asarray(points_board + np.tensordot(parameters, self.basis, axes=1).T)


def _orthogonal(
    vectors: Iterator[FloatArray], spanned: list[FloatArray]
) -> Iterator[tuple[int, FloatArray]]:
    """Yield what of each vector the ones before it do not span, and its place; nothing if nothing.

    Vectors are of size 1; `spanned` may have any.
    """
    span, _ = np.linalg.qr(np.stack([item / np.linalg.norm(item) for item in spanned], axis=1))
    for place, vector in enumerate(vectors):
        rest = vector - span @ (span.T @ vector)
        rest -= span @ (span.T @ rest)  # what rounding left of it
        if np.ptp(rest) < _SAME:
            continue
        span = np.column_stack([span, rest / np.linalg.norm(rest)])
        yield place, rest

"""Smooth fields over a picture, kept at every few pixels."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["Grid"]

_STEPS = (8, 4, 2, 1)
"""Pixels between nodes. At 8 a map of 1080p takes 0.26 MB in place of 17 MB and stays in the
processor's cache; coarser ones gain nothing more and bend with strong lenses."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Values at every `step`-th pixel of a picture, straight lines in between.

    Parameters
    ----------
    size_wh
        Of the picture.
    step
        Pixels from node to node: 1, 2, 4 or 8.
    nodes : (P, rows, columns) float32
        The last row and column lie on or beyond the border.
    """

    size_wh: tuple[int, int]
    step: int
    nodes: NDArray[np.float32]

    @classmethod
    def through(
        cls, field: NDArray[np.float32], is_close: Callable[[NDArray[np.float32]], bool]
    ) -> Self:
        """Return the coarsest grid that is close to a field.

        Parameters
        ----------
        field : (H, W, P) float32
            At every pixel.
        is_close
            Judges an approximation of `field`; one equal to it is taken unasked.
        """
        height, width = field.shape[:2]
        for step in _STEPS[:-1]:
            nodes = _nodes(_nodes(field, step, 0), step, 1)
            grid = cls((width, height), step, np.ascontiguousarray(np.moveaxis(nodes, -1, 0)))
            if is_close(grid.field()):
                return grid
        return cls((width, height), 1, np.ascontiguousarray(np.moveaxis(field, -1, 0)))

    def field(self) -> NDArray[np.float32]:
        """Return the values at every pixel, (H, W, P)."""
        width, height = self.size_wh
        rows = _between(np.moveaxis(self.nodes, 0, -1), self.step, 0, height)
        return _between(rows, self.step, 1, width)


def _nodes(field: NDArray[np.float32], step: int, axis: int) -> NDArray[np.float32]:
    """Take every step-th value; beyond the border such that the border is met."""
    last = field.shape[axis] - 1
    count = -(-last // step) + 1
    nodes = np.take(field, np.minimum(np.arange(count) * step, last), axis=axis)
    beyond = (count - 1) * step - last
    if beyond > 0:
        before, border = (np.take(nodes, index, axis=axis) for index in (-2, -1))
        edge: list[slice | int] = [slice(None)] * nodes.ndim
        edge[axis] = -1
        nodes[tuple(edge)] = before + (border - before) * (step / (step - beyond))
    return np.asarray(nodes)


def _between(nodes: NDArray[np.float32], step: int, axis: int, count: int) -> NDArray[np.float32]:
    at = np.arange(count)
    left = at // step
    right = np.minimum(left + 1, nodes.shape[axis] - 1)
    shape = [1] * nodes.ndim
    shape[axis] = count
    share = ((at % step) / np.float32(step)).astype(np.float32).reshape(shape)
    start = np.take(nodes, left, axis=axis)
    return np.asarray(start + share * (np.take(nodes, right, axis=axis) - start))

"""A three-dimensional table of colours."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray

__all__ = ["ColourTable"]


@dataclass(frozen=True, slots=True, eq=False)
class ColourTable:
    """Values at N^3 nodes, interpolated in tetrahedra.

    Nodes are spaced evenly in the root of light, as eyes and pictures are nearly; spaced evenly in
    light, dark colours would fall between the first two.

    Parameters
    ----------
    scale : (3,) float
        What light is multiplied by to reach the last node.
    nodes : (N, N, N, 4) float32
        The fourth number is unused: it aligns the others.

    References
    ----------
    .. [1] J. M. Kasson, S. I. Nin, W. Plouffe, J. L. Hafner, "Performing color space conversions
       with three-dimensional linear interpolation", J. Electronic Imaging 4 (3), 1995.
    """

    scale: FloatArray
    nodes: NDArray[np.float32]

    @classmethod
    def of(cls, values: Callable[[FloatArray], FloatArray], most: FloatArray, size: int) -> Self:
        """Tabulate a function of light.

        Parameters
        ----------
        values
            From (M, 3) to (M, 3).
        most : (3,) float
            Light at the last node of each axis.
        size
            Nodes along an edge.
        """
        steps = (np.arange(size) / (size - 1)) ** 2
        nodes = np.zeros((size, size, size, 4), dtype=np.float32)
        green, blue = np.meshgrid(steps * most[1], steps * most[2], indexing="ij")
        for plane, red in zip(nodes, steps * most[0], strict=True):
            light = np.stack([np.full_like(green, red), green, blue], axis=-1)
            plane[..., :3] = values(light.reshape(-1, 3)).reshape(size, size, 3)
        return cls(1 / most, nodes)

    @property
    def size(self) -> int:
        """Nodes along an edge."""
        return len(self.nodes)

    def sample(self, light: FloatArray) -> FloatArray:
        """Return the values (..., 3) at light (..., 3); beyond the last node, its value."""
        at = np.sqrt(np.clip(light * self.scale, 0, 1)) * (self.size - 1)
        corner = np.minimum(at.astype(np.int64), self.size - 2)
        share = at - corner
        order = np.argsort(-share, axis=-1, kind="stable")
        sorted_share = np.take_along_axis(share, order, axis=-1)
        flat = self.nodes.reshape(-1, 4)[:, :3]
        strides = np.array([self.size**2, self.size, 1])
        index = corner @ strides
        values = (1 - sorted_share[..., :1]) * flat[index]
        for step in range(3):
            index = index + strides[order[..., step]]
            following = sorted_share[..., step + 1 : step + 2] if step < 2 else 0.0
            values = values + (sorted_share[..., step : step + 1] - following) * flat[index]
        return np.asarray(values)

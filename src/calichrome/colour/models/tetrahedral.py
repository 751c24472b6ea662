"""Linear interpolation in tetrahedra between the discs."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import ClassVar, Self

import numpy as np
from scipy.spatial import Delaunay

from calichrome.colour.model import central_differences, to_floats
from calichrome.colour.models.linear import LinearWhite
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = ["Tetrahedral"]

_BOX = (-1.0, 8.0)
"""Balanced colours that are mapped; beyond, the nearest face's matrix goes on. Wider than any
exposure sweep."""
_CLOSE = 1e-6  # balanced: colours nearer than this are one node


@dataclass(frozen=True, eq=False)
class Tetrahedral:
    """Nodes at the discs, white, black, and the corners of a large box mapped by a matrix.

    The corners make the map continue as that matrix, roughly, where no disc is near, instead of
    being undefined outside the discs' hull.

    Parameters
    ----------
    white_rgb, white_xyz : (3,) float
        As in `TermModel`.
    nodes, values : (N, 3) float
        Balanced camera colours and what they become, over white.

    References
    ----------
    .. [1] P. Hung, "Colorimetric calibration in electronic imaging devices using a look-up-table
       model and interpolations", J. Electronic Imaging 2 (1), 1993 (tetrahedral interpolation).
    """

    white_rgb: FloatArray
    white_xyz: FloatArray
    nodes: FloatArray
    values: FloatArray

    MODEL: ClassVar[str] = "tetrahedral"
    MIN_COLOURS: ClassVar[int] = 4
    HOMOGENEOUS: ClassVar[bool] = False
    WHITE_EXACT: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name, shape in (
            ("white_rgb", (3,)), ("white_xyz", (3,)), ("nodes", (None, 3)),
            ("values", (len(self.nodes), 3)),
        ):  # fmt: skip
            object.__setattr__(self, name, frozen(checked(getattr(self, name), shape, name)))

    @classmethod
    def fit(cls, pairs: ColourPairs) -> Self:
        """Take the discs as nodes."""
        matrix, _ = fit_terms(LinearWhite, pairs)
        corners = np.array(list(product(_BOX, repeat=3)))
        far = matrix.apply(corners * pairs.white_rgb) / pairs.white_xyz
        fixed = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
        nodes = np.concatenate([fixed, corners])
        values = np.concatenate([fixed, far])
        for node, value in zip(pairs.balanced, pairs.relative, strict=True):
            if np.abs(nodes - node).max(axis=1).min() > _CLOSE:
                nodes, values = np.vstack([nodes, node]), np.vstack([values, value])
        return cls(pairs.white_rgb, pairs.white_xyz, nodes, values)

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        return int(self.values.size)

    @cached_property
    def _mesh(self) -> Delaunay:
        return Delaunay(self.nodes)

    def apply(self, rgb_linear: FloatArray) -> FloatArray:
        """Map colours of shape (..., 3)."""
        balanced = np.asarray(rgb_linear / self.white_rgb).reshape(-1, 3)
        inside = np.clip(balanced, *(np.array(_BOX) * (1 - 1e-9)))
        simplex = self._mesh.find_simplex(inside, tol=1e-9)
        transform = self._mesh.transform[simplex]
        first = np.einsum("nij,nj->ni", transform[:, :3], balanced - transform[:, 3])
        shares = np.concatenate([first, 1 - first.sum(axis=1, keepdims=True)], axis=1)
        values = np.einsum("ni,nij->nj", shares, self.values[self._mesh.simplices[simplex]])
        return np.asarray((values * self.white_xyz).reshape(np.shape(rgb_linear)))

    def jacobian(self, rgb_linear: FloatArray) -> FloatArray:
        """Return d xyz / d rgb of colours (..., 3), shape (..., 3, 3), by central differences."""
        return central_differences(self.apply, rgb_linear, self.white_rgb)

    def to_json(self) -> dict[str, object]:
        """Parameters for rig.json."""
        names = ("white_rgb", "white_xyz", "nodes", "values")
        return {name: getattr(self, name).tolist() for name in names}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        names = ("white_rgb", "white_xyz", "nodes", "values")
        return cls(*(to_floats(parameters[name]) for name in names))

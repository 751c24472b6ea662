"""Colours between the nodes of a table."""

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.kernels.table import ColourTable

_MOST = np.array([1.0, 1.5, 0.8])


def _root(light: FloatArray) -> FloatArray:
    """Linear in the coordinates of the nodes, so that any interpolation is exact."""
    matrix = np.array([[1.0, 0.2, 0.0], [-0.5, 2.0, 0.3], [0.0, 0.1, 1.0]])
    return np.asarray(np.sqrt(light / _MOST) @ matrix)


def test_linear_functions_of_the_root_are_exact(rng: np.random.Generator) -> None:
    table = ColourTable.of(_root, _MOST, 9)
    light = rng.uniform(0, 1, (500, 3)) * _MOST
    np.testing.assert_allclose(table.sample(light), _root(light), atol=1e-6)


def test_nodes_are_met_and_the_border_goes_on(rng: np.random.Generator) -> None:
    table = ColourTable.of(lambda light: light**2, _MOST, 17)
    nodes = _MOST * (rng.integers(0, 17, (200, 3)) / 16) ** 2
    np.testing.assert_allclose(table.sample(nodes), nodes**2, atol=1e-6)
    np.testing.assert_allclose(table.sample(np.array([[-0.2, 9, 0]])), [[0, 1.5**2, 0]], atol=1e-6)

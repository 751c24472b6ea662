"""Fields kept at every few pixels."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calichrome.kernels.grids import Grid


def _plane(width: int, height: int) -> NDArray[np.float32]:
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([0.5 * x - y + 3, 2 * y + 0.25 * x], axis=-1).astype(np.float32)


@pytest.mark.parametrize("size_wh", [(1, 1), (1, 9), (8, 8), (9, 17), (23, 10), (64, 2)])
def test_planes_are_exact_up_to_the_border(size_wh: tuple[int, int]) -> None:
    """Nodes beyond the last pixel are placed so that it is met."""
    plane = _plane(*size_wh)
    grid = Grid.through(plane, lambda _: True)
    assert grid.step == 8
    np.testing.assert_allclose(grid.field(), plane, atol=1e-4)


@pytest.mark.parametrize(("period", "step"), [(1000.0, 8), (150.0, 4), (12.0, 1)])
def test_step_shrinks_until_the_field_is_met(period: float, step: int) -> None:
    x = np.arange(100, dtype=np.float32)
    field = np.repeat(np.sin(2 * np.pi * x / period)[None, :, None], 12, axis=0)

    def is_close(approximate: NDArray[np.float32]) -> bool:
        return bool(np.abs(approximate - field).max() < 5e-3)

    # straight lines over a sine are off by (2 pi step / period)^2 / 8
    grid = Grid.through(field, is_close)
    assert grid.step == step
    assert is_close(grid.field())

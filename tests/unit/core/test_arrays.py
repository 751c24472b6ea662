import numpy as np
import pytest

from calichrome.core.arrays import checked, frozen


def test_shapes_are_checked_from_the_end() -> None:
    assert checked(np.zeros((7, 4, 2)), (None, 2), "pixels").shape == (7, 4, 2)
    with pytest.raises(ValueError, match=r"pixels: expected shape \(\.\.\., n, 2\), got \(4, 3\)"):
        checked(np.zeros((4, 3)), (None, 2), "pixels")
    with pytest.raises(ValueError, match=r"got \(\)"):
        checked(1.0, (3,), "trans_m")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_are_finite(value: float) -> None:
    with pytest.raises(ValueError, match="trans_m: holds a value that is not finite"):
        checked([0, value, 1], (3,), "trans_m")


def test_frozen_is_a_copy_that_cannot_be_written() -> None:
    values = np.zeros(3)
    held = frozen(values)
    values[0] = 1
    assert held[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        held[0] = 1

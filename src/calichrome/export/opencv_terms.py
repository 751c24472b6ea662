"""What the YAML of OpenCV and of ROS share: OpenCV's coefficients, and how numbers look."""

from collections.abc import Iterable

from calichrome.core.arrays import FloatArray
from calichrome.geometry.lenses import Lens

__all__ = ["distortion", "yaml_number", "yaml_numbers"]

_ORDERS = {
    "brown-conrady": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "kannala-brandt": ("k1", "k2", "k3", "k4"),
}


def distortion(lens: Lens) -> tuple[float, ...]:
    """Return the coefficients of a lens in the order of OpenCV."""
    return tuple(getattr(lens, name) for name in _ORDERS[lens.MODEL])


def yaml_number(value: float) -> str:
    """Write a float with all its digits, so that every YAML reader takes it for one.

    YAML 1.1 takes ``1e-05`` for a string: a number has a point.

    Examples
    --------
    >>> yaml_number(1500.0), yaml_number(-1e-05), yaml_number(0.1)
    ('1500.0', '-1.0e-05', '0.1')
    """
    mantissa, exponent, power = repr(float(value)).partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent}{power}"


def yaml_numbers(values: FloatArray | Iterable[float]) -> str:
    """Write a flow sequence of floats."""
    return f"[{', '.join(map(yaml_number, values))}]"

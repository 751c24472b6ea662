"""Transfer functions: what a file stores, and linear light.

Linear values are 0..1 of full scale. Each encoding is a pair of exact inverses on [0, 1]: a known
one by its name, any other as a table per channel.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Protocol, Self

import numpy as np

from calichrome.core.arrays import FloatArray, checked, frozen

__all__ = [
    "ENCODINGS",
    "Encoding",
    "EncodingName",
    "ToneCurve",
    "encode",
    "linear_table",
    "linearise",
]

EncodingName = Literal["linear", "srgb", "gamma2.2", "rec709"]


class _Curve(Protocol):
    def __call__(self, values: FloatArray, /) -> FloatArray: ...


@dataclass(frozen=True, slots=True)
class Encoding:
    """`linearise` takes stored values to linear light, `encode` back."""

    linearise: _Curve
    encode: _Curve


def _srgb_linearise(values: FloatArray) -> FloatArray:
    low = values <= 0.04045
    return np.where(low, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def _srgb_encode(values: FloatArray) -> FloatArray:
    low = values <= 0.0031308
    return np.where(low, values * 12.92, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)


# BT.709 prints 1.099 and 0.018, which leaves a step of 2.5e-4 where the two parts should meet;
# these are the exact solutions that ITU-R BT.2020-2, table 4, gives for the same curve.
_REC709_ALPHA, _REC709_BETA = 1.09929682680944, 0.018053968510807


def _rec709_linearise(values: FloatArray) -> FloatArray:
    low = values < 4.5 * _REC709_BETA
    raised = (np.maximum(values, 0) + _REC709_ALPHA - 1) / _REC709_ALPHA
    return np.where(low, values / 4.5, raised ** (1 / 0.45))


def _rec709_encode(values: FloatArray) -> FloatArray:
    low = values < _REC709_BETA
    raised = _REC709_ALPHA * np.maximum(values, 0) ** 0.45 - (_REC709_ALPHA - 1)
    return np.where(low, values * 4.5, raised)


ENCODINGS: Mapping[EncodingName, Encoding] = MappingProxyType(
    {
        "linear": Encoding(lambda values: values, lambda values: values),
        # IEC 61966-2-1:1999
        "srgb": Encoding(_srgb_linearise, _srgb_encode),
        "gamma2.2": Encoding(
            lambda values: np.maximum(values, 0) ** 2.2,
            lambda values: np.maximum(values, 0) ** (1 / 2.2),
        ),
        # ITU-R BT.709-6, item 1.2
        "rec709": Encoding(_rec709_linearise, _rec709_encode),
    }
)


_N_ENTRIES = 256  # of tables made here: one for every 8-bit number


def _nodes(count: int) -> FloatArray:
    return np.arange(count) / (count - 1)


@dataclass(frozen=True, slots=True, eq=False)
class ToneCurve:
    """An encoding given by a table per channel: estimated, or measured by the user.

    Parameters
    ----------
    linear : (3, N) float
        Linear light of each channel at the stored values k / (N - 1) of full scale, strictly
        increasing, 1 at full scale (the unit of light is free); straight lines in between. With
        N = 256 every 8-bit number has an entry of its own.
    sigma : (3, N) float
        Standard deviations of `linear`; zero where nothing is said.
    """

    linear: FloatArray
    sigma: FloatArray

    def __post_init__(self) -> None:
        linear = checked(self.linear, (3, None), "linear")
        if linear.shape[1] < 2 or not (np.diff(linear, axis=1) > 0).all():
            raise ValueError("linear: a tone curve needs two entries or more that increase")
        object.__setattr__(self, "linear", frozen(linear))
        object.__setattr__(self, "sigma", frozen(checked(self.sigma, linear.shape, "sigma")))

    @classmethod
    def from_table(cls, stored: FloatArray, linear: FloatArray) -> Self:
        """Make a curve of any increasing table, with straight lines between its entries.

        Parameters
        ----------
        stored : (M,) float
            Increasing from 0 to 1 of full scale.
        linear : (M,) or (M, 3) float
            Linear light, increasing, in any unit.

        Raises
        ------
        ValueError
            If `stored` does not increase from 0 to 1, or `linear` does not increase.
        """
        if stored[0] != 0 or stored[-1] != 1 or not (np.diff(stored) > 0).all():
            raise ValueError("stored: the values of a tone curve increase from 0 to 1")
        columns = np.broadcast_to(np.asarray(linear, dtype=np.float64).T, (3, len(stored)))
        table = np.stack([np.interp(_nodes(_N_ENTRIES), stored, column) for column in columns])
        return cls(table / table[:, -1:], np.zeros_like(table))

    def linearise(self, values: FloatArray) -> FloatArray:
        """Return the linear light of stored values (..., 3); beyond 0..1 that of the end."""
        return self._at(values, self.linear)

    def sigma_of(self, values: FloatArray) -> FloatArray:
        """Return the standard deviation of `linearise` at stored values (..., 3)."""
        return self._at(values, self.sigma)

    def encode(self, values: FloatArray) -> FloatArray:
        """Return the stored values of linear light (..., 3), 0..1 of full scale."""
        nodes = _nodes(self.linear.shape[1])
        columns = zip(np.moveaxis(values, -1, 0), self.linear, strict=True)
        return np.stack([np.interp(column, table, nodes) for column, table in columns], axis=-1)

    def _at(self, values: FloatArray, tables: FloatArray) -> FloatArray:
        nodes = _nodes(tables.shape[1])
        columns = zip(np.moveaxis(values, -1, 0), tables, strict=True)
        return np.stack([np.interp(column, nodes, table) for column, table in columns], axis=-1)

    def to_json(self) -> dict[str, object]:
        """Tables for rig.json."""
        return {"linear": self.linear.tolist(), "sigma": self.sigma.tolist()}

    @classmethod
    def from_json(cls, parameters: Mapping[str, object]) -> Self:
        """Read back what `to_json` wrote."""
        return cls(
            np.asarray(parameters["linear"], dtype=np.float64),
            np.asarray(parameters["sigma"], dtype=np.float64),
        )


def linearise(values: FloatArray, encoding: EncodingName | ToneCurve) -> FloatArray:
    """Remove an encoding; values 0..1 of full scale, any shape, but (..., 3) for a table."""
    if isinstance(encoding, ToneCurve):
        return encoding.linearise(values)
    return ENCODINGS[encoding].linearise(values)


def encode(values: FloatArray, encoding: EncodingName | ToneCurve) -> FloatArray:
    """Apply an encoding to linear values, any shape, but (..., 3) for a table.

    Negative values stay on the linear foot of the encodings that have one.
    """
    if isinstance(encoding, ToneCurve):
        return encoding.encode(values)
    return ENCODINGS[encoding].encode(values)


def linear_table(encoding: EncodingName | ToneCurve, largest: int) -> FloatArray:
    """Linear light of each channel of every number from 0 to `largest`, (largest + 1, 3)."""
    stored = np.broadcast_to(_nodes(largest + 1)[:, None], (largest + 1, 3))
    return np.array(linearise(stored, encoding))

"""Transfer functions: what a file stores, and linear light.

Linear values are 0..1 of full scale. Each encoding is a pair of exact inverses on [0, 1].
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Protocol

import numpy as np

from calichrome.core.arrays import FloatArray

__all__ = ["ENCODINGS", "Encoding", "EncodingName", "encode", "linearise"]

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


def linearise(values: FloatArray, encoding: EncodingName) -> FloatArray:
    """Remove an encoding; values 0..1 of full scale, any shape."""
    return ENCODINGS[encoding].linearise(values)


def encode(values: FloatArray, encoding: EncodingName) -> FloatArray:
    """Apply an encoding; linear values, any shape. Negative values stay on the linear foot."""
    return ENCODINGS[encoding].encode(values)

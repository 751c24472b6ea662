"""Colour models, one file each, by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from calichrome.colour.models.base import ColourModel
from calichrome.colour.models.linear import Linear
from calichrome.core.arrays import FloatArray

__all__ = ["FITS", "MODELS", "ColourModel", "Linear"]

Fit = Callable[[FloatArray, FloatArray], ColourModel]

FITS: Mapping[str, Fit] = MappingProxyType({Linear.MODEL: Linear.fit})
MODELS: Mapping[str, Callable[[Mapping[str, object]], ColourModel]] = MappingProxyType(
    {Linear.MODEL: Linear.from_json}
)

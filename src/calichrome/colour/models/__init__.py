"""Colour models, one file each, by name."""

from collections.abc import Mapping
from types import MappingProxyType

from calichrome.colour.models.base import ColourModel
from calichrome.colour.models.linear import Linear

__all__ = ["MODELS", "ColourModel", "Linear"]

MODELS: Mapping[str, type[ColourModel]] = MappingProxyType({Linear.MODEL: Linear})

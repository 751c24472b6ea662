"""Lens models, one file each, by name."""

from collections.abc import Mapping
from types import MappingProxyType

from calichrome.geometry.lenses.base import Lens
from calichrome.geometry.lenses.brown_conrady import BrownConrady

__all__ = ["LENSES", "BrownConrady", "Lens"]

LENSES: Mapping[str, type[BrownConrady]] = MappingProxyType({BrownConrady.MODEL: BrownConrady})

"""Lens models, one file each, by name."""

from collections.abc import Mapping
from types import MappingProxyType

from calichrome.geometry.lenses.base import Lens
from calichrome.geometry.lenses.brown_conrady import BrownConrady
from calichrome.geometry.lenses.kannala_brandt import KannalaBrandt
from calichrome.geometry.lenses.rational import Rational

__all__ = ["LENSES", "BrownConrady", "KannalaBrandt", "Lens", "Rational"]

LENSES: Mapping[str, type[Lens]] = MappingProxyType(
    {lens.MODEL: lens for lens in (BrownConrady, Rational, KannalaBrandt)}
)

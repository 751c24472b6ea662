"""Colour models, one file each, by name."""

from collections.abc import Mapping
from types import MappingProxyType

from calichrome.colour.model import ColourModel
from calichrome.colour.models.hue_plane import HuePlane, HuePlane2
from calichrome.colour.models.linear import Affine, Linear, LinearWhite
from calichrome.colour.models.local_regression import LocalRegression
from calichrome.colour.models.polynomial import Cheung7, Cheung10, Cheung11, Cheung20
from calichrome.colour.models.root_polynomial import (
    RootPolynomial2,
    RootPolynomial2White,
    RootPolynomial3,
    RootPolynomial3White,
)
from calichrome.colour.models.subspaces import Subspaces, SubspacesRoot
from calichrome.colour.models.tetrahedral import Tetrahedral
from calichrome.colour.models.thin_plate import ChromaticitySpline, ThinPlate, ThinPlateExact
from calichrome.colour.models.white_balance import WhiteBalance

__all__ = ["MODELS"]

_ALL: tuple[type[ColourModel], ...] = (
    WhiteBalance,
    LinearWhite,
    Linear,
    Affine,
    RootPolynomial2White,
    RootPolynomial2,
    HuePlane,
    Cheung7,
    Subspaces,
    HuePlane2,
    Cheung10,
    Cheung11,
    SubspacesRoot,
    RootPolynomial3White,
    RootPolynomial3,
    Cheung20,
    ChromaticitySpline,
    LocalRegression,
    ThinPlate,
    ThinPlateExact,
    Tetrahedral,
)
MODELS: Mapping[str, type[ColourModel]] = MappingProxyType({model.MODEL: model for model in _ALL})
"""Every model by its name."""

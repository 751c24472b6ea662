"""calichrome's models as methods of the benchmark."""

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
from benchmarks.colour.scoring import Apply, Method
from benchmarks.colour.tone import ToneMethod

from calichrome.colour.families import fit_model
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.selection import select_model
from calichrome.core.arrays import FloatArray

__all__ = ["METHODS", "TONE_METHODS"]


def _fitted(name: str, rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    return fit_model(name, _pairs(rgb, xyz, white_xyz)).apply


_EXPOSURE_KEPT = tuple(name for name, model in MODELS.items() if model.HOMOGENEOUS)
"""The others never pass the gate of stability here; trying them would only take time."""


def _auto(rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    selection = select_model(_pairs(rgb, xyz, white_xyz), _EXPOSURE_KEPT)
    if isinstance(selection, str) or selection.best.model is None:
        raise ValueError(f"auto: {selection}")
    return selection.best.model.apply


def _pairs(rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> ColourPairs:
    """No method is told the noise."""
    return ColourPairs.of(rgb, xyz, white_rgb=np.ones(3), adopted_white=white_xyz)


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        **{
            f"calichrome {name}": partial(_fitted, name)
            for name in (
                "linear-white", "root-polynomial-2-white", "root-polynomial-3-white", "hue-plane",
                "subspaces", "local-regression", "chromaticity-spline", "tetrahedral",
            )
        },
        "auto": _auto,
    }
)  # fmt: skip
TONE_METHODS: Mapping[str, ToneMethod] = MappingProxyType({})

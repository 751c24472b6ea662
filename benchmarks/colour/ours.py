"""calichrome's models as methods of the benchmark."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
from benchmarks.colour.scoring import Apply, Method
from benchmarks.colour.tone import ToneMethod, ToneShot

from calichrome.colorimetry.encoding import EncodingName, ToneCurve, linearise
from calichrome.colour.families import fit_model
from calichrome.colour.light import light_at
from calichrome.colour.linearisation import estimate_curve
from calichrome.colour.model import ColourModel
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.samples import collect_samples, combine_views
from calichrome.colour.selection import select_model
from calichrome.core.arrays import FloatArray
from calichrome.observations import DiscSamples

__all__ = ["METHODS", "TONE_METHODS", "auto_model"]


def _fitted(name: str, rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    return fit_model(name, _pairs(rgb, xyz, white_xyz)).apply


_EXPOSURE_KEPT = tuple(name for name, model in MODELS.items() if model.HOMOGENEOUS)
"""The others never pass the gate of stability here; trying them would only take time."""


def auto_model(rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> ColourModel:
    """Return the model that is chosen for camera colours with white at 1."""
    selection = select_model(_pairs(rgb, xyz, white_xyz), _EXPOSURE_KEPT)
    if isinstance(selection, str) or selection.best.model is None:
        raise ValueError(f"auto: {selection}")
    return selection.best.model


def _auto(rgb: FloatArray, xyz: FloatArray, white_xyz: FloatArray) -> Apply:
    return auto_model(rgb, xyz, white_xyz).apply


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


def _unknown_curve(shot: ToneShot) -> Apply | None:
    """Estimate the tone curve, then fit as usual; None where no curve explains the pictures."""
    discs = [view.discs for view in shot.views.values() if view.discs is not None]
    estimate = estimate_curve(
        np.concatenate([item.mean_rgb for item in discs]),
        np.concatenate([light_at(item.centres_px, item.white_rgb) for item in discs]),
        np.concatenate([item.marker_ids for item in discs]),
        shot.train_xyz,
        shot.paper_xyz,
    )
    if isinstance(estimate, str) or estimate.doubts is not None:
        return None
    encoding = estimate.encoding
    samples = collect_samples(
        {
            frame: replace(view, discs=None if view.discs is None else _read(view.discs, encoding))
            for frame, view in shot.views.items()
        },
        shot.target,
    )
    if samples is None:
        return None
    means = combine_views(samples, len(shot.train_xyz))
    seen = means.n_views > 0
    pairs = ColourPairs.of(
        means.mean_rgb[seen] / samples.reference_light_rgb,
        shot.train_xyz[seen],
        white_rgb=np.ones(3),
        white_xyz=shot.paper_xyz,
        adopted_white=shot.white_xyz,
    )
    selection = select_model(pairs, _EXPOSURE_KEPT)
    if isinstance(selection, str) or selection.best.model is None:
        return None
    model, white = selection.best.model, linearise(shot.reference_white, encoding)
    return lambda stored: model.apply(linearise(stored, encoding) / white)


def _read(discs: DiscSamples, encoding: EncodingName | ToneCurve) -> DiscSamples:
    return replace(
        discs,
        mean_rgb=linearise(discs.mean_rgb, encoding),
        white_rgb=linearise(discs.white_rgb, encoding),
        black_rgb=linearise(discs.black_rgb, encoding),
    )


TONE_METHODS: Mapping[str, ToneMethod] = MappingProxyType({"auto, curve unknown": _unknown_curve})

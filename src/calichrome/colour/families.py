"""Fit any model by its name, and tell what it predicts for colours it was not given."""

import numpy as np

from calichrome.colour.model import ColourModel, TermModel
from calichrome.colour.models import MODELS
from calichrome.colour.models.local_regression import LocalRegression
from calichrome.colour.models.tetrahedral import Tetrahedral
from calichrome.colour.models.thin_plate import ThinPlate
from calichrome.colour.models.white_balance import WhiteBalance
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.regression import fit_terms
from calichrome.core.arrays import FloatArray

__all__ = ["fit_model", "leave_one_out", "needed_colours"]


def fit_model(name: str, pairs: ColourPairs, *, mean_error: bool = False) -> ColourModel:
    """Fit a model.

    Parameters
    ----------
    name
        One of `MODELS`.
    pairs
        At least `needed_colours(name)` colours.
    mean_error
        Minimise the mean difference in the description space instead of the squared one; only
        models that are linear in their parameters can.

    Raises
    ------
    ValueError
        For an unknown name, or too few colours.
    """
    if name not in MODELS:
        raise ValueError(f"colour model {name!r} is unknown; choose from {', '.join(MODELS)}")
    model = MODELS[name]
    if len(pairs) < model.MIN_COLOURS:
        raise ValueError(f"{name} needs {model.MIN_COLOURS} colours, got {len(pairs)}")
    if model is WhiteBalance:
        return WhiteBalance(pairs.white_rgb, pairs.white_xyz, np.empty((0, 3)))
    if issubclass(model, TermModel):
        return fit_terms(model, pairs, mean_error=mean_error)[0]
    assert issubclass(model, (ThinPlate, Tetrahedral, LocalRegression))  # noqa: S101
    return model.fit(pairs)


def needed_colours(name: str) -> int:
    """Different colours for a fit whose error can be told: one may be left out."""
    return MODELS[name].MIN_COLOURS + 1


def leave_one_out(name: str, pairs: ColourPairs, *, mean_error: bool = False) -> FloatArray:
    """Predict each colour from the others, (N, 3) XYZ; strengths are found anew each time."""
    predicted = np.empty_like(pairs.xyz)
    everything = np.arange(len(pairs))
    for row in everything:
        model = fit_model(name, pairs[everything != row], mean_error=mean_error)
        predicted[row] = model.apply(pairs.rgb[row])
    return predicted

"""All cameras of a rig together: what a disc looks like is one unknown that they share.

A print is never what its table says. Each disc has a latent colour z, nominal up to the tolerance
of the print, and every camera's model must map what it saw to the same z:

    minimise  sum_c sum_d |f_c(rgb_cd) - z_d|^2_(E_cd) + sum_d |z_d - nominal_d|^2_(P_d)

With the models fixed z is a weighted mean, with z fixed each camera is fitted as usual; taking
turns lowers the sum every time.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calichrome.colorimetry.description import difference
from calichrome.colour.families import fit_model
from calichrome.colour.model import ColourModel
from calichrome.colour.pairs import ColourPairs
from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["JointColour", "fit_together"]

_ROUNDS = 30
_SETTLED = 1e-3  # largest change of a latent colour, dE: far below what is told apart


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointColour:
    """Models that agree on the discs.

    Parameters
    ----------
    models
        By camera.
    latent_xyz : (D, 3) float
        What the discs look like, by all cameras and the table.
    """

    models: Mapping[str, ColourModel]
    latent_xyz: FloatArray


def fit_together(
    pairs: Mapping[str, ColourPairs],
    colours: Mapping[str, IntArray],
    names: Mapping[str, str],
    nominal_xyz: FloatArray,
    nominal_cov: FloatArray,
    *,
    start: FloatArray | None = None,
    share: bool = True,
    mean_error: bool = False,
) -> JointColour:
    """Fit all cameras and the discs' colours.

    Parameters
    ----------
    pairs
        By camera; their targets are the nominal colours.
    colours
        By camera: which disc each pair is, 0..D-1.
    names
        Model of each camera.
    nominal_xyz : (D, 3) float
    nominal_cov : (D, 3, 3) float
        Tolerance of the print.
    start : (D, 3) float, optional
        Colours to begin with, from a fit that is nearly the same.
    share
        False: the colours are nominal, every camera stands alone.
    mean_error
        As in `fit_model`.
    """

    def fitted(camera: str, targets_xyz: FloatArray) -> tuple[ColourModel, ColourPairs]:
        own = pairs[camera]
        given = own.with_targets(targets_xyz[colours[camera]], np.zeros((len(own), 3, 3)))
        return fit_model(names[camera], given, mean_error=mean_error), given

    if not share:
        models = {camera: fitted(camera, nominal_xyz)[0] for camera in pairs}
        return JointColour(models=models, latent_xyz=nominal_xyz)
    prior = np.linalg.inv(nominal_cov)
    latent = nominal_xyz if start is None else start
    models = {}
    for _ in range(_ROUNDS):
        weight, weighted = prior.copy(), np.einsum("dij,dj->di", prior, nominal_xyz)
        for camera, rows in colours.items():
            models[camera], given = fitted(camera, latent)
            precision = np.linalg.inv(given.errors_of_fit)
            seen = models[camera].apply(given.rgb)
            np.add.at(weight, rows, precision)
            np.add.at(weighted, rows, np.einsum("nij,nj->ni", precision, seen))
        before, latent = latent, np.linalg.solve(weight, weighted[..., None])[..., 0]
        if _largest_step(next(iter(pairs.values())), latent, before) < _SETTLED:
            break
    return JointColour(models=models, latent_xyz=latent)


def _largest_step(like: ColourPairs, after: FloatArray, before: FloatArray) -> float:
    return float(difference(after, before, like.space, like.adopted_white).max())

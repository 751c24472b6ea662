"""Camera colour to target colour, with honest errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.models import MODELS, ColourModel
from calichrome.colour.samples import ColourSamples, disc_means
from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.target import Target

__all__ = ["ColourSolution", "between_cameras", "fit_colour"]


_GREY = 1e-6  # of full scale, between channels: below the rounding of any file


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourSolution:
    """A camera's colour.

    Parameters
    ----------
    model
        Linear camera RGB to XYZ under D65.
    disc_rgb : (n_markers, 3) float
        Mean over views in the reference light; nan for discs that were never usable.
    disc_xyz : (n_markers, 3) float
        The same, corrected.
    fit_delta_e, held_out_delta_e : (n_markers,) float
        CIEDE2000 against the target; held out: with that disc left out of the fit. nan: unseen.
    white_rgb : (3,) float
        Camera value of the white squares in the reference light.
    n_rejected
        Rows that disagree with the other views of their disc.
    n_clipped
        Rows that hold clipped pixels.
    """

    model: ColourModel
    disc_rgb: FloatArray
    disc_xyz: FloatArray
    fit_delta_e: FloatArray
    held_out_delta_e: FloatArray
    white_rgb: FloatArray
    n_rejected: int
    n_clipped: int


def fit_colour(
    samples: ColourSamples, target: Target, model: str = "linear"
) -> ColourSolution | str:
    """Fit one camera.

    Parameters
    ----------
    samples
        All disc samples of the camera.
    target
        Reference colours.
    model
        A name in `MODELS`.

    Returns
    -------
    ColourSolution or str
        The sentence says what is missing for a fit.
    """
    reference = target.marker_xyz_d65
    disc_rgb, n_views, n_rejected = disc_means(samples, len(reference))
    seen = n_views > 0
    if seen.any() and np.ptp(disc_rgb[seen], axis=1).max() < _GREY:
        return "its pictures are grey: all three channels are equal"
    # a fit needs as many colours as it has free parameters per channel, one more may be left out,
    # and one more to show an error
    least = MODELS[model].MIN_COLOURS + 2
    distinct = len(np.unique(reference[seen], axis=0))
    if distinct < least:
        return f"only {distinct} different colours are usable, a {model} fit needs {least}"

    def fit(chosen: BoolArray) -> ColourModel:
        rgb, xyz = disc_rgb[chosen], reference[chosen]
        if target.paper.white_xyz_d65 is not None:  # the white squares are one colour more
            rgb = np.concatenate([rgb, samples.reference_light_rgb[None]])
            xyz = np.concatenate([xyz, [target.paper.white_xyz_d65]])
        return MODELS[model].fit(rgb, xyz)

    fitted = fit(seen)
    disc_xyz = fitted.apply(disc_rgb)
    held_out = np.full(len(reference), np.nan)
    for index in np.flatnonzero(seen):
        # discs that repeat a colour go together, or the disc would be predicted by its twin
        same = (reference == reference[index]).all(axis=1)
        predicted = fit(seen & ~same).apply(disc_rgb[index])
        held_out[index] = delta_e_2000_xyz(predicted, reference[index])
    return ColourSolution(
        model=fitted,
        disc_rgb=disc_rgb,
        disc_xyz=disc_xyz,
        fit_delta_e=delta_e_2000_xyz(disc_xyz, reference),
        held_out_delta_e=held_out,
        white_rgb=samples.reference_light_rgb,
        n_rejected=n_rejected,
        n_clipped=int((samples.clipped > 0).sum()),
    )


def between_cameras(solutions: Mapping[str, ColourSolution]) -> FloatArray:
    """CIEDE2000 of every disc between every two cameras that see it, one value each."""
    parts = []
    for a, b in combinations(solutions.values(), 2):
        difference = delta_e_2000_xyz(a.disc_xyz, b.disc_xyz)
        parts.append(difference[np.isfinite(difference)])
    return np.concatenate(parts) if parts else np.empty(0)

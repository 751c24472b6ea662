"""Colour without our board: one camera from one chart of known colours."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Protocol, Self

import numpy as np

from calichrome.colorimetry.description import DescriptionSpace, difference
from calichrome.colour.chart_light import DISAGREES, ChartLight, agreeing, find_light
from calichrome.colour.checks import grey_slope
from calichrome.colour.model import ColourModel
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.selection import AUTO, Candidate, select_model
from calichrome.core.arrays import BoolArray, FloatArray, checked
from calichrome.core.findings import Finding, finding
from calichrome.target import PaletteColour

__all__ = ["ChartFit", "Patches", "fit"]

_DRAWN = 4  # patches without which `agreeing` cannot tell who is wrong
_MOST_CLIPPED = 0.01  # share of a patch's pixels: some hot pixels do no harm
_MOST_WRONG = 1 / 8
"""Share of the patches that may disagree with the others before the chart as a whole is not
believed. Of 153 cameras and lights whose values went through a random webcam (tone curve,
saturation; read as sRGB) 3 had more; of 51 with 5 patches covered by a leaf all but one, with 8
all."""
_SLOPE_TOLERANCE = 0.12  # of the greys' exponent about 1: as for discs, set on rendered boards
_POOR = 5.7
"""Mean leave-one-out dE2000 of a matrix from which the values are not believed to be linear: of 51
cameras under 3 lights the worst has 5.6; sRGB taken for linear gives 5.7 to 8.3, the reverse 6.9 to
8.7."""
_THICK_VEIL = 0.15
"""Of white, from which it is taken for a wrong encoding: sRGB taken for linear looks like one of
0.26 to 0.30; stray light in a lens and the gloss of a card are a few hundredths."""
_MATRICES = ("linear", "linear-white")
_UNEVEN = 0.1  # share of light over the chart from which its user is told; chosen


class Patches(Protocol):
    """What is read from a picture of a chart, as `calichrome.detection.CardReading` has it."""

    @property
    def rgb(self) -> FloatArray:
        """Linear camera values (N, 3), nan where a patch was not seen."""

    @property
    def rgb_cov(self) -> FloatArray:
        """Covariance of `rgb`, (N, 3, 3)."""

    @property
    def clipped(self) -> FloatArray:
        """Share of each patch's pixels that are clipped, (N,)."""

    @property
    def places(self) -> FloatArray:
        """Where the patches are on the chart, (N, 2), about its middle; any unit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChartFit:
    """A camera's colour from a chart.

    Parameters
    ----------
    model
        Linear camera RGB in even light, veil removed, to XYZ under D65.
    light
        What was taken from the picture of the chart before the fit.
    candidates
        All models that were tried.
    xyz, left_out_xyz : (N, 3) float
        Of each patch by the model, and by one fitted to the others; nan where not seen.
    fit_delta_e, left_out_delta_e : (N,) float
        Their differences from the reference in the description space. A patch that was not used is
        left out of both.
    reasons : (N,)
        Why a patch was not used; "" if it was.
    doubts
        What the numbers say against the result.
    """

    model: ColourModel
    light: ChartLight
    candidates: tuple[Candidate, ...]
    xyz: FloatArray
    left_out_xyz: FloatArray
    fit_delta_e: FloatArray
    left_out_delta_e: FloatArray
    reasons: tuple[str, ...]
    doubts: tuple[Finding, ...]

    @property
    def trustworthy(self) -> bool:
        """Whether no doubt is critical."""
        return all(doubt.severity != "critical" for doubt in self.doubts)

    @property
    def used(self) -> BoolArray:
        """Patches the model was fitted to, (N,)."""
        return np.array([not reason for reason in self.reasons])

    def xyz_from_rgb(self, rgb_linear: FloatArray) -> FloatArray:
        """XYZ under D65 of camera values (..., 3) from the same picture, Y = 1: perfect diffuser.

        The chart's veil is removed; its light is that of the chart's middle.
        """
        return self.model.apply(rgb_linear - self.light.veil_rgb)


def fit(
    samples: FloatArray | Patches,
    reference: FloatArray | Sequence[PaletteColour],
    *,
    white: FloatArray | None = None,
    model: str = "auto",
    space: DescriptionSpace = "lab2000",
    priorities: Mapping[str, float] = MappingProxyType({}),
    reference_cov: FloatArray | None = None,
    mean_error: bool = False,
) -> ChartFit | str:
    """Fit a camera to a chart.

    Parameters
    ----------
    samples : (N, 3) float or Patches
        Linear camera values of the patches. With `Patches`, clipped ones are left out, noisy ones
        count less, and light that changes over the chart is told from their places.
    reference : (N, 3) float or colours with names
        XYZ under D65 of the same patches, Y = 1 for the perfect diffuser.
    white : (3,) float, optional
        Camera value of the perfect diffuser; default: from the greys of the chart.
    model
        A name in `MODELS`, or "auto": the smallest leave-one-out error among the stable ones.
    space
        Description space, in which errors are judged.
    priorities
        Weights of patches by name, or by number from "0" where the reference has no names.
    reference_cov : (N, 3, 3) float, optional
        Covariance of the reference.
    mean_error
        Minimise the mean error in the description space instead of the squared one.

    Returns
    -------
    ChartFit or str
        The sentence says what is missing for a fit. A fit that the patches contradict is
        returned with a critical doubt.

    Raises
    ------
    ValueError
        For arrays of the wrong shape, an unknown model, or an unknown name in `priorities`.

    Examples
    --------
    >>> import numpy as np
    >>> xyz = np.random.default_rng(0).uniform(0.05, 0.9, (12, 3))
    >>> seen = xyz @ np.array([[0.8, 0.1, 0], [0.2, 0.7, 0.1], [0, 0.1, 0.6]])
    >>> fitted = fit(seen, xyz, model="linear")
    >>> bool(fitted.fit_delta_e.max() < 0.01)
    True
    """
    if model != "auto" and model not in MODELS:
        raise ValueError(f"model: {model!r} is unknown; choose auto or one of {', '.join(MODELS)}")
    chart = _Chart.of(samples, reference, priorities, reference_cov, space)
    usable = np.array([not reason for reason in chart.reasons])
    names = AUTO if model == "auto" else (model,)
    least = max(min(MODELS[name].MIN_COLOURS for name in names), _DRAWN) + 1
    if usable.sum() < least:
        return f"only {usable.sum()} of {len(usable)} patches are usable; {model} needs {least}"
    if (chart.rgb[usable].max(axis=0) <= 0).any() or np.ptp(chart.rgb[usable], axis=1).max() == 0:
        return "a channel shows no light, or all three are equal; a fit needs a colour picture"
    agree = usable.copy()
    agree[usable] = agreeing(chart.pairs(chart.rgb, usable, white), chart.places[usable])
    if agree.sum() < least:
        return (
            f"only {agree.sum()} of {usable.sum()} patches agree with each other; show the whole "
            f"chart in one light, and give the reference of this very chart"
        )
    light = find_light(chart.pairs(chart.rgb, agree, white), chart.places[agree])
    even = light.removed(chart.rgb, chart.places)
    white = None if white is None else white - light.veil_rgb
    pairs = chart.pairs(even, agree, white)
    if not (pairs.white_rgb > 0).all():
        return "white has no positive value in all three channels; give the camera value of white"
    selection = select_model(pairs, names, mean_error=mean_error)
    if isinstance(selection, str):
        return selection
    best = selection.best
    assert best.model is not None  # noqa: S101 (the winner was fitted)
    xyz = best.model.apply(even)
    left_out = xyz.copy()
    left_out[agree] = best.left_out
    found = ChartFit(
        model=best.model,
        light=light,
        candidates=selection.candidates,
        xyz=xyz,
        left_out_xyz=left_out,
        fit_delta_e=difference(xyz, chart.xyz, space),
        left_out_delta_e=difference(left_out, chart.xyz, space),
        reasons=tuple(
            reason or ("" if agrees else "disagrees with the others")
            for reason, agrees in zip(chart.reasons, agree, strict=True)
        ),
        doubts=(),
    )
    return replace(found, doubts=tuple(_judge(found, chart, even)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Chart:
    """Samples and reference, row by row."""

    names: tuple[str, ...]
    rgb: FloatArray
    rgb_cov: FloatArray
    xyz: FloatArray
    xyz_cov: FloatArray
    places: FloatArray
    weights: FloatArray
    reasons: tuple[str, ...]
    space: DescriptionSpace

    @classmethod
    def of(
        cls,
        samples: FloatArray | Patches,
        reference: FloatArray | Sequence[PaletteColour],
        priorities: Mapping[str, float],
        reference_cov: FloatArray | None,
        space: DescriptionSpace,
    ) -> Self:
        if isinstance(reference, np.ndarray):
            xyz, names = reference, tuple(map(str, range(len(reference))))
        else:
            xyz = np.array([colour.xyz_d65 for colour in reference])
            names = tuple(colour.name for colour in reference)
        n = len(checked(xyz, (None, 3), "reference"))
        if isinstance(samples, np.ndarray):
            rgb, cov = samples, np.zeros((n, 3, 3))
            clipped, places = np.zeros(n), np.zeros((n, 2))
        else:
            rgb, cov = samples.rgb, samples.rgb_cov
            clipped, places = samples.clipped, samples.places
        if rgb.shape != (n, 3):
            raise ValueError(f"samples: expected shape ({n}, 3) as the reference, got {rgb.shape}")
        if unknown := set(priorities) - set(names):
            raise ValueError(f"priorities: no patch is called {', '.join(sorted(unknown))}")
        seen: BoolArray = np.asarray(np.isfinite(rgb).all(axis=1))
        return cls(
            names=names,
            rgb=rgb,
            rgb_cov=cov,
            xyz=np.asarray(xyz, dtype=np.float64),
            xyz_cov=np.zeros((n, 3, 3)) if reference_cov is None else reference_cov,
            places=places,
            weights=np.array([priorities.get(name, 1.0) for name in names]),
            reasons=tuple(
                "not seen" if not is_seen else "clipped" if share > _MOST_CLIPPED else ""
                for is_seen, share in zip(seen, clipped, strict=True)
            ),
            space=space,
        )

    def pairs(self, rgb: FloatArray, rows: BoolArray, white: FloatArray | None) -> ColourPairs:
        """Return some rows, `rgb` in place of the samples."""
        return ColourPairs.of(
            rgb[rows], self.xyz[rows], white_rgb=white, rgb_cov=self.rgb_cov[rows],
            xyz_cov=self.xyz_cov[rows], weights=self.weights[rows], space=self.space,
        )  # fmt: skip


def _judge(found: ChartFit, chart: _Chart, even: FloatArray) -> Iterator[Finding]:
    """Yield what speaks against a fit."""
    clipped = [
        name for name, why in zip(chart.names, found.reasons, strict=True) if why == "clipped"
    ]
    if clipped:
        yield finding(
            "clipped_discs",
            f"{len(clipped)} patches are clipped and were left out: {', '.join(clipped)}. Shorten "
            f"the exposure.",
            n_clipped=len(clipped),
        )
    yield from _contradictions(found, chart)
    used = found.used
    mean = min((one.mean for one in found.candidates if one.name in _MATRICES), default=0.0)
    slope = grey_slope(even[used] / even[used].max(), chart.xyz[used])
    veil = float((found.light.veil_rgb / chart.rgb[used].max(axis=0)).max())
    why = ""
    if slope is not None and abs(slope - 1) > _SLOPE_TOLERANCE:
        why = f"the greys follow the reference with exponent {slope:.2f} instead of 1"
    elif veil > _THICK_VEIL:
        why = f"all values seem to be raised by {veil:.0%} of white"
    elif mean > _POOR:
        why = f"a matrix misses patches it was not fitted to by {mean:.1f} dE on average"
    if why:
        yield finding(
            "encoding_doubtful",
            f"The values are hardly linear light: {why}. State the true encoding, or turn off "
            f"contrast and gamma.",
        )
    lit = found.light.at(chart.places[used])
    if (uneven := float(1 - lit.min() / lit.max())) > _UNEVEN:
        yield finding(
            "uneven_light",
            f"The light falls off by {uneven:.0%} over the chart; it was evened by a plane. "
            f"Light the chart from farther away.",
            share=uneven,
        )


def _contradictions(found: ChartFit, chart: _Chart) -> Iterator[Finding]:
    """Yield which patches cannot be what the reference says."""
    wrong = [
        (name, float(error))
        for name, error, why in zip(chart.names, found.fit_delta_e, found.reasons, strict=True)
        if why.startswith("disagrees")
    ]
    if not wrong:
        return
    named = ", ".join(f"{name} ({error:.0f})" for name, error in wrong)
    n_seen = len(wrong) + int(found.used.sum())
    if len(wrong) > _MOST_WRONG * n_seen:
        yield finding(
            "target_contradicted",
            f"{len(wrong)} of {n_seen} patches are missed by more dE than any camera misses one "
            f"({DISAGREES:g}): {named}. The chart is partly covered, in two lights, or not that of "
            f"the reference; do not trust the fit.",
            n_wrong=len(wrong),
        )
    else:
        yield finding(
            "outliers_left_out",
            f"{len(wrong)} of {n_seen} patches disagree with the others and were left out (dE in "
            f"brackets): {named}.",
            n_wrong=len(wrong),
        )

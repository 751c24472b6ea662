"""The tone curve of a camera, from a board of colours under changing light.

What the board tells: the same disc beside the same white at many levels of light, greys whose
ratios are known, and colours that a sensor must see nearly as the standard observer does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.difference import lab_from_xyz
from calichrome.colorimetry.encoding import ENCODINGS, EncodingName, ToneCurve, linear_table
from calichrome.colour.tone_fit import ToneFit, fit_tones
from calichrome.colour.tone_problem import ToneData
from calichrome.colour.tone_spline import (
    N_PARAMETERS,
    ToneSamples,
    known_at,
    spline_at,
    spline_light,
)
from calichrome.core.arrays import BoolArray, FloatArray, IntArray

__all__ = ["CurveEstimate", "estimate_curve", "lightness_error"]

_FEWEST_COLOURS = 8  # below, the relation to the nominal colours leaves the curve open
_ENOUGH_FOR_ROOTS = 15  # colours: root-polynomial terms, which leave a third of the mismatch
_BLACK, _FULL = 1.5 / 255, 0.995  # stored; numbers outside are clipped
_ROUNDING = 0.1 / 255
"""Least sigma of a stored mean: what rounding to 8 bit leaves where noise and shading dither it."""

_MARGIN = 10.0  # by which the log evidence of a freer curve must be higher
_SAME_LIGHTNESS = 0.5
"""In L*: a known encoding that is so near to the free curve is taken, though it be less likely: the
difference may be blur or flare, and it holds beyond the values seen, too."""
_FEWEST_DRIFTS = 12  # discs times channels that tell whether the level matters; a ColorChecker: 72
_LEVEL_DEPENDENCE = 0.03
"""Relative change of disc over white, rms, per e-fold of light, from which no curve explains the
pictures. Set on simulated boards (Munsell set): 0.011 at most for curves alone, whatever their
shape; saturation by a matrix after an S-shaped curve 0.02 (x1.3) to 0.08 (x1.6), at up to 0.03 of
which the estimated curve is still good for 0.3 dE2000 more than the true one."""

_MISMATCH = 0.06
"""Relative mismatch of greys from which no curve explains the pictures: sensors cause 0.006, prints
with errors of sd 1 in L, a, b 0.02, of sd 3 0.03 to 0.055 (simulated boards)."""

_N_NODES = 256  # of the table: one for every 8-bit number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveEstimate:
    """A camera's tone curve, and whether there is one.

    Parameters
    ----------
    encoding
        The name of a known encoding if one explains the pictures as well as a free curve, else the
        curve.
    deviations : (R, 3, N) float
        Independent deviations of the curve's tables, one standard deviation each; the level is
        held at the median white. R = 0 for a known encoding.
    covered : (3, 2) float
        Least and largest stored value seen in each channel: the rest is extrapolated.
    flare : (3,) float
        Light that lay on everything, as a share of the white's.
    mismatch
        How far greys are off their nominal colours after the curve, relative light.
    level_dependence
        How much disc over white changes with the level of light after the curve, relative light
        per e-fold, rms; None if the level hardly changed.
    evidence
        Of every candidate: its log probability, up to a constant.
    """

    encoding: EncodingName | ToneCurve
    deviations: FloatArray
    covered: FloatArray
    flare: FloatArray
    mismatch: float
    level_dependence: float | None
    evidence: Mapping[str, float]

    @property
    def doubts(self) -> str | None:
        """Why no tone curve per channel explains the pictures; None if one does."""
        if self.level_dependence is not None and self.level_dependence > _LEVEL_DEPENDENCE:
            return (
                f"whatever the tone curve, discs change by {100 * self.level_dependence:.0f} % "
                f"against the white beside them when the light changes by a factor of e: the "
                f"camera mixes the channels after its tone curve, or changes the curve by itself"
            )
        if self.mismatch > _MISMATCH:
            return (
                f"whatever the tone curve, greys are off their nominal levels by "
                f"{100 * self.mismatch:.0f} %: the target's colours or the white squares are wrong"
            )
        return None


def estimate_curve(
    stored_rgb: FloatArray,
    light_rgb: FloatArray,
    disc_ids: IntArray,
    nominal_xyz: FloatArray,
    white_xyz: FloatArray | None,
    *,
    stored_sigma: FloatArray | None = None,
    light_sigma: FloatArray | None = None,
    nominal_sigma: FloatArray | float = 0.0,
) -> CurveEstimate | str:
    """Estimate how light became numbers.

    Parameters
    ----------
    stored_rgb, light_rgb : (M, 3) float
        Means of discs and of the white beside them, as stored, 0..1 of full scale. Rows that are
        not finite or clipped are left out.
    disc_ids : (M,) int
        Which disc, 0..K-1.
    nominal_xyz : (K, 3) float
        Under D65, Y = 1 for the perfect diffuser.
    white_xyz : (3,) float or None
        The same of the white squares; None: not known.
    stored_sigma, light_sigma : (M, 3) float, optional
        Standard deviations of the means; rounding is added.
    nominal_sigma : (K,) float or float
        Relative standard deviations of the nominal colours: 0.03 is about 1 in L*.

    Returns
    -------
    CurveEstimate or str
        The sentence says what is missing.

    Notes
    -----
    Any power of the right curve leaves disc over white the same at every level of light; the power
    is found from the nominal colours alone, the shape from both.
    """
    white = D65 if white_xyz is None else white_xyz
    usable = np.isfinite(stored_rgb).all(axis=1) & np.isfinite(light_rgb).all(axis=1)
    both = np.concatenate([stored_rgb, light_rgb], axis=1)
    usable = np.asarray(usable & ((both > _BLACK) & (both < _FULL)).all(axis=1))
    seen, disc = np.unique(disc_ids[usable], return_inverse=True)
    nominal = nominal_xyz[seen]
    _, colour, copies = np.unique(nominal, axis=0, return_inverse=True, return_counts=True)
    if len(copies) < _FEWEST_COLOURS:
        return (
            f"only {len(copies)} different colours are usable, a tone curve needs {_FEWEST_COLOURS}"
        )
    terms = _root_terms if len(copies) >= _ENOUGH_FOR_ROOTS else np.asarray
    lab = lab_from_xyz(nominal / white * D65)
    data = ToneData(
        stored=stored_rgb[usable],
        light=light_rgb[usable],
        sigma=_with_rounding(stored_sigma, usable),
        light_sigma=_with_rounding(light_sigma, usable),
        disc=disc.astype(np.int64),
        terms=terms(nominal / white),
        white_terms=terms(np.ones((0 if white_xyz is None else 1, 3))),
        chroma=np.hypot(lab[:, 1], lab[:, 2]),
        copies=copies[colour.ravel()].astype(np.float64),
        nominal_sigma=np.broadcast_to(nominal_sigma, len(nominal_xyz))[seen],
    )
    known: dict[EncodingName, ToneFit] = {}
    for name in ENCODINGS:
        fit = fit_tones(data, partial(_known_at, name), 0)
        if fit is not None:
            known[name] = fit
    free: dict[str, ToneFit] = {}
    for kind, n_curves in (("one curve", 1), ("a curve per channel", 3)):
        fit = fit_tones(data, spline_at, n_curves)
        if fit is not None:
            free[kind] = fit
    if not free:
        return "its discs leave the tone curve open"
    return _chosen(data, known, free)


def lightness_error(
    encoding: EncodingName | ToneCurve,
    truth: EncodingName | ToneCurve,
    white_stored: FloatArray,
    covered: FloatArray,
) -> float:
    """Tell how wrong greys come out when pictures are read with another encoding.

    Parameters
    ----------
    encoding, truth
        What is assumed, and what is the case.
    white_stored : (3,) float
        Stored value of the white.
    covered : (3, 2) float
        Stored values of each channel that count, least and largest.

    Returns
    -------
    float
        The largest difference in L* over channels and levels, both with the same white.
    """
    stored = np.arange(_N_NODES) / (_N_NODES - 1)
    lightness = []
    for curve in (encoding, truth):
        table = linear_table(curve, _N_NODES - 1)
        level = [np.interp(white_stored[c], stored, table[:, c]) for c in range(3)]
        relative = np.maximum(table / level, 0)
        lightness.append(lab_from_xyz(relative[..., None] * D65)[..., 0])
    inside = (stored[:, None] >= covered[:, 0]) & (stored[:, None] <= covered[:, 1])
    return float(np.abs(lightness[0] - lightness[1])[inside].max(initial=0.0))


def _root_terms(xyz: FloatArray) -> FloatArray:
    """Root-polynomial terms of degree 2 of colours (K, 3), (K, 6): Finlayson et al., 2015."""
    x, y, z = np.maximum(xyz, 0).T
    return np.stack([x, y, z, np.sqrt(x * y), np.sqrt(y * z), np.sqrt(z * x)], axis=1)


def _with_rounding(sigma: FloatArray | None, usable: BoolArray) -> FloatArray:
    if sigma is None:
        return np.full((int(usable.sum()), 3), _ROUNDING)
    return np.asarray(np.hypot(sigma[usable], _ROUNDING))


def _known_at(name: EncodingName, _: FloatArray, stored: FloatArray) -> ToneSamples:
    return known_at(name, stored)


def _chosen(
    data: ToneData, known: Mapping[EncodingName, ToneFit], free: Mapping[str, ToneFit]
) -> CurveEstimate:
    """Take a known encoding rather than one curve, and one curve rather than three."""
    best, *freer = free.values()
    for fit in freer:
        if fit.evidence > best.evidence + _MARGIN:
            best = fit
    lowest = np.minimum(data.stored.min(axis=0), data.light.min(axis=0))
    highest = np.maximum(data.stored.max(axis=0), data.light.max(axis=0))
    covered = np.stack([lowest, highest], axis=1)
    white = np.median(data.light, axis=0)
    encoding: EncodingName | ToneCurve
    encoding, deviations = _tables(best, white)
    if known:
        name = max(known, key=lambda name: known[name].evidence)
        as_likely = known[name].evidence + _MARGIN >= best.evidence
        if as_likely or lightness_error(name, encoding, white, covered) < _SAME_LIGHTNESS:
            encoding, deviations, best = name, deviations[:0], known[name]
    n_told = int((best.drift_noise < _LEVEL_DEPENDENCE).sum())
    return CurveEstimate(
        encoding=encoding,
        deviations=deviations,
        covered=covered,
        flare=best.flare,
        mismatch=best.mismatch,
        level_dependence=best.drift if n_told >= _FEWEST_DRIFTS else None,
        evidence={name: fit.evidence for name, fit in (*known.items(), *free.items())},
    )


def _tables(fit: ToneFit, white: FloatArray) -> tuple[ToneCurve, FloatArray]:
    """Tabulate the curves and their deviations."""
    stored = np.arange(_N_NODES) / (_N_NODES - 1)
    values, vectors = np.linalg.eigh(fit.covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0))  # (n_own, R)
    tables, deviations = [], []
    for channel, parameters in enumerate(fit.curves):
        start = min(channel * N_PARAMETERS, len(roots) - N_PARAMETERS)
        own = roots[start : start + N_PARAMETERS]
        light, jacobian = spline_light(parameters, np.append(stored, white[channel]))
        by_root = jacobian @ own
        tables.append(light[:-1] / (1 + parameters[-1]))
        # the level of the white is held: only what differs from it is uncertain
        moved = by_root[:-1] - (light[:-1] / light[-1])[:, None] * by_root[-1]
        deviations.append(moved.T / (1 + parameters[-1]))
    together = np.stack(deviations, axis=1)
    return ToneCurve(np.array(tables), np.sqrt((together**2).sum(axis=0))), together

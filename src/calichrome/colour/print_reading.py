"""Colours of a print from pictures that show a card of known colours beside it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.colorimetry.description import metric
from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colour.beside_card import PaperInCardLight, paper_in_card_light
from calichrome.colour.samples import ColourSamples, collect_samples, cov_of_mean
from calichrome.colour.standalone import ChartFit
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.observations import BoardView
from calichrome.target import Target

__all__ = ["PrintMeasurement", "PrintReading", "combine_readings", "read_print"]

_VIEW = "picture"
_DARK = 0.02  # of white, that hangs over dark patches: stray light, the last bit of the veil
_OUTLIER = 4.0  # robust sigmas from the median over pictures: a highlight, a hand, a shadow
_SAME = 0.5  # dE2000 by which hand-held instruments repeat, too: no picture is left out for less
_LEAST_PAPER, _MOST_PAPER = 0.4, 1.3
"""Y of what may be paper: newsprint has 0.55, brightened paper under UV 1.1, and the sigma of a
level is a tenth at most where it is of any use."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrintReading:
    """What one picture tells of a print, in the light of its card.

    Parameters
    ----------
    marker_ids : (M,) int
        Discs that are usable.
    relative : (M, 3) float
        XYZ under D65 over the Y of the paper.
    cov : (M, 3, 3) float
        Covariance of `relative` by noise and light, of each disc for itself.
    shared_cov : (M, 3, 3) float
        The same by the tint of the light at the card, which errs alike for all discs.
    white, black : (3,) float
        Paper and black squares, likewise over the Y of the paper.
    paper_y, level_sigma
        Y of the paper, and its relative sigma.
    model_delta_e
        Root mean square dE2000 by which the card's patches are missed when left out of the fit.
    clipped : (n_markers,) bool
        Discs that hold clipped pixels.
    """

    marker_ids: IntArray
    relative: FloatArray
    cov: FloatArray
    shared_cov: FloatArray
    white: FloatArray
    black: FloatArray
    paper_y: float
    level_sigma: float
    model_delta_e: float
    clipped: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrintMeasurement:
    """Colours of a print.

    Parameters
    ----------
    xyz_d65 : (n_markers, 3) float
        Of the discs; nan where no picture shows one.
    sigma_delta_e : (n_markers,) float
        dE2000 (root mean square) by which they may be off, beside the level common to all.
    n_pictures : (n_markers,) int
        Pictures in each mean.
    white_xyz_d65, black_xyz_d65 : (3,) float
        Paper and black squares.
    level_sigma
        Relative sigma of the paper's Y, and with it of all XYZ.
    model_delta_e
        Part of `sigma_delta_e` that more pictures do not lower: a camera is no observer.
    """

    xyz_d65: FloatArray
    sigma_delta_e: FloatArray
    n_pictures: IntArray
    white_xyz_d65: FloatArray
    black_xyz_d65: FloatArray
    level_sigma: float
    model_delta_e: float


def read_print(
    fitted: ChartFit,
    card_px: FloatArray,
    card_rgb: FloatArray,
    card_xyz: FloatArray,
    view: BoardView,
    target: Target,
) -> PrintReading | str:
    """Read the discs of one picture by the camera model that its card gave.

    Parameters
    ----------
    fitted
        The fit to the card.
    card_px : (N, 2) float
        Where the patches are in the picture.
    card_rgb : (N, 3) float
        Their linear camera values.
    card_xyz : (N, 3) float
        The card's colours under D65.
    view
        The board in the same picture.
    target
        The board.

    Returns
    -------
    PrintReading or str
        The sentence says why the picture is of no use.
    """
    samples = _samples(fitted, view, target)
    if samples is None:
        return "the white squares are clipped or hidden"
    lit = np.isfinite(samples.light_rgb).all(axis=1) & (samples.light_rgb > 0).all(axis=1)
    used = fitted.used
    seen_y = np.where(used, fitted.xyz_from_rgb(card_rgb)[:, 1], np.nan)
    used = used & (seen_y > 0)
    assert samples.centres_px is not None  # noqa: S101 (of views they always are)
    paper = paper_in_card_light(
        samples.centres_px[lit],
        samples.light_rgb[lit],
        card_px[used],
        seen_y[used] / card_xyz[used, 1],
        card_xyz[used, 1] / (card_xyz[used, 1] + _DARK),
    )
    if isinstance(paper, str):
        return paper
    white = fitted.model.apply(paper.rgb)
    if not _LEAST_PAPER < white[1] < _MOST_PAPER:
        return (
            f"by the card the paper would reflect {white[1]:.0%}: card and board are in different "
            f"light; lay the card beside the board, in its plane"
        )
    return _reading(fitted, samples, paper, white, len(target.markers))


def _samples(fitted: ChartFit, view: BoardView, target: Target) -> ColourSamples | None:
    """Discs and light of a view, the veil that the card told removed."""
    if view.discs is None:
        return None
    veil = fitted.light.veil_rgb
    discs = replace(
        view.discs,
        mean_rgb=view.discs.mean_rgb - veil,
        white_rgb=view.discs.white_rgb - veil,
        black_rgb=view.discs.black_rgb - veil,
    )
    return collect_samples({_VIEW: replace(view, discs=discs)}, target)


def _reading(
    fitted: ChartFit,
    samples: ColourSamples,
    paper: PaperInCardLight,
    white: FloatArray,
    n_markers: int,
) -> PrintReading:
    model = fitted.model
    samples = replace(samples, reference_light_rgb=paper.rgb)
    usable = samples.usable
    rgb, jacobian = samples.even_rgb[usable], model.jacobian(samples.even_rgb[usable])
    turned = np.swapaxes(jacobian, 1, 2)
    shared = rgb[:, :, None] * paper.tint_cov * rgb[:, None, :]
    clipped = np.zeros(n_markers, dtype=bool)
    clipped[samples.marker_ids[samples.clipped > 0]] = True
    left_out = fitted.left_out_delta_e[fitted.used]
    return PrintReading(
        marker_ids=samples.marker_ids[usable],
        relative=model.apply(rgb) / white[1],
        cov=jacobian @ samples.even_cov[usable] @ turned / white[1] ** 2,
        shared_cov=jacobian @ shared @ turned / white[1] ** 2,
        white=white / white[1],
        black=model.apply(_black_share(samples) * paper.rgb) / white[1],
        paper_y=float(white[1]),
        level_sigma=paper.level_sigma,
        model_delta_e=float(np.sqrt(np.mean(left_out**2))),
        clipped=clipped,
    )


def _black_share(samples: ColourSamples) -> FloatArray:
    """Black squares over white ones, (3,); nan if none is readable."""
    assert samples.black_rgb is not None  # noqa: S101 (of views they always are)
    assert samples.white_rgb is not None  # noqa: S101
    share = samples.black_rgb / samples.white_rgb
    known = share[np.isfinite(share).all(axis=1)]
    return np.median(known, axis=0) if len(known) else np.full(3, np.nan)


def combine_readings(readings: Sequence[PrintReading], n_markers: int) -> PrintMeasurement:
    """Average what the pictures tell, outliers left out.

    Parameters
    ----------
    readings
        At least one.
    n_markers
        Discs of the board.

    Notes
    -----
    Noise averages out over pictures. What a picture errs in for all its discs (level and tint of
    the light at the card) need not: the card may lie on the same side in all of them, so its
    variance is averaged, not divided by their number.
    """
    paper_y, level_sigma = _level(readings)
    model_delta_e = float(np.sqrt(np.mean([item.model_delta_e**2 for item in readings])))
    xyz, sigma = np.full((n_markers, 3), np.nan), np.full(n_markers, np.nan)
    n_pictures = np.zeros(n_markers, dtype=np.int64)
    for marker in range(n_markers):
        rows = [(item, np.flatnonzero(item.marker_ids == marker)) for item in readings]
        found = [(item, at[0]) for item, at in rows if len(at)]
        if not found:
            continue
        values = paper_y * np.array([item.relative[at] for item, at in found])
        cov = paper_y**2 * np.array([item.cov[at] for item, at in found])
        shared = paper_y**2 * np.array([item.shared_cov[at] for item, at in found])
        xyz[marker], own, kept = _mean(values, cov)
        total = metric(xyz[[marker]])[0] @ (own + shared[kept].mean(axis=0))
        sigma[marker] = np.sqrt(np.trace(total) + model_delta_e**2)
        n_pictures[marker] = kept.sum()
    return PrintMeasurement(
        xyz_d65=xyz,
        sigma_delta_e=sigma,
        n_pictures=n_pictures,
        white_xyz_d65=paper_y * np.median([item.white for item in readings], axis=0),
        black_xyz_d65=paper_y * np.nanmedian([item.black for item in readings], axis=0),
        level_sigma=level_sigma,
        model_delta_e=model_delta_e,
    )


def _level(readings: Sequence[PrintReading]) -> tuple[float, float]:
    """Y of the paper and its relative sigma: as stated, or as pictures scatter if that is more."""
    logs = np.log([item.paper_y for item in readings])
    sigma = np.array([item.level_sigma for item in readings])
    off = np.abs(logs - np.median(logs))
    kept = off <= _OUTLIER * np.maximum(1.4826 * np.median(off), sigma)
    weights = np.where(kept, 1 / sigma**2, 0.0)
    weights /= weights.sum()
    mean = float(weights @ logs)
    scatter = float(weights @ (logs - mean) ** 2)
    return float(np.exp(mean)), float(np.sqrt(max(weights @ sigma**2, scatter)))


def _mean(values: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Weighted mean (3,) of (K, 3), its covariance, and which of them agree."""
    noise = np.trace(metric(values) @ cov, axis1=1, axis2=2)
    off = delta_e_2000_xyz(values, np.median(values, axis=0))
    usual = 1.4826 * float(np.median(off))
    kept: BoolArray = np.asarray(
        off <= np.maximum(_OUTLIER * np.maximum(np.sqrt(noise), usual), _SAME)
    )
    if not kept.any():  # of two that contradict each other neither can be blamed
        kept = np.ones(len(values), dtype=bool)
    weights = 1 / np.maximum(noise[kept], 1e-12)
    weights /= weights.sum()
    mean = weights @ values[kept]
    return mean, cov_of_mean(values[kept] - mean, weights, cov[kept]), kept

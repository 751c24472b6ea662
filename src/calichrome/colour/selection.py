"""Choose a model: the smallest leave-one-out error among those that are stable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time_ns

import numpy as np

from calichrome.colour.families import fit_model, leave_one_out, needed_colours
from calichrome.colour.joint import fit_together
from calichrome.colour.model import ColourModel, TermModel
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs
from calichrome.colour.stability import Stability, judge_stability
from calichrome.core.arrays import FloatArray, IntArray

__all__ = ["AUTO", "Candidate", "Selection", "select_model", "select_together"]

AUTO = tuple(MODELS)
"""Models that `select_model` tries unless told otherwise: all."""

_PIXELS = 2000  # to time a model on: some tenths of a millisecond
_TINY = 1e-12  # of all weights: one colour alone has no standard error
_SIMPLER = 0.25  # standard errors of the paired difference; DESIGN's rule


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A model that was tried.

    Parameters
    ----------
    model
        None if there were too few colours.
    fitted, left_out : (N, 3) float
        XYZ of each colour by the model fitted to all, and by one fitted to the others.
    fit_delta_e, left_out_delta_e : (N,) float
        Their differences from the targets in the description space.
    stability
        None if there were too few colours.
    solver
        "closed form", or "iterative" where the mean error was asked for.
    ns_per_pixel
        Time that numpy takes to apply it, CPU nanoseconds; nan if there were too few colours.
    why_not
        Why it lost; empty for the winner.
    """

    name: str
    model: ColourModel | None
    fitted: FloatArray
    left_out: FloatArray
    fit_delta_e: FloatArray
    left_out_delta_e: FloatArray
    stability: Stability | None
    solver: str
    ns_per_pixel: float
    why_not: str

    @property
    def mean(self) -> float:
        """Mean leave-one-out error."""
        return float(self.left_out_delta_e.mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Selection:
    """The model chosen, and the others."""

    best: Candidate
    candidates: tuple[Candidate, ...]


def select_model(
    pairs: ColourPairs, names: Sequence[str] = AUTO, *, mean_error: bool = False
) -> Selection | str:
    """Try models and choose one.

    Parameters
    ----------
    pairs
        All different colours.
    names
        Of `MODELS`. One name alone is taken whatever its stability.
    mean_error
        As in `fit_model`.

    Returns
    -------
    Selection or str
        The sentence says why nothing can be fitted.

    Notes
    -----
    A simpler model replaces the one of smallest error if the paired difference of their errors is
    below a quarter of its standard error: then the data do not tell them apart.
    """
    tried = [_try(name, pairs, mean_error=mean_error) for name in names]
    fitted = [item for item in tried if item.model is not None]
    if not fitted:
        least = min(needed_colours(name) for name in names)
        return f"only {len(pairs)} different colours are usable, a fit needs {least}"
    allowed = [item for item in fitted if len(names) == 1 or not _faults(item)]
    if not allowed:
        return "no model is stable on these colours: " + "; ".join(
            f"{item.name} {_faults(item)}" for item in fitted
        )
    weights = pairs.weights / pairs.weights.sum()
    best = min(allowed, key=lambda item: float(item.left_out_delta_e @ weights))
    smallest = best
    for item in sorted(allowed, key=_n_free):
        if _n_free(item) >= _n_free(best):
            break
        if _as_good(item.left_out_delta_e - best.left_out_delta_e, weights):
            smallest = item
            break
    return Selection(
        best=smallest,
        candidates=tuple(_verdict(item, smallest, best, weights) for item in tried),
    )


def select_together(
    pairs: Mapping[str, ColourPairs],
    colours: Mapping[str, IntArray],
    nominal_xyz: FloatArray,
    nominal_cov: FloatArray,
    names: Sequence[str] = AUTO,
    *,
    share: bool = True,
    mean_error: bool = False,
) -> dict[str, Selection | str]:
    """Choose a model for every camera of a rig.

    Parameters
    ----------
    pairs, colours, nominal_xyz, nominal_cov, mean_error
        As in `fit_together`.
    names
        As in `select_model`.
    share
        False: every camera stands alone.

    Returns
    -------
    camera -> Selection or str
        As by `select_model`.

    Notes
    -----
    Against a table that is off a matrix seems as good as what a sensor needs, to each camera in its
    own way. So cameras that share what the discs look like choose a second time, among the stable
    models, against that. With tables wrong by sd 3 it brings three sensors nearer to each other by
    a sixth and to the truth by a tenth, with true ones it changes nothing (Munsell chips). Not a
    third time: then models are judged by colours that they made themselves.
    """
    chosen = {
        camera: select_model(own, names, mean_error=mean_error) for camera, own in pairs.items()
    }
    first = {camera: own.best.name for camera, own in chosen.items() if isinstance(own, Selection)}
    if not share or len(first) < 2 or len(names) == 1:
        return chosen
    together = fit_together(
        {camera: pairs[camera] for camera in first},
        {camera: colours[camera] for camera in first},
        first, nominal_xyz, nominal_cov, mean_error=mean_error,
    )  # fmt: skip
    for camera in first:
        own, tried = pairs[camera], chosen[camera]
        assert isinstance(tried, Selection)  # noqa: S101 (it is in `first`)
        exact = np.zeros((len(own), 3, 3))
        seen = own.with_targets(together.latent_xyz[colours[camera]], exact)
        stable = [item.name for item in tried.candidates if item.model and not _faults(item)]
        again = select_model(seen, stable, mean_error=mean_error)
        if isinstance(again, Selection):
            latest = {item.name: item for item in again.candidates}
            candidates = tuple(latest.get(item.name, item) for item in tried.candidates)
            chosen[camera] = Selection(best=again.best, candidates=candidates)
    return chosen


def _try(name: str, pairs: ColourPairs, *, mean_error: bool) -> Candidate:
    if len(pairs) < needed_colours(name):
        none = np.full(len(pairs), np.nan)
        return Candidate(
            name=name, model=None, fitted=none, left_out=none, fit_delta_e=none,
            left_out_delta_e=none, stability=None,
            solver="", ns_per_pixel=float("nan"),
            why_not=f"needs {needed_colours(name)} colours",
        )  # fmt: skip
    model = fit_model(name, pairs, mean_error=mean_error)
    fitted = model.apply(pairs.rgb)
    left_out = leave_one_out(name, pairs, mean_error=mean_error)
    return Candidate(
        name=name,
        model=model,
        fitted=fitted,
        left_out=left_out,
        fit_delta_e=pairs.difference(fitted),
        left_out_delta_e=pairs.difference(left_out),
        stability=judge_stability(model, pairs),
        solver="iterative" if mean_error and isinstance(model, TermModel) else "closed form",
        ns_per_pixel=_speed(model, pairs),
        why_not="",
    )


def _speed(model: ColourModel, pairs: ColourPairs) -> float:
    colours = np.resize(pairs.rgb, (_PIXELS, 3))
    start = process_time_ns()
    model.apply(colours)
    return (process_time_ns() - start) / _PIXELS


def _faults(item: Candidate) -> str:
    return "" if item.stability is None else ", ".join(item.stability.faults)


def _n_free(item: Candidate) -> int:
    return 0 if item.model is None else item.model.n_free


def _as_good(paired: FloatArray, weights: FloatArray) -> bool:
    """Whether errors that differ by `paired` from the smallest tell nothing; weights sum to 1."""
    mean, share = float(weights @ paired), float(weights @ weights)
    variance = float(weights @ (paired - mean) ** 2) * share / max(1 - share, _TINY)
    return bool(mean <= _SIMPLER * np.sqrt(variance))


def _verdict(
    item: Candidate, chosen: Candidate, smallest: Candidate, weights: FloatArray
) -> Candidate:
    why = item.why_not
    if item is chosen:
        why = ""
    elif not why:
        why = _faults(item)
    if not why and item is not chosen:
        if item is smallest:
            why = f"not surely better than {chosen.name}, which is simpler"
        else:
            more = float(weights @ (item.left_out_delta_e - smallest.left_out_delta_e))
            why = f"error larger by {more:.2f}"
    return replace(item, why_not=why)

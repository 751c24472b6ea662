"""The colour of a rig: every camera to the target, all cameras to each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from calichrome.colorimetry.description import DescriptionSpace
from calichrome.colorimetry.difference import delta_e_2000_xyz, xyz_per_lab
from calichrome.colorimetry.rgb_spaces import XYZ_FROM_RGB
from calichrome.colour.families import fit_model
from calichrome.colour.joint import JointColour, fit_together
from calichrome.colour.model import ColourModel
from calichrome.colour.models import MODELS
from calichrome.colour.pairs import ColourPairs, print_tolerance
from calichrome.colour.samples import ColourSamples, combine_views
from calichrome.colour.selection import AUTO, Candidate, select_together
from calichrome.colour.uncertainty import bound_95, model_covariance
from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.target import Target

__all__ = ["ColourSettings", "ColourSolution", "between_cameras", "fit_rig_colour"]

_GREY = 1e-6  # of full scale, between channels: below the rounding of any file


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourSettings:
    """How colour is calibrated.

    Parameters
    ----------
    model
        A name in `MODELS`, or "auto": the smallest leave-one-out error among the stable ones.
    space
        Description space, in which errors are judged.
    priorities
        Weights of discs by name; 1 where nothing is said.
    mean_error
        Minimise the mean error in the description space instead of the squared one.
    look_of
        A camera: the others are made to look like it, instead of like the target.
    share
        Let the cameras share what each disc looks like.
    """

    model: str = "auto"
    space: DescriptionSpace = "lab2000"
    priorities: Mapping[str, float] = field(default_factory=dict)
    mean_error: bool = False
    look_of: str | None = None
    share: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Models to try."""
        return AUTO if self.model == "auto" else (self.model,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourSolution:
    """A camera's colour.

    Parameters
    ----------
    model
        Linear camera RGB, without the fall-off of the lens, to XYZ under D65.
    candidates
        All models that were tried, as by `select_together`.
    disc_rgb : (n_markers, 3) float
        Mean over views in the reference light; nan for discs that were never usable.
    disc_xyz, held_out_xyz : (n_markers, 3) float
        Corrected by the model, and by one fitted to all other colours.
    fit_delta_e, held_out_delta_e : (n_markers,) float
        CIEDE2000 of these against the target, or against what the camera shows that all are to
        look like; nan: unseen.
    uncertainty_delta_e : (n_markers,) float
        What noise and print tolerance let the corrected disc be off by in 95 of 100 cases; nan
        where it was not estimated.
    white_rgb : (3,) float
        Camera value of the white squares in the reference light.
    reasons
        Why rows were left out, and how many.
    """

    model: ColourModel
    candidates: tuple[Candidate, ...]
    disc_rgb: FloatArray
    disc_xyz: FloatArray
    held_out_xyz: FloatArray
    fit_delta_e: FloatArray
    held_out_delta_e: FloatArray
    uncertainty_delta_e: FloatArray
    white_rgb: FloatArray
    reasons: Mapping[str, int]

    @property
    def n_clipped(self) -> int:
        """Rows that hold clipped pixels."""
        return self.reasons.get("clipped", 0)

    @property
    def n_rejected(self) -> int:
        """Rows that disagree with the other views of their disc."""
        return sum(n for reason, n in self.reasons.items() if reason not in {"clipped", "unlit"})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """What one camera saw, one row per colour of the board.

    Parameters
    ----------
    disc_rgb : (n_markers, 3) float
    pairs
        Colours that were seen, with nominal targets.
    colours : (N,) int
        Which colour each pair is.
    """

    samples: ColourSamples
    disc_rgb: FloatArray
    pairs: ColourPairs
    colours: IntArray
    reasons: Mapping[str, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Colours:
    """The different colours of a board: discs that repeat one count as one.

    Parameters
    ----------
    xyz : (D, 3) float
    cov : (D, 3, 3) float
        Tolerance of the print.
    of_marker : (n_markers,) int
    names
        By colour.
    """

    xyz: FloatArray
    cov: FloatArray
    of_marker: IntArray
    names: tuple[str, ...]

    @classmethod
    def of(cls, target: Target) -> "_Colours":
        xyz, first, of_marker = np.unique(
            target.marker_xyz_d65, axis=0, return_index=True, return_inverse=True
        )
        spread = print_tolerance(target)
        slopes = xyz_per_lab(xyz)
        return cls(
            xyz=xyz,
            cov=spread**2 * slopes @ np.swapaxes(slopes, 1, 2),
            of_marker=np.ravel(of_marker),
            names=tuple(target.markers[index].name for index in first),
        )


def fit_rig_colour(
    samples: Mapping[str, ColourSamples], target: Target, settings: ColourSettings | None = None
) -> dict[str, ColourSolution | str]:
    """Fit all cameras.

    Parameters
    ----------
    samples
        By camera.
    target
        Nominal colours.
    settings
        How.

    Returns
    -------
    camera -> ColourSolution or str
        The sentence says what is missing for a fit.
    """
    settings = settings or ColourSettings()
    board = _Colours.of(target)
    results: dict[str, ColourSolution | str] = {}
    seen: dict[str, _Seen] = {}
    for camera, item in samples.items():
        found = _see(item, target, board, settings)
        if isinstance(found, str):
            results[camera] = found
        else:
            seen[camera] = found
    if settings.look_of in seen:
        seen, board = _as_shown_by(seen[settings.look_of], seen, board)
        settings = replace(settings, share=False)
    chosen = select_together(
        {camera: own.pairs for camera, own in seen.items()},
        {camera: own.colours for camera, own in seen.items()},
        board.xyz, board.cov, settings.names,
        share=settings.share, mean_error=settings.mean_error,
    )  # fmt: skip
    tried: dict[str, tuple[Candidate, ...]] = {}
    names: dict[str, str] = {}
    for camera, selection in chosen.items():
        if isinstance(selection, str):
            results[camera] = selection
            del seen[camera]
        else:
            tried[camera], names[camera] = selection.candidates, selection.best.name
    if not seen:
        return results
    joint = _Joint(seen, names, board, settings)
    together = joint.fit()
    left_out = joint.leave_one_out(together)
    for camera, own in seen.items():
        results[camera] = _solution(
            own, board, together.models[camera], left_out[camera], tried[camera],
            _uncertainty(own.pairs, names[camera], settings),
        )  # fmt: skip
    return {camera: results[camera] for camera in samples}


def _see(
    samples: ColourSamples, target: Target, board: _Colours, settings: ColourSettings
) -> _Seen | str:
    means = combine_views(samples, len(board.of_marker))
    visible = means.n_views > 0
    if visible.any() and np.ptp(means.mean_rgb[visible], axis=1).max() < _GREY:
        return "its pictures are grey: all three channels are equal"
    colours = np.unique(board.of_marker[visible])
    least = min(MODELS[name].MIN_COLOURS for name in settings.names) + 1
    if settings.model == "auto":
        least = MODELS["linear"].MIN_COLOURS + 2  # fewer fit themselves and tell nothing
    if len(colours) < least:
        return (
            f"only {len(colours)} different colours are usable, a {settings.model} fit needs "
            f"{least}"
        )
    rgb, cov = np.empty((len(colours), 3)), np.empty((len(colours), 3, 3))
    for row, colour in enumerate(colours):
        discs = np.flatnonzero(visible & (board.of_marker == colour))
        rgb[row] = means.mean_rgb[discs].mean(axis=0)
        cov[row] = means.cov_rgb[discs].sum(axis=0) / len(discs) ** 2
    paper = target.paper.white_xyz_d65
    priorities = [settings.priorities.get(board.names[colour], 1.0) for colour in colours]
    pairs = ColourPairs.of(
        rgb,
        board.xyz[colours],
        white_rgb=None if paper is None else samples.reference_light_rgb,
        white_xyz=None if paper is None else np.asarray(paper),
        rgb_cov=cov,
        xyz_cov=board.cov[colours],
        weights=np.array(priorities),
        space=settings.space,
    )
    return _Seen(
        samples=samples,
        disc_rgb=means.mean_rgb,
        pairs=pairs,
        colours=colours,
        reasons={
            reason: means.reasons.count(reason) for reason in sorted(set(means.reasons) - {""})
        },
    )


def _as_shown_by(
    shown: _Seen, seen: Mapping[str, _Seen], board: _Colours
) -> tuple[dict[str, _Seen], _Colours]:
    """Take what one camera's pictures show, read as the sRGB they are taken for, as the target.

    Colours that it did not see have no target, and are left out.
    """
    to_xyz = XYZ_FROM_RGB["srgb"]
    xyz = np.full_like(board.xyz, np.nan)
    xyz[shown.colours] = shown.pairs.rgb @ to_xyz.T
    cov = board.cov.copy()
    cov[shown.colours] = to_xyz @ shown.pairs.rgb_cov @ to_xyz.T
    alike = {}
    for camera, own in seen.items():
        kept = np.isin(own.colours, shown.colours)
        colours = own.colours[kept]
        pairs = replace(own.pairs[kept], white_xyz=to_xyz @ shown.pairs.white_rgb)
        alike[camera] = replace(
            own, pairs=pairs.with_targets(xyz[colours], cov[colours]), colours=colours
        )
    return alike, replace(board, xyz=xyz, cov=cov)


class _Joint:
    """All cameras, or all without a colour."""

    def __init__(
        self,
        seen: Mapping[str, _Seen],
        names: Mapping[str, str],
        board: _Colours,
        settings: ColourSettings,
    ) -> None:
        self._names, self._settings = dict(names), settings
        self._nominal, self._cov = board.xyz, board.cov
        self._seen = dict(seen)

    def fit(self, start: FloatArray | None = None, without: int | None = None) -> JointColour:
        """Fit all, or all without one colour."""
        pairs, colours = {}, {}
        for camera, own in self._seen.items():
            kept = own.colours != (-1 if without is None else without)
            pairs[camera], colours[camera] = own.pairs[kept], own.colours[kept]
        return fit_together(
            pairs, colours, self._names, self._nominal, self._cov,
            start=start,
            share=self._settings.share and len(pairs) > 1,
            mean_error=self._settings.mean_error,
        )  # fmt: skip

    def leave_one_out(self, together: JointColour) -> dict[str, FloatArray]:
        """XYZ of every pair from a fit of all cameras that never saw its colour."""
        predicted = {camera: np.empty_like(own.pairs.xyz) for camera, own in self._seen.items()}
        for colour in np.unique(np.concatenate([own.colours for own in self._seen.values()])):
            models = self.fit(together.latent_xyz, int(colour)).models
            for camera, own in self._seen.items():
                row = np.flatnonzero(own.colours == colour)
                predicted[camera][row] = models[camera].apply(own.pairs.rgb[row])
        return predicted


def _uncertainty(pairs: ColourPairs, name: str, settings: ColourSettings) -> FloatArray:
    """95 % bound of every corrected pair, by the model and its own noise."""
    model = fit_model(name, pairs, mean_error=settings.mean_error)
    cov = model_covariance(name, pairs, pairs.rgb, mean_error=settings.mean_error)
    jacobian = model.jacobian(pairs.rgb)
    cov = cov + jacobian @ pairs.rgb_cov @ np.swapaxes(jacobian, 1, 2)
    return bound_95(model.apply(pairs.rgb), cov, pairs.adopted_white, pairs.space)


def _solution(
    own: _Seen,
    board: _Colours,
    model: ColourModel,
    left_out: FloatArray,
    candidates: tuple[Candidate, ...],
    uncertainty: FloatArray,
) -> ColourSolution:
    row_of = np.full(len(board.xyz), -1)
    row_of[own.colours] = np.arange(len(own.colours))
    rows = row_of[board.of_marker]
    is_seen: BoolArray = np.asarray(np.isfinite(own.disc_rgb).all(axis=1) & (rows >= 0))
    held_out = np.where(is_seen[:, None], left_out[rows], np.nan)
    disc_xyz = model.apply(own.disc_rgb)
    wanted = board.xyz[board.of_marker]
    return ColourSolution(
        model=model,
        candidates=candidates,
        disc_rgb=own.disc_rgb,
        disc_xyz=disc_xyz,
        held_out_xyz=held_out,
        fit_delta_e=delta_e_2000_xyz(disc_xyz, wanted),
        held_out_delta_e=delta_e_2000_xyz(held_out, wanted),
        uncertainty_delta_e=np.where(is_seen, uncertainty[rows], np.nan),
        white_rgb=own.samples.reference_light_rgb,
        reasons=own.reasons,
    )


def between_cameras(
    solutions: Mapping[str, ColourSolution], *, held_out: bool = False
) -> FloatArray:
    """CIEDE2000 of every disc between every two cameras that see it, one value each."""
    parts: Sequence[FloatArray] = [
        delta_e_2000_xyz(*(item.held_out_xyz if held_out else item.disc_xyz for item in (a, b)))
        for a, b in combinations(solutions.values(), 2)
    ]
    values = np.concatenate(parts) if parts else np.empty(0)
    return np.asarray(values[np.isfinite(values)])

"""Has a camera of a calibrated rig moved, or its lens changed? Asked with one new picture or more.

Everything is taken as it was but the board's places. Then one change at a time is allowed, the
place of a camera or its lens, and the one that explains most, beyond what chance and the doubts of
the calibration explain, is believed; then the next is sought with the first allowed. A camera that
moved is thus held against the others and not they against it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import BoardShape, ObservedView
from calichrome.geometry.displacement import Displacement
from calichrome.geometry.drift_equations import (
    LENS_CHANGE,
    Change,
    DriftFit,
    DriftProblem,
    leftovers,
)
from calichrome.geometry.drift_start import Views, gated, place_frames
from calichrome.geometry.lenses import Lens

__all__ = ["CameraDrift", "Drift", "KnownRig", "LensChange", "find_drift"]

FALSE_ALARM = 1e-3  # choice: of a thousand checks of a rig that is as it was, one finds a change
_AS_LIKELY = 2 * np.log(1e3)
"""In chi-square: changes that explain the pictures less well by no more than a factor of a thousand
in likelihood are named beside the best; a choice."""
_NOISY = 0.05  # chance below which a view counts with the noise it shows; doubt costs power only
_MISFIT = 2.0
"""What a camera's corners miss, whatever moved, over what they missed in the calibration. The views
of one camera in the real recordings of the tests differ from each other by less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRig:
    """A calibration.

    Parameters
    ----------
    lenses, cams_from_ref
        By camera.
    noise
        camera -> by what its residuals exceeded their stated covariance; pixels, where the views
        to be checked state none.
    corners_board : (n, 3) float, metres
        Of the flat board.
    shape, shape_parameters
        How the board differs from that.
    cov : (n, n) float or None
        Joint covariance: camera by camera its lens and its pose (omega, tau) of `Pose.perturbed`,
        then the board's shape. None: the calibration is taken as exact.
    """

    lenses: Mapping[str, Lens]
    cams_from_ref: Mapping[str, Pose]
    noise: Mapping[str, float]
    corners_board: FloatArray
    shape: BoardShape
    shape_parameters: FloatArray
    cov: FloatArray | None

    def only(self, cameras: Sequence[str]) -> "KnownRig":
        """Return some of the cameras, in the order given."""
        cov = None
        if self.cov is not None:
            lengths = [len(lens.NAMES) + 6 for lens in self.lenses.values()]
            ends = np.cumsum(lengths)
            rows = {
                camera: np.arange(end - length, end)
                for camera, length, end in zip(self.lenses, lengths, ends, strict=True)
            }
            kept = np.concatenate(
                [*(rows[camera] for camera in cameras), np.arange(ends[-1], len(self.cov))]
            )
            cov = self.cov[np.ix_(kept, kept)]
        return KnownRig(
            lenses={camera: self.lenses[camera] for camera in cameras},
            cams_from_ref={camera: self.cams_from_ref[camera] for camera in cameras},
            noise={camera: self.noise[camera] for camera in cameras},
            corners_board=self.corners_board,
            shape=self.shape,
            shape_parameters=self.shape_parameters,
            cov=cov,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LensChange:
    """How a lens differs from the calibrated one.

    Parameters
    ----------
    values : (3,) float
        Relative change of both focal lengths; shift of the principal point, pixels.
    cov : (3, 3) float
    """

    values: FloatArray
    cov: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, (3,)."""
        return np.asarray(np.sqrt(np.diag(self.cov)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraDrift:
    """What the new pictures say of one camera.

    Parameters
    ----------
    n_views
        How many of them show the board.
    moved
        Against the other cameras; None where no frame is shared with them.
    moved_chance, lens_chance
        Probability that chance explains as much; None as above.
    lens
        Best change of the lens; None where the views leave it open.
    misfit
        What its corners miss, whatever moved, over what they missed in the calibration.
    has_moved, has_lens_changed
        Whether it is believed.
    moved_or, lens_or
        If so: other changes that explain the pictures about as well.
    fits
        False if `misfit` is too large: no move and no zoom explains its corners.
    """

    n_views: int
    moved: Displacement | None
    moved_chance: float | None
    lens: LensChange | None
    lens_chance: float | None
    misfit: float
    has_moved: bool = False
    has_lens_changed: bool = False
    moved_or: tuple[Change, ...] = ()
    lens_or: tuple[Change, ...] = ()
    fits: bool = True

    @property
    def unchanged(self) -> bool:
        """Whether there is nothing to say."""
        return self.fits and not (self.has_moved or self.has_lens_changed)


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """By camera, and the changes that are believed, the surest first."""

    cameras: Mapping[str, CameraDrift]
    changes: tuple[Change, ...]


def find_drift(
    known: KnownRig,
    views: Mapping[str, Mapping[str, ObservedView]],
    *,
    false_alarm: float = FALSE_ALARM,
) -> Drift:
    """Compare a rig with new views of its board.

    Parameters
    ----------
    known
        The calibration.
    views
        camera -> frame -> view, as stated by the detector; cameras without views may be absent.
    false_alarm
        Probability to find a change where there is none, over all cameras.

    Raises
    ------
    SolveError
        If a view lies where its lens has no rays.

    Notes
    -----
    With z all whitened residuals, the least squares over board places b, errors of the calibration
    S u (S S' its covariance, u of unit variance) and allowed changes h,

        chi-square(h) = min over b, u, h of |z(b, S u, h)|^2 + |u|^2,

    falls, when k changes are allowed that are not there, by a chi-square of k degrees. The limit
    for each is `false_alarm` over the number of changes tried.

    References
    ----------
    .. [1] W. Baarda, "A testing procedure for use in geodetic networks", 1968 (one alternative at a
       time, the largest first).
    .. [2] S. S. Wilks, "The large-sample distribution of the likelihood ratio", Ann. Math. Stat. 9,
       1938.
    """
    cameras = [camera for camera in known.lenses if views.get(camera)]
    known = known.only(cameras)
    points = known.shape.displaced(known.corners_board, known.shape_parameters)
    scaled: Views = {
        camera: {frame: _scaled(view, known.noise[camera]) for frame, view in views[camera].items()}
        for camera in cameras
    }
    scaled, places = gated(scaled, known.lenses, points)
    misses = leftovers(known, scaled, places)
    scaled = {
        camera: {
            frame: _scaled(view, _shown_noise(*misses[camera, frame]))
            for frame, view in own.items()
        }
        for camera, own in scaled.items()
    }
    boards = place_frames(scaled, known.lenses, known.cams_from_ref, points, places)
    problem = DriftProblem.build(known, scaled, boards, places)
    return _judged(problem, known, scaled, misses, false_alarm)


def _judged(
    problem: DriftProblem,
    known: KnownRig,
    views: Views,
    misses: Mapping[tuple[str, str], tuple[float, int]],
    false_alarm: float,
) -> Drift:
    """Select changes, then tell of every camera what it would take to explain it otherwise."""
    tried = _possible(views)
    fit = problem.fit(())
    taken: list[Change] = []
    beside: dict[Change, tuple[Change, ...]] = {}
    while True:
        trials = {
            change: problem.allow(change, fit, taken) for change in tried if change not in taken
        }
        chances = {change: _chance(change, fit, trial) for change, trial in trials.items()}
        best = min(chances, key=lambda change: (chances[change], trials[change].chi_square),
                   default=None)  # fmt: skip
        if best is None or chances[best] * len(tried) > false_alarm:
            break
        beside[best] = tuple(
            change
            for change, trial in trials.items()
            if change != best and trial.chi_square < trials[best].chi_square + _AS_LIKELY
        )
        taken.append(best)
        fit = trials[best]
    rivals = {other: main for main, others in beside.items() for other in others}
    cameras = {}
    for camera in known.lenses:
        told = {
            kind: _told(problem, (kind, camera), taken, rivals, fit)
            for kind in ("place", "lens")
            if (kind, camera) in tried
        }
        place, lens = told.get("place"), told["lens"]
        own = [misses[camera, frame] for frame in views[camera]]
        total, freedom = sum(chi for chi, _ in own), sum(degrees for _, degrees in own)
        misfit = float(np.sqrt(total / max(freedom, 1)))
        cameras[camera] = CameraDrift(
            n_views=len(own),
            moved=None if place is None or place[0] is None else Displacement(*place[0]),
            moved_chance=None if place is None or place[0] is None else place[1],
            lens=None if lens[0] is None else LensChange(*lens[0]),
            lens_chance=None if lens[0] is None else lens[1],
            misfit=misfit,
            has_moved=("place", camera) in (*taken, *rivals),
            has_lens_changed=("lens", camera) in (*taken, *rivals),
            moved_or=_others(("place", camera), beside, rivals),
            lens_or=_others(("lens", camera), beside, rivals),
            fits=misfit < _MISFIT or chdtrc(freedom, total) * len(known.lenses) > false_alarm,
        )
    return Drift(cameras, tuple(taken))


def _told(
    problem: DriftProblem,
    change: Change,
    taken: Sequence[Change],
    rivals: Mapping[Change, Change],
    fit: DriftFit,
) -> tuple[tuple[FloatArray, FloatArray] | None, float]:
    """Estimate with covariance, or None, of a change beside those taken; and its chance."""
    if change in taken or change in rivals:
        without = tuple(other for other in taken if other != rivals.get(change, change))
        base = _fitted(problem, without)
    else:
        without, base = tuple(taken), fit
    trial = problem.allow(change, base, without)
    return trial.estimate(change), _chance(change, base, trial)


def _fitted(problem: DriftProblem, changes: Sequence[Change]) -> DriftFit:
    """Allow changes one after the other, from the calibration."""
    fit = problem.fit(())
    for count, change in enumerate(changes):
        fit = problem.allow(change, fit, changes[:count])
    return fit


def _chance(change: Change, without: DriftFit, with_it: DriftFit) -> float:
    gained = max(without.chi_square - with_it.chi_square, 0.0)
    return float(chdtrc(6 if change[0] == "place" else len(LENS_CHANGE), gained))


def _possible(views: Views) -> list[Change]:
    """List the changes that the views can show: a place only against another camera's."""
    changes: list[Change] = []
    for camera, own in views.items():
        others = {frame for other, theirs in views.items() if other != camera for frame in theirs}
        if others & set(own):
            changes.append(("place", camera))
        changes.append(("lens", camera))
    return changes


def _others(
    change: Change, beside: Mapping[Change, tuple[Change, ...]], rivals: Mapping[Change, Change]
) -> tuple[Change, ...]:
    main = rivals.get(change, change)
    return tuple(
        other for other in ((main, *beside[main]) if main in beside else ()) if other != change
    )


def _shown_noise(chi_square: float, freedom: int) -> float:
    """By what a view is noisier than it should be, if that is no chance."""
    if freedom < 1 or chdtrc(freedom, chi_square) > _NOISY:
        return 1.0
    return float(np.sqrt(chi_square / freedom))


def _scaled(view: ObservedView, noise: float) -> ObservedView:
    whitening = np.eye(2)[None] if view.whitening is None else view.whitening
    return ObservedView(
        view.camera, view.frame, view.corner_ids, view.pixels,
        np.broadcast_to(whitening / noise, (len(view.pixels), 2, 2)),
    )  # fmt: skip

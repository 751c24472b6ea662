"""One adjustment of a rig: what was seen, where it begins, and what comes out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
)
from calichrome.geometry.bundle.board_shape import BOW_TERMS
from calichrome.geometry.bundle.robust import RobustResult, solve_robust
from calichrome.geometry.consistency import Contradictions, RigPlaces, contradictions
from calichrome.geometry.lenses import LENSES, Lens
from calichrome.geometry.rig_solution import JointCovariance, PairSummary, RigSolution, rms_px
from calichrome.geometry.rig_start import RigStart, half_turned
from calichrome.geometry.support import Support, supported
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["FixedParameters", "Key", "RigProblem", "RigSettings", "Views", "without_fixed"]

FixedParameters = Mapping[str, Mapping[str, float]]
Views = dict[str, dict[str, ObservedView]]
Key = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigSettings:
    """How to solve.

    Parameters
    ----------
    reference
        Reference camera; None: the one with the least total path error of the start.
    lens, lenses
        Name of the lens model for all cameras, and by camera where it differs.
    fixed
        camera -> lens parameters that keep the given value.
    warp
        Estimate how the board is bowed and, where the residuals show it, by how much its squares
        are wider than high, and lean; False: it is as described.
    robust
        Find and leave out corners that do not belong; False: plain least squares on all.
    start
        A solution of (mostly) the same views: its lenses and places are the start.
    """

    reference: str | None = None
    lens: str = "brown-conrady"
    lenses: Mapping[str, str] = field(default_factory=dict)
    fixed: FixedParameters = field(default_factory=dict)
    warp: bool = True
    robust: bool = True
    start: RigSolution | None = None

    def model(self, camera: str) -> type[Lens]:
        """Lens model of a camera."""
        name = self.lenses.get(camera, self.lens)
        if name not in LENSES:
            raise SolveError(f"lens model {name} is not known; there are {', '.join(LENSES)}")
        return LENSES[name]

    def fixed_values(self, camera: str) -> dict[str, float]:
        """Return the fixed parameters of a camera, checked."""
        fixed = dict(self.fixed.get(camera, {}))
        model = self.model(camera)
        unknown = set(fixed) - set(model.NAMES)
        if unknown:
            raise SolveError(
                f"camera {camera}: {', '.join(sorted(unknown))} is no parameter of {model.MODEL}; "
                f"its names are {', '.join(model.NAMES)}"
            )
        if min(fixed.get("fx", 1.0), fixed.get("fy", 1.0)) <= 0:
            raise SolveError(
                f"camera {camera}: a fixed focal length must be positive; correct fx, fy in "
                f"recording.toml"
            )
        return fixed


def without_fixed(
    lenses: BoolArray, cameras: Sequence[str], state: BundleState, settings: RigSettings
) -> BoolArray:
    """Hold those of `lenses`, (C, P), that are to keep their value."""
    lenses = lenses.copy()
    for row, camera in enumerate(cameras):
        for name in settings.fixed_values(camera):
            lenses[row, state.models[row].NAMES.index(name)] = False
    return lenses


@dataclass(frozen=True, slots=True, eq=False)
class RigProblem:
    """One adjustment: what was seen and where it begins.

    Parameters
    ----------
    dataset, target, settings
        See `solve_rig`.
    views
        camera -> frame -> view, the corners of turned views renumbered.
    lenses, start, shape_parameters
        Where it begins.
    noise_px
        camera -> about the noise of its corners.
    noise_alone
        camera -> by what residuals exceed the stated noise when the camera is solved alone.
    aspect
        Whether the squares may be wider than high, and lean.
    """

    dataset: Dataset
    target: Target
    settings: RigSettings
    views: Views
    lenses: Mapping[str, Lens]
    start: RigStart
    noise_px: Mapping[str, float]
    noise_alone: Mapping[str, float]
    aspect: bool
    shape_parameters: FloatArray

    @property
    def cameras(self) -> list[str]:
        """Camera ids."""
        return list(self.views)

    @property
    def keys(self) -> list[Key]:
        """(camera, frame) of each view, in the order packed."""
        return [(camera, frame) for camera, own in self.views.items() for frame in own]

    @property
    def slots(self) -> list[str | Key]:
        """What has a place of its own: a frame, or a view that contradicts its frame."""
        together = {frame for camera, frame in self.keys if (camera, frame) not in self.start.apart}
        frames = [frame for frame in self.start.ref_from_boards if frame in together]
        return [*frames, *self.start.apart]

    def solve(self) -> tuple[Support, RobustResult]:
        """Minimise from the start."""
        observations, state = self._packed()
        reference = self.cameras.index(self.start.reference)
        allowed = Free.everything(state, reference)
        lenses = without_fixed(allowed.lenses, self.cameras, state, self.settings)
        # a camera that shares no frame as it should hangs in the air: its place is not sought
        allowed = replace(allowed, lenses=lenses, cameras=allowed.cameras & self._connected())
        sizes = tuple(self.dataset.sizes_wh[camera] for camera in self.cameras)
        noise_px = np.array([self.noise_px[camera] for camera in self.cameras])
        support = supported(observations, state, allowed, sizes, noise_px)
        return support, solve_robust(observations, state, support.free, gate=self.settings.robust)

    def _connected(self) -> BoolArray:
        """Which cameras the frames, apart views aside, tie to the reference."""
        seen: dict[str, set[str]] = {camera: set() for camera in self.cameras}
        for camera, frame in self.keys:
            if (camera, frame) not in self.start.apart:
                seen[camera].add(frame)
        reached, waiting = {self.start.reference}, [self.start.reference]
        while waiting:
            here = waiting.pop()
            for camera in self.cameras:
                if camera not in reached and seen[camera] & seen[here]:
                    reached.add(camera)
                    waiting.append(camera)
        return np.array([camera in reached for camera in self.cameras])

    def _packed(self) -> tuple[Observations, BundleState]:
        points, slots = self.target.corners_board, self.slots
        index = {slot: position for position, slot in enumerate(slots)}
        row = {camera: position for position, camera in enumerate(self.cameras)}
        views = [
            replace(
                self.views[camera][frame],
                camera=row[camera],
                frame=index[(camera, frame) if (camera, frame) in self.start.apart else frame],
            )
            for camera, frame in self.keys
        ]
        shape = BoardShape.bowed(
            points,
            len(BOW_TERMS) if self.settings.warp else 0,
            aspect=self.aspect,
        )
        parameters = self.shape_parameters if len(self.shape_parameters) == len(shape) else None
        boards = [
            self.start.ref_from_boards[slot]
            if isinstance(slot, str)
            else self.start.cams_from_ref[slot[0]].inverse() @ self.start.apart[slot]
            for slot in slots
        ]
        state = BundleState.build(
            [self.lenses[camera] for camera in self.cameras],
            [self.start.cams_from_ref[camera] for camera in self.cameras],
            boards, shape, parameters,
        )  # fmt: skip
        return Observations.pack(views, points, state.models, len(slots)), state

    def contradictions(self, solved: RobustResult) -> Contradictions:
        """Find frames in which cameras disagree, and views that do not after all."""
        state = solved.result.state
        lenses = dict(zip(self.cameras, state.lenses, strict=True))
        points = state.shape.displaced(self.target.corners_board, state.shape_parameters)
        cams = dict(zip(self.cameras, state.cams_from_ref, strict=True))
        places = dict(zip(self.slots, state.ref_from_boards, strict=True))
        return contradictions(self.views, RigPlaces(lenses, cams, self.noise_alone, places, points))

    @property
    def n_aspect_terms(self) -> int:
        """How many terms squares that are not square add."""
        bow = BoardShape.bowed(self.target.corners_board, len(BOW_TERMS))
        both = BoardShape.bowed(self.target.corners_board, len(BOW_TERMS), aspect=True)
        return len(both) - len(bow)

    def with_aspect(self, solved: RobustResult) -> "RigProblem":
        """Begin again where this one ended, with squares that may be wider than high, and lean."""
        boards = {
            slot: place for slot, place in self._places(solved).items() if isinstance(slot, str)
        }
        cams = dict(zip(self.cameras, solved.result.state.cams_from_ref, strict=True))
        apart = {
            slot: cams[slot[0]] @ place
            for slot, place in self._places(solved).items()
            if not isinstance(slot, str)
        }
        again = self.mended(Contradictions(boards, apart, (), nothing=True), solved)
        parameters = np.concatenate([again.shape_parameters, np.zeros(self.n_aspect_terms)])
        return replace(again, aspect=True, shape_parameters=parameters)

    def _places(self, solved: RobustResult) -> dict[str | Key, Pose]:
        return dict(zip(self.slots, solved.result.state.ref_from_boards, strict=True))

    def mended(self, found: Contradictions, solved: RobustResult) -> "RigProblem":
        """Begin again where this one ended, with other views apart."""
        state = solved.result.state
        n_corners = self.target.n_corners
        views = {
            camera: {
                frame: half_turned(view, n_corners) if (camera, frame) in found.turned else view
                for frame, view in own.items()
            }
            for camera, own in self.views.items()
        }
        cams = dict(zip(self.cameras, state.cams_from_ref, strict=True))
        return replace(
            self,
            views=views,
            lenses=dict(zip(self.cameras, state.lenses, strict=True)),
            start=RigStart(self.start.reference, cams, found.boards, found.apart),
            shape_parameters=state.shape_parameters,
        )

    def solution(
        self, support: Support, solved: RobustResult, turned: tuple[Key, ...]
    ) -> RigSolution:
        """Put together what was solved."""
        state = solved.result.state
        residuals = dict(zip(self.keys, residuals_px(self._packed()[0], state), strict=True))
        inliers = dict(zip(self.keys, solved.inliers, strict=True))
        places = dict(zip(self.slots, state.ref_from_boards, strict=True))
        cams = dict(zip(self.cameras, state.cams_from_ref, strict=True))
        joint, open_directions = self._covariance(solved)
        free = np.array([camera in open_directions for camera in self.cameras])
        apart = {
            slot: cams[slot[0]] @ place
            for slot, place in places.items()
            if not isinstance(slot, str)
        }
        together = {key: part[inliers[key]] for key, part in residuals.items() if key not in apart}
        return RigSolution(
            dataset=self._renumbered(turned),
            reference=self.start.reference,
            lenses=dict(zip(self.cameras, state.lenses, strict=True)),
            cams_from_ref=cams,
            ref_from_boards={
                slot: place for slot, place in places.items() if isinstance(slot, str)
            },
            residuals_px=residuals,
            inliers=inliers,
            lens_cov={
                camera: None if joint is None or is_open else joint.lens(camera)
                for camera, is_open in zip(self.cameras, free, strict=True)
            },
            pose_cov={
                camera: None if joint is None or is_open else joint.pose(camera)
                for camera, is_open in zip(self.cameras, free, strict=True)
            },
            pairs=self._pairs(together),
            joint=None if free.any() else joint,
            noise=dict(zip(self.cameras, map(float, solved.noise), strict=True)),
            noise_alone=self.noise_alone,
            shape=state.shape,
            shape_parameters=state.shape_parameters,
            apart=apart,
            turned=turned,
            held={self.cameras[row]: names for row, names in support.held.items()},
            converged=solved.result.stop_reason in {"cost", "step"},
            shape_held=support.shape_held,
            open_directions=open_directions,
        )

    def _covariance(
        self, solved: RobustResult
    ) -> tuple[JointCovariance | None, dict[str, tuple[str, ...]]]:
        """Joint covariance, and what the data leave open, by camera."""
        state = solved.result.state
        open_rows = solved.result.equations.open_columns()
        n_lens = state.lens_parameters.shape[1]
        columns: dict[str, IntArray] = {}
        names: dict[str, tuple[str, ...]] = {}
        connected = self._connected()
        for row, camera in enumerate(self.cameras):
            own = state.models[row].NAMES
            first = row * (n_lens + 6)
            columns[camera] = np.r_[first : first + len(own), first + n_lens : first + n_lens + 6]
            labels = [
                *own,
                *(f"{kind} {axis}" for kind in ("rotation", "position") for axis in "xyz"),
            ]
            found = tuple(
                label for label, column in zip(labels, columns[camera], strict=True)
                if column in open_rows
            )  # fmt: skip
            if not connected[row]:
                found = (*found, *labels[-6:])
            if found:
                names[camera] = found
        matrix = solved.result.equations.covariance()
        if matrix is None:
            return None, names or dict.fromkeys(self.cameras, ("everything",))
        shape = len(state.lens_parameters) * (n_lens + 6) + np.arange(len(state.shape))
        return JointCovariance(columns=columns, shape=shape, matrix=matrix), names

    def _pairs(self, residuals: Mapping[Key, FloatArray]) -> dict[Key, PairSummary]:
        pairs = {}
        for a, b in combinations(self.cameras, 2):
            shared = [
                frame
                for frame in self.views[a]
                if (a, frame) in residuals and (b, frame) in residuals
            ]
            parts = [residuals[camera, frame] for frame in shared for camera in (a, b)]
            if parts and sum(map(len, parts)):
                pairs[a, b] = PairSummary(len(shared), rms_px(np.concatenate(parts)))
        return pairs

    def _renumbered(self, turned: tuple[Key, ...]) -> Dataset:
        """Let the corners of turned views carry the ids that explain them."""
        return self.dataset.with_views(
            {
                camera: {
                    frame: replace(view, corner_ids=self.target.n_corners - 1 - view.corner_ids)
                    if (camera, frame) in turned
                    else view
                    for frame, view in own.items()
                }
                for camera, own in self.dataset.views.items()
            }
        )

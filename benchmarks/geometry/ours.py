"""The package's solver as the benchmarks use it: the only module here that knows it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from benchmarks.geometry.bound import N_CAMERA, N_LENS, Problem, State, View

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.findings import worst_severity
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import Dataset
from calichrome.pipeline.judge_geometry import judge_geometry
from calichrome.pipeline.solve_geometry import SolvedGeometry
from calichrome.target import Target

__all__ = ["Solved", "is_trusted", "solve"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A solved rig in the terms of `bound`.

    Parameters
    ----------
    solution
        As the package has it; a start for another solve.
    problem
        The corners that the solver believed, its weights and what it freed. A view that it gave a
        place of its own has the place "frame@camera".
    state
        Its answer.
    covariance : (15 C, 15 C) float, or None
        Of all cameras; 0 where nothing was free. None: the data leave a direction open.
    """

    solution: RigSolution
    problem: Problem
    state: State
    covariance: FloatArray | None

    @property
    def lenses(self) -> Mapping[str, BrownConrady]:
        """By camera."""
        return self.state.lenses

    @property
    def cams_from_ref(self) -> Mapping[str, Pose]:
        """By camera."""
        return self.state.cams_from_ref

    def lens_cov(self, camera: str) -> FloatArray:
        """Covariance of a lens, (9, 9)."""
        if self.covariance is None:
            return np.full((N_LENS, N_LENS), np.inf)
        first = N_CAMERA * list(self.lenses).index(camera)
        return self.covariance[first : first + N_LENS, first : first + N_LENS]


def solve(
    dataset: Dataset,
    target: Target,
    *,
    warp: bool = True,
    robust: bool = True,
    start: RigSolution | None = None,
) -> Solved:
    """Calibrate; the first camera is the reference.

    Raises
    ------
    SolveError
        If the solver gives up.
    """
    reference = next(iter(dataset.views))
    settings = RigSettings(reference=reference, warp=warp, robust=robust, start=start)
    return _solved_of(solve_rig(dataset, target, settings), target)


def _solved_of(solution: RigSolution, target: Target) -> Solved:
    """Read a solution."""
    lenses = {}
    for camera, lens in solution.lenses.items():
        if not isinstance(lens, BrownConrady):
            raise TypeError(f"camera {camera}: the benchmarks know Brown-Conrady lenses only")
        lenses[camera] = lens
    boards = dict(solution.ref_from_boards)
    views = {}
    for (camera, frame), counts in solution.inliers.items():
        place = frame
        if (camera, frame) in solution.apart:
            place = f"{frame}@{camera}"
            cam_from_ref = solution.cams_from_ref[camera]
            boards[place] = cam_from_ref.inverse() @ solution.apart[camera, frame]
        view = solution.dataset.views[camera][frame]
        if counts.any():
            views[camera, place] = View(view.corner_ids[counts], view.corners_px[counts])
    has_bow = solution.shape is not None and not solution.shape_held and len(solution.shape) > 0
    no_basis = np.zeros((0, 3, target.n_corners))
    basis = solution.shape.basis if solution.shape is not None and has_bow else no_basis
    problem = Problem(
        corners_board=target.corners_board,
        basis=basis,
        views=views,
        weights={camera: 1 / solution.noise[camera] for camera in lenses},
        free=_free(solution, len(basis)),
    )
    state = State(
        lenses=lenses,
        cams_from_ref=solution.cams_from_ref,
        ref_from_boards=boards,
        bow=solution.shape_parameters if has_bow else np.zeros(0),
    )
    covariance = None if solution.joint is None else solution.joint.of(*lenses)
    return Solved(solution=solution, problem=problem, state=state, covariance=covariance)


def is_trusted(solved: Solved, target: Target) -> bool:
    """Whether the package stands by the result: no finding on the geometry is critical."""
    geometry = SolvedGeometry(solution=solved.solution, held_out={}, rig_settings=None)
    return worst_severity(judge_geometry(geometry, target)) != "critical"


def _free(solution: RigSolution, n_bow: int) -> BoolArray:
    parts = []
    for camera in solution.lenses:
        held = solution.held.get(camera, ())
        parts.append(np.array([name not in held for name in BrownConrady.NAMES]))
        parts.append(np.full(6, camera != solution.reference))
    return np.concatenate([*parts, np.ones(n_bow, dtype=bool)])

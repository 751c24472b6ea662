"""Everything at once: lenses, cameras, boards and the board's shape in one adjustment."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import fdtri

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
)
from calichrome.geometry.bundle.robust import RobustResult, solve_robust
from calichrome.geometry.camera_start import CameraStart, place_views, start_camera
from calichrome.geometry.half_turn import resolve_turns
from calichrome.geometry.rig_problem import (
    FixedParameters,
    Key,
    RigProblem,
    RigSettings,
    Views,
    without_fixed,
)
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_start import RigStart, start_rig
from calichrome.observations import BoardView, Dataset
from calichrome.target import Target

__all__ = ["FixedParameters", "RigSettings", "observed_view", "solve_rig"]

MIN_VIEWS = 2  # of a camera whose lens is sought: Zhang's minimum with the principal point given
_ROUNDS = 3  # of solving and then mending the frames that contradict themselves
_BY_CHANCE = 1e-6
"""How often squares that are square are taken not to be (F-test). A choice: so small that the test
hardly ever decides about nothing, which would make the stated covariance too small. The board is as
described until the residuals say otherwise, since with few tilts an aspect costs the focal lengths
dearly. Without it fx and fy of two of the three real recordings of the tests differ by 0.15 to
0.4 %, with it by 0.1 % at most."""


def solve_rig(dataset: Dataset, target: Target, settings: RigSettings | None = None) -> RigSolution:
    """Calibrate all cameras together.

    Parameters
    ----------
    dataset
        Observations of `target`.
    target
        The board.
    settings
        See `RigSettings`.

    Raises
    ------
    SolveError
        If a camera has too few views, or no lens explains them, naming it.
    DisconnectedRigError, AmbiguousBoardError
        See there.
    """
    settings = settings or RigSettings()
    for camera, views in dataset.views.items():
        if len(views) < MIN_VIEWS and len(settings.fixed_values(camera)) < len(
            settings.model(camera).NAMES
        ):
            raise SolveError(
                f"camera {camera}: {len(views)} views of the board are not enough; record at least "
                f"{MIN_VIEWS}, better 15, each tilted another way"
            )
    problem = _begin(dataset, target, settings)
    turned: list[Key] = []
    support, solved = problem.solve()
    for _ in range(_ROUNDS if len(problem.cameras) > 1 and settings.robust else 0):
        found = problem.contradictions(solved)
        if found.nothing:
            break
        turned += found.turned
        problem = problem.mended(found, solved)
        support, solved = problem.solve()
    if settings.warp and settings.robust and settings.start is None:
        leaning = problem.with_aspect(solved)
        other_support, other = leaning.solve()
        if not other_support.aspect_held and _better(solved, other, leaning.n_aspect_terms):
            problem, support, solved = leaning, other_support, other
    return problem.solution(support, solved, tuple(turned))


def _better(simple: RobustResult, richer: RobustResult, n_more: int) -> bool:
    """Tell whether more terms explain the residuals beyond chance (F-test on all corners)."""
    n_corners = sum(int(part.sum()) for part in richer.inliers)
    freedom = 2 * n_corners - richer.n_unknowns
    gain = (simple.squares / richer.squares - 1) * freedom / max(n_more, 1)
    return bool(freedom > 0 and gain > fdtri(n_more, freedom, 1 - _BY_CHANCE))


def _begin(dataset: Dataset, target: Target, settings: RigSettings) -> RigProblem:
    """Find lenses and places, from nothing or from a solution."""
    points = target.corners_board
    if settings.start is not None:
        start = settings.start
        frames = set(dataset.frames)
        apart = {
            key: pose
            for key, pose in start.apart.items()
            if key[0] in dataset.views and key[1] in dataset.views[key[0]]
        }
        boards = {frame: pose for frame, pose in start.ref_from_boards.items() if frame in frames}
        return RigProblem(
            dataset, target, settings, _observed(dataset),
            {camera: start.lenses[camera] for camera in dataset.views},
            RigStart(start.reference, start.cams_from_ref, boards, apart),
            {camera: _noise_of(start, camera) for camera in dataset.views},
            start.noise_alone, start.has_aspect, start.shape_parameters,
        )  # fmt: skip
    views = _observed(dataset)
    cameras: dict[str, CameraStart] = {}
    for camera, own in views.items():
        try:
            cameras[camera] = start_camera(
                list(own.values()), points, dataset.sizes_wh[camera], settings.model(camera),
                fixed=settings.fixed_values(camera),
            )  # fmt: skip
        except SolveError as error:
            raise SolveError(f"camera {camera}: {error}") from error
    ambiguous = any(
        view.half_turn_ambiguous for own in dataset.views.values() for view in own.values()
    )
    if len(cameras) > 1 and len(target.symmetries) > 1 and ambiguous:
        dataset = resolve_turns(
            dataset,
            target,
            {camera: item.lens for camera, item in cameras.items()},
            {
                camera: {
                    frame: placed.cams_from_board[0]
                    for frame, placed in zip(views[camera], item.views, strict=True)
                }
                for camera, item in cameras.items()
            },
        )
        views = _observed(dataset)
        cameras = {
            camera: CameraStart(
                item.lens, place_views(list(views[camera].values()), points, item.lens)
            )
            for camera, item in cameras.items()
        }
    start_of_rig = start_rig(cameras, views, dataset.sizes_wh, points, settings.reference)
    lenses = {camera: item.lens for camera, item in cameras.items()}
    noise_px = {
        camera: max(float(np.median([placed.errors_px[0] for placed in item.views])), 1e-6)
        for camera, item in cameras.items()
    }
    alone = _noise_alone(views, cameras, points, settings)
    return RigProblem(
        dataset,
        target,
        settings,
        views,
        lenses,
        start_of_rig,
        noise_px,
        alone,
        aspect=False,
        shape_parameters=np.zeros(0),
    )


def _noise_alone(
    views: Views,
    cameras: Mapping[str, CameraStart],
    points_board: FloatArray,
    settings: RigSettings,
) -> dict[str, float]:
    """Noise of each camera when nothing ties it to the others: every view stands by itself."""
    names = list(cameras)
    keys = [(row, frame) for row, camera in enumerate(names) for frame in views[camera]]
    apart = [
        replace(views[names[row]][frame], camera=row, frame=slot)
        for slot, (row, frame) in enumerate(keys)
    ]
    state = BundleState.build(
        [cameras[camera].lens for camera in names],
        [Pose.identity()] * len(names),
        [view.cams_from_board[0] for camera in names for view in cameras[camera].views],
        BoardShape.flat(points_board),
    )
    free = Free.everything(state)
    lenses = without_fixed(free.lenses, names, state, settings)
    free = replace(free, lenses=lenses, cameras=np.zeros(len(names), dtype=bool))
    observations = Observations.pack(apart, points_board, state.models, len(apart))
    solved = solve_robust(observations, state, free)
    return dict(zip(names, map(float, solved.noise), strict=True))


def _noise_of(solution: RigSolution, camera: str) -> float:
    return max(float(np.median(np.linalg.norm(solution.camera_residuals(camera), axis=1))), 1e-6)


def _observed(dataset: Dataset) -> Views:
    return {
        camera: {frame: observed_view(view) for frame, view in own.items()}
        for camera, own in dataset.views.items()
    }


def observed_view(view: BoardView) -> ObservedView:
    """Take the corners of a view, whitened by their covariance."""
    whitening = None
    if view.cov_px is not None:
        whitening = np.linalg.inv(np.linalg.cholesky(view.cov_px))
    return ObservedView(0, 0, view.corner_ids, view.corners_px, whitening)

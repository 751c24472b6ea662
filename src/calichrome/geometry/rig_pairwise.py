"""The paper's way to a rig: each camera, then pairs, then the graph."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import PlanarView, planar_view
from calichrome.geometry.board_pose import solve_board_pose
from calichrome.geometry.half_turn import resolve_turns
from calichrome.geometry.intrinsics import CameraSolution, solve_camera
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.pairs import solve_pair
from calichrome.geometry.rig_graph import RigGraph, connect_cameras
from calichrome.geometry.rig_solution import PairSummary, RigSolution
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["solve_rig_pairwise"]

FixedParameters = Mapping[str, Mapping[str, float]]
Views = Mapping[str, Mapping[str, PlanarView]]


def solve_rig_pairwise(
    dataset: Dataset,
    target: Target,
    *,
    reference: str | None = None,
    fixed: FixedParameters | None = None,
    start: Mapping[str, BrownConrady] | None = None,
) -> RigSolution:
    """Calibrate every camera, every pair that shares frames, and chain them.

    Parameters
    ----------
    dataset
        Observations of `target`.
    target
        The board.
    reference
        Reference camera; None: the one with the least total path error.
    fixed
        camera id -> lens parameters that keep the given value.
    start
        camera id -> a lens near the solution.

    Raises
    ------
    SolveError
        If a camera has too few views, naming it.
    DisconnectedRigError, AmbiguousBoardError
        See there.
    """
    fixed, start = fixed or {}, start or {}
    views, cameras = _solve_cameras(dataset, target, fixed, start)
    if len(cameras) > 1 and len(target.symmetries) > 1 and _any_ambiguous(dataset):
        lenses = {camera: item.lens for camera, item in cameras.items()}
        own = {camera: _poses(views, cameras, camera) for camera in cameras}
        dataset = resolve_turns(dataset, target, lenses, own)
        views, cameras = _solve_cameras(dataset, target, fixed, lenses)
    poses = {camera: _poses(views, cameras, camera) for camera in cameras}
    pairs = {
        (a, b): solve_pair(views[a], views[b], cameras[a], cameras[b], poses[a], poses[b])
        for a, b in combinations(cameras, 2)
        if dataset.shared_frames(a, b)
    }
    graph = connect_cameras(list(cameras), pairs, reference)
    residuals = {
        (camera, frame): part
        for camera, solution in cameras.items()
        for frame, part in zip(views[camera], solution.residuals_px, strict=True)
    }
    return RigSolution(
        dataset=dataset,
        reference=graph.reference,
        lenses={camera: item.lens for camera, item in cameras.items()},
        cams_from_ref={camera: item.pose for camera, item in graph.cams_from_ref.items()},
        ref_from_boards=_place_boards(views, cameras, graph),
        residuals_px=residuals,
        inliers={key: np.ones(len(part), dtype=bool) for key, part in residuals.items()},
        lens_cov={camera: item.lens_cov for camera, item in cameras.items()},
        pose_cov={camera: item.cov for camera, item in graph.cams_from_ref.items()},
        pairs={names: PairSummary(pair.n_shared, pair.rms_px) for names, pair in pairs.items()},
    )


def _place_boards(
    views: Views, cameras: Mapping[str, CameraSolution], graph: RigGraph
) -> dict[str, Pose]:
    """Fit one board pose to each frame, lenses and camera poses fixed.

    Raises
    ------
    SolveError
        If the cameras that see a frame contradict each other so far that no pose can be found.
    """
    frames = dict.fromkeys(frame for seen in views.values() for frame in seen)
    lenses = {camera: solution.lens for camera, solution in cameras.items()}
    motions = {camera: item.pose for camera, item in graph.cams_from_ref.items()}
    placed: dict[str, Pose] = {}
    for frame in frames:
        seen = {camera: views[camera][frame] for camera in cameras if frame in views[camera]}
        try:
            solved = solve_board_pose(seen, lenses, motions)
        except ValueError as error:
            raise SolveError(
                f"frame {frame}: no place of the board suits the cameras that see it "
                f"({', '.join(seen)}); were they recorded at one instant? Leave the frame out"
            ) from error
        placed[frame] = solved.scene.ref_from_boards[0]
    return placed


def _solve_cameras(
    dataset: Dataset,
    target: Target,
    fixed: FixedParameters,
    start: Mapping[str, BrownConrady],
) -> tuple[dict[str, dict[str, PlanarView]], dict[str, CameraSolution]]:
    views = {
        camera: {frame: planar_view(view, target) for frame, view in seen.items()}
        for camera, seen in dataset.views.items()
    }
    cameras = {}
    for camera, seen in views.items():
        try:
            cameras[camera] = solve_camera(
                list(seen.values()),
                dataset.sizes_wh[camera],
                fixed=fixed.get(camera),
                start=start.get(camera),
            )
        except SolveError as error:
            raise SolveError(f"camera {camera}: {error}") from error
    return views, cameras


def _poses(views: Views, cameras: Mapping[str, CameraSolution], camera: str) -> dict[str, Pose]:
    return dict(zip(views[camera], cameras[camera].cams_from_board, strict=True))


def _any_ambiguous(dataset: Dataset) -> bool:
    return any(
        view.half_turn_ambiguous for seen in dataset.views.values() for view in seen.values()
    )

"""The paper's way to a rig: each camera, then pairs, then the graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import PlanarView
from calichrome.geometry.board_pose import solve_board_pose
from calichrome.geometry.half_turn import SolvedViews, resolve_half_turns
from calichrome.geometry.intrinsics import CameraSolution, solve_camera
from calichrome.geometry.lenses import BrownConrady
from calichrome.geometry.pairs import PairSolution, solve_pair
from calichrome.geometry.rig_graph import RigGraph, connect_cameras
from calichrome.observations import BoardView, Dataset
from calichrome.target import Target

__all__ = [
    "FixedParameters",
    "PlacedBoard",
    "RigSolution",
    "place_boards",
    "planar_view",
    "solve_rig_pairwise",
]

FixedParameters = Mapping[str, Mapping[str, float]]
Views = Mapping[str, Mapping[str, PlanarView]]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBoard:
    """Where the board was in one frame, and what is left over in each camera.

    Parameters
    ----------
    ref_from_board
        One pose for all cameras that see it.
    residuals_px
        camera -> (N, 2), projected minus observed.
    """

    ref_from_board: Pose
    residuals_px: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigSolution:
    """Cameras, pairs, the graph, and where the board was in each frame.

    Parameters
    ----------
    dataset
        The observations, with corners renumbered where the board was turned.
    cameras
        By camera id.
    pairs
        (a, b) -> solution, for all pairs that share a frame.
    graph
        Where the cameras are.
    boards
        By frame, from all cameras that see it.
    """

    dataset: Dataset
    cameras: Mapping[str, CameraSolution]
    pairs: Mapping[tuple[str, str], PairSolution]
    graph: RigGraph
    boards: Mapping[str, PlacedBoard]


def planar_view(view: BoardView, target: Target) -> PlanarView:
    """Pair the corners of a view with their places on the board."""
    whitening = None
    if view.cov_px is not None:
        whitening = np.linalg.inv(np.linalg.cholesky(view.cov_px))
    return PlanarView(
        points_board=target.corners_board[view.corner_ids],
        pixels=view.corners_px,
        whitening=whitening,
    )


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
        solved = {
            camera: SolvedViews(cameras[camera].lens, views[camera], _poses(views, cameras, camera))
            for camera in cameras
        }
        turns = resolve_half_turns(solved, target.symmetries)
        dataset = _renumbered(dataset, turns, target.symmetries)
        lenses = {camera: cameras[camera].lens for camera in cameras}
        views, cameras = _solve_cameras(dataset, target, fixed, lenses)
    poses = {camera: _poses(views, cameras, camera) for camera in cameras}
    pairs = {
        (a, b): solve_pair(views[a], views[b], cameras[a], cameras[b], poses[a], poses[b])
        for a, b in combinations(cameras, 2)
        if dataset.shared_frames(a, b)
    }
    graph = connect_cameras(list(cameras), pairs, reference)
    return RigSolution(
        dataset=dataset,
        cameras=cameras,
        pairs=pairs,
        graph=graph,
        boards=place_boards(views, cameras, graph),
    )


def place_boards(
    views: Views, cameras: Mapping[str, CameraSolution], graph: RigGraph
) -> dict[str, PlacedBoard]:
    """Fit one board pose to each frame, lenses and camera poses fixed.

    Raises
    ------
    SolveError
        If the cameras that see a frame contradict each other so far that no pose can be found.
    """
    frames = dict.fromkeys(frame for seen in views.values() for frame in seen)
    lenses = {camera: solution.lens for camera, solution in cameras.items()}
    motions = {camera: item.pose for camera, item in graph.cams_from_ref.items()}
    placed: dict[str, PlacedBoard] = {}
    for frame in frames:
        seen = {camera: views[camera][frame] for camera in cameras if frame in views[camera]}
        try:
            solved = solve_board_pose(seen, lenses, motions)
        except ValueError as error:
            raise SolveError(
                f"frame {frame}: no place of the board suits the cameras that see it "
                f"({', '.join(seen)}); were they recorded at one instant? Leave the frame out"
            ) from error
        ends = np.cumsum([len(view.pixels) for view in seen.values()])[:-1]
        placed[frame] = PlacedBoard(
            solved.scene.ref_from_boards[0],
            dict(zip(seen, np.split(solved.residuals_px, ends), strict=True)),
        )
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


def _renumbered(
    dataset: Dataset, turns: Mapping[str, Mapping[str, int]], symmetries: Sequence[IntArray]
) -> Dataset:
    """Apply the chosen turns; every view holds all corners, sorted by id."""
    views = {
        camera: {
            frame: replace(
                view,
                corners_px=view.corners_px[symmetries[turns[camera][frame]]],
                cov_px=None
                if view.cov_px is None
                else view.cov_px[symmetries[turns[camera][frame]]],
                half_turn_ambiguous=False,
            )
            for frame, view in seen.items()
        }
        for camera, seen in dataset.views.items()
    }
    return dataset.with_views(views)

"""The error on frames that the calibration has not seen."""

from collections.abc import Callable, Sequence

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.camera_start import place_views
from calichrome.geometry.rig_solution import RigSolution, rms_px
from calichrome.geometry.rig_solve import observed_view
from calichrome.observations import Dataset

__all__ = ["held_out_rms_px", "place_boards"]

N_FOLDS = 4
_HUBER = 1.345


def held_out_rms_px(
    rig: RigSolution, points_board: FloatArray, solve: Callable[[Dataset], RigSolution]
) -> dict[str, float | None]:
    """Return per camera the error of 4-fold cross-validation over frames, pixels.

    Lenses, camera poses and the board's shape come from three quarters of the frames; in each frame
    of the last quarter only the board is placed anew, with one place for all cameras. Corners that
    the solution of all frames found to be false do not count.

    Parameters
    ----------
    rig
        The solution from all frames.
    points_board : (n, 3) float, metres
        Of the flat board.
    solve
        Solves the rest of the frames as `rig` was solved.

    Returns
    -------
    dict
        None for a camera where some quarter of the frames leaves too little to calibrate.
    """
    residuals: dict[str, list[FloatArray]] = {camera: [] for camera in rig.lenses}
    for fold in range(N_FOLDS):
        left_out = frozenset(rig.dataset.frames[fold::N_FOLDS])
        training = rig.dataset.without_frames(left_out)
        try:
            if not all(training.views.values()):
                return dict.fromkeys(rig.lenses)
            trained = solve(training)
        except SolveError:
            return dict.fromkeys(rig.lenses)
        for frame in left_out:
            keys = [
                (camera, frame)
                for camera, own in rig.dataset.views.items()
                if frame in own and (camera, frame) not in rig.apart
            ]
            if not keys:
                continue
            try:
                placed = place_boards(trained, rig, keys, points_board)
            except (SolveError, ValueError):
                return dict.fromkeys(rig.lenses)
            for (camera, _), part in zip(keys, placed, strict=True):
                residuals[camera].append(part)
    return {
        camera: rms_px(np.concatenate(parts)) if parts else None
        for camera, parts in residuals.items()
    }


def place_boards(
    trained: RigSolution,
    rig: RigSolution,
    keys: Sequence[tuple[str, str]],
    points_board: FloatArray,
) -> list[FloatArray]:
    """Place the board of one frame in a known rig; return the residuals of its good corners.

    Parameters
    ----------
    trained
        Lenses, cameras and shape.
    rig
        Whose views are placed, and which of their corners are believed.
    keys
        (camera, frame) of each view.
    points_board : (n, 3) float, metres

    Raises
    ------
    ValueError, SolveError
        If no place lies before all cameras.
    """
    cameras = [camera for camera, _ in keys]
    views = []
    for row, key in enumerate(keys):
        view = observed_view(rig.dataset.views[key[0]][key[1]])
        kept = rig.inliers[key]
        noise = trained.noise.get(key[0], 1.0)
        whitening = np.eye(2)[None] if view.whitening is None else view.whitening[kept]
        views.append(
            ObservedView(
                row,
                0,
                view.corner_ids[kept],
                view.pixels[kept],
                np.broadcast_to(whitening / noise, (int(kept.sum()), 2, 2)),
            )
        )
    lenses = [trained.lenses[camera] for camera in cameras]
    motions = [trained.cams_from_ref[camera] for camera in cameras]
    shaped = points_board
    if trained.shape is not None:
        shaped = trained.shape.displaced(points_board, trained.shape_parameters)
    observations = Observations.pack(views, shaped, [type(lens) for lens in lenses], 1)
    flat = BoardShape.flat(shaped)
    ways: list[Pose] = []
    for view, lens, motion in zip(views, lenses, motions, strict=True):
        (placed,) = place_views([view], shaped, lens)
        ways += [motion.inverse() @ place for place in placed.cams_from_board]
    best: tuple[float, BundleState] | None = None
    for way in ways:
        state = BundleState.build(lenses, motions, [way], flat)
        try:
            solved = solve_bundle(observations, state, Free.only_boards(state), huber=_HUBER)
        except ValueError:  # behind a camera
            continue
        if best is None or solved.cost < best[0]:
            best = solved.cost, solved.state
    if best is None:
        raise ValueError("every start lies behind a camera")
    final = solve_bundle(observations, best[1], Free.only_boards(best[1])).state
    return residuals_px(observations, final)

"""The error on frames that the calibration has not seen."""

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import SolveError
from calichrome.geometry.adjustment import rms_px
from calichrome.geometry.rig_solve import (
    FixedParameters,
    RigSolution,
    place_boards,
    planar_view,
    solve_rig_pairwise,
)
from calichrome.target import Target

__all__ = ["held_out_rms_px"]

N_FOLDS = 4


def held_out_rms_px(
    rig: RigSolution, target: Target, *, fixed: FixedParameters | None = None
) -> dict[str, float | None]:
    """Return per camera the error of 4-fold cross-validation over frames, pixels.

    Lenses and camera poses come from three quarters of the frames; in each frame of the last
    quarter only the board is placed anew, with one pose for all cameras.

    Parameters
    ----------
    rig
        The solution from all frames: its lenses are the start, its reference stays.
    target
        The board.
    fixed
        As in `solve_rig_pairwise`.

    Returns
    -------
    dict
        None for a camera where some quarter of the frames leaves too little to calibrate.
    """
    frames = rig.dataset.frames
    residuals: dict[str, list[FloatArray]] = {camera: [] for camera in rig.cameras}
    start = {camera: solution.lens for camera, solution in rig.cameras.items()}
    for fold in range(N_FOLDS):
        left_out = frozenset(frames[fold::N_FOLDS])
        training = rig.dataset.without_frames(left_out)
        try:
            solved = solve_rig_pairwise(
                training, target, reference=rig.graph.reference, fixed=fixed, start=start
            )
        except SolveError:
            return dict.fromkeys(rig.cameras)
        views = {
            camera: {
                frame: planar_view(view, target)
                for frame, view in seen.items()
                if frame in left_out
            }
            for camera, seen in rig.dataset.views.items()
        }
        try:
            placed = place_boards(views, solved.cameras, solved.graph)
        except SolveError:
            return dict.fromkeys(rig.cameras)
        for board in placed.values():
            for camera, part in board.residuals_px.items():
                residuals[camera].append(part)
    return {
        camera: rms_px(np.concatenate(parts)) if parts else None
        for camera, parts in residuals.items()
    }

"""Where each view alone has the board, and whether the cameras agree on it.

A joint solution spreads a contradiction over cameras, frames and lenses, and calls it noise. So
each view places the board once more by itself, through the lens as solved: that fits as well as
corners do, whatever happened to the rig. The places of one frame then differ by what their
covariances allow, or the board moved between the shutters; if one camera's differ by the same
motion from some frame on, it was moved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.bundle.state import adjoint
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rig_solution import RigSolution

__all__ = ["Disagreement", "LoneView", "MotionStep", "disagreements", "lone_views", "motion_step"]

_HUBER_PX = 1.0  # as where a camera begins
_MEDIAN = 1.1774  # of the length of a 2-D residual of unit noise per axis (Rayleigh)
_GATE = 5.0  # sigmas from which a corner says nothing of its board's place; a choice
_SIDE = 3  # frames before and after a motion, at least: fewer are accidents; a choice

Key = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class LoneView:
    """The board as one view has it.

    Parameters
    ----------
    cam_from_board
        Its place.
    residuals_px : (N, 2) float
        Projected minus observed.
    inliers : (N,) bool
        Corners that placed it.
    information : (6, 6) float
        Inverse covariance of the place, for a small motion (omega, tau) after it, rad and m.
    """

    cam_from_board: Pose
    residuals_px: FloatArray
    inliers: BoolArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """How far a camera is from where it should be, if the others have the board's place.

    Parameters
    ----------
    motion : (6,) float, rad and m
        (omega, tau) after cam_from_ref.
    information : (6, 6) float
        Inverse covariance of it.
    board_cam : (3,) float, metres
        Where the others have the middle of the board, seen from the camera.
    """

    motion: FloatArray
    information: FloatArray
    board_cam: FloatArray

    @property
    def per_freedom(self) -> float:
        """Squared motion over its covariance, divided by 6: about 1 where cameras agree."""
        return float(self.motion @ self.information @ self.motion) / 6

    @property
    def distance_m(self) -> float:
        """How far the board seems moved."""
        return _moved_m(self.motion, self.board_cam)

    @property
    def share(self) -> float:
        """That over the distance of the board."""
        return self.distance_m / float(np.linalg.norm(self.board_cam))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionStep:
    """A motion of a camera between two frames.

    Parameters
    ----------
    first
        The frame from which on the camera is elsewhere.
    angle_rad, distance_m
        How far it was turned and moved.
    share
        How far boards seem moved by it, over their distance, in the median frame.
    before, after
        Squared disagreement per degree of freedom without and with the step.
    """

    first: str
    angle_rad: float
    distance_m: float
    share: float
    before: float
    after: float

    @property
    def left(self) -> float:
        """Share of the disagreement that the step does not explain."""
        return self.after / self.before


def lone_views(rig: RigSolution, points_board: FloatArray) -> dict[Key, LoneView]:
    """Place the board of each view by itself.

    Parameters
    ----------
    rig
        Its lenses are taken as they are, its places are the start.
    points_board : (n, 3) float, metres
        Of the flat board.

    Returns
    -------
    dict
        (camera, frame) -> place. All corners of a view count alike.
    """
    if rig.shape is not None:
        points_board = rig.shape.displaced(points_board, rig.shape_parameters)
    lone: dict[Key, LoneView] = {}
    for camera, lens in rig.lenses.items():
        own = rig.dataset.views[camera]
        views = [
            ObservedView(0, row, view.corner_ids, view.corners_px)
            for row, view in enumerate(own.values())
        ]
        state = BundleState.build(
            [lens],
            [Pose.identity()],
            [rig.cam_from_board(camera, frame) for frame in own],
            BoardShape.flat(points_board),
        )
        placed, residuals, inside = _settled(views, points_board, state)
        typical = np.median([_noise(part) for part in residuals])
        for frame, view, place, part, good in zip(
            own, views, placed.ref_from_boards, residuals, inside, strict=True
        ):
            points = place.apply(points_board[view.corner_ids[good]])
            noise_px = max(_noise(part), float(typical), 1e-9)
            information = _information(lens, points) / noise_px**2
            lone[camera, frame] = LoneView(place, part, good, information)
    return lone


def _settled(
    views: Sequence[ObservedView], points_board: FloatArray, state: BundleState
) -> tuple[BundleState, list[FloatArray], list[BoolArray]]:
    """Move the boards alone: robustly, then in least squares on the corners that belong."""
    free = Free.only_boards(state)
    packed = Observations.pack(views, points_board, state.models, len(views))
    state = solve_bundle(packed, state, free, huber=_HUBER_PX).state
    inside = []
    for part in residuals_px(packed, state):
        lengths = np.linalg.norm(part, axis=1)
        inside.append(lengths <= _GATE * max(float(np.median(lengths)) / _MEDIAN, 1e-9))
    kept = [
        replace(view, corner_ids=view.corner_ids[good], pixels=view.pixels[good])
        for view, good in zip(views, inside, strict=True)
    ]
    less = Observations.pack(kept, points_board, state.models, len(views))
    state = solve_bundle(less, state, free).state
    return state, residuals_px(packed, state), inside


def _noise(residuals: FloatArray) -> float:
    """Noise per axis of a view, from the median length; six unknowns were spent on it."""
    n_equations = residuals.size
    spent = np.sqrt(n_equations / max(n_equations - 6, 1))
    return float(np.median(np.linalg.norm(residuals, axis=1)) / _MEDIAN * spent)


def _information(lens: Lens, points_cam: FloatArray) -> FloatArray:
    """J'J of a motion exp(omega) x + tau of points."""
    _, _, by_point = lens.project_with_jacobians(points_cam)
    by_motion = np.concatenate([by_point @ -cross_matrix(points_cam), by_point], axis=2)
    flat = by_motion[np.isfinite(by_motion).all(axis=(1, 2))].reshape(-1, 6)
    return np.asarray(flat.T @ flat)


def disagreements(
    rig: RigSolution, lone: Mapping[Key, LoneView], middle_board: FloatArray
) -> dict[Key, Disagreement]:
    """Ask each view where its camera is, the board being where the frame's other views have it.

    Parameters
    ----------
    rig
        Where its cameras should be.
    lone
        What `lone_views` found.
    middle_board : (3,) float, metres
        Of the board.

    Returns
    -------
    dict
        (camera, frame) of all views of frames that several cameras share.
    """
    found: dict[Key, Disagreement] = {}
    for frame in rig.dataset.frames:
        seen = [camera for camera in rig.lenses if (camera, frame) in lone]
        if len(seen) < 2:
            continue
        start = rig.cams_from_ref[seen[0]].inverse() @ lone[seen[0], frame].cam_from_board
        turns, offsets = {}, {}
        for camera in seen:
            ref_from_cam = rig.cams_from_ref[camera].inverse()
            motion = ref_from_cam @ lone[camera, frame].cam_from_board @ start.inverse()
            to_cam = _adjoint(rig.cams_from_ref[camera])
            turns[camera] = to_cam.T @ lone[camera, frame].information @ to_cam
            offsets[camera] = turns[camera] @ _twist(motion)
        for camera in seen:
            others = [other for other in seen if other != camera]
            information = np.sum([turns[other] for other in others], axis=0)
            mean = np.linalg.solve(
                information, np.sum([offsets[other] for other in others], axis=0)
            )
            board = Pose.from_rotvec(mean[:3], mean[3:]) @ start
            moved = lone[camera, frame].cam_from_board @ board.inverse()
            to_cam = _adjoint(rig.cams_from_ref[camera])
            cov = np.linalg.inv(lone[camera, frame].information)
            cov += to_cam @ np.linalg.inv(information) @ to_cam.T
            motion = moved @ rig.cams_from_ref[camera].inverse()
            board_cam = (rig.cams_from_ref[camera] @ board).apply(middle_board)
            found[camera, frame] = Disagreement(_twist(motion), np.linalg.inv(cov), board_cam)
    return found


def motion_step(by_frame: Mapping[str, Disagreement]) -> MotionStep | None:
    """Find the frame from which on a camera is elsewhere.

    Parameters
    ----------
    by_frame
        Of one camera, in the order of time.

    Returns
    -------
    MotionStep or None
        The best step there is, whether or not it means something; None of too few frames.
    """
    frames, all_of = list(by_frame), list(by_frame.values())
    if len(frames) < 2 * _SIDE:
        return None
    before, _ = _about_mean(all_of)
    best: tuple[float, int, FloatArray] | None = None
    for cut in range(_SIDE, len(frames) - _SIDE + 1):
        (left, first), (right, second) = _about_mean(all_of[:cut]), _about_mean(all_of[cut:])
        if best is None or left + right < best[0]:
            best = left + right, cut, second - first
    if best is None:
        return None
    after, cut, motion = best
    return MotionStep(
        first=frames[cut],
        angle_rad=float(np.linalg.norm(motion[:3])),
        distance_m=float(np.linalg.norm(motion[3:])),
        share=float(
            np.median([_moved_m(motion, x.board_cam) / np.linalg.norm(x.board_cam) for x in all_of])
        ),
        before=before / (6 * (len(frames) - 1)),
        after=after / (6 * (len(frames) - 2)),
    )


def _about_mean(some: Sequence[Disagreement]) -> tuple[float, FloatArray]:
    """Squared disagreement about the weighted mean motion, and that."""
    information = np.sum([item.information for item in some], axis=0)
    pull = np.sum([item.information @ item.motion for item in some], axis=0)
    mean = np.linalg.solve(information, pull)
    apart = [item.motion - mean for item in some]
    squares = [x @ item.information @ x for x, item in zip(apart, some, strict=True)]
    return float(np.sum(squares)), mean


def _moved_m(motion: FloatArray, point: FloatArray) -> float:
    there = Pose.from_rotvec(motion[:3], motion[3:]).apply(point)
    return float(np.linalg.norm(there - point))


def _adjoint(pose: Pose) -> FloatArray:
    return adjoint(pose.rotation, pose.trans_m)


def _twist(motion: Pose) -> FloatArray:
    return np.concatenate([motion.rotvec_rad, motion.trans_m])

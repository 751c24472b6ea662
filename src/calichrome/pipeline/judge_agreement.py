"""Findings on cameras that contradict each other: frames out of step, and cameras that moved."""

from collections.abc import Iterator, Mapping

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.findings import Finding, finding
from calichrome.geometry.agreement import (
    Disagreement,
    LoneView,
    MotionStep,
    disagreements,
    motion_step,
)
from calichrome.geometry.rig_solution import RigSolution

__all__ = ["judge_agreement"]

_SURE = 20.0
"""Squared disagreement per degree of freedom, 1 by chance. A frame of 12 that is this far off moves
the rig by sqrt(6 * 20 / 12) = 3.2 of its sigmas. Synthetic rigs with white noise and a true lens
stay below 4; the real recordings of the tests reach 38, by motions below `_FAR`."""
_FAR = 1.5e-3
"""Motion over distance, 1.5 mm at 1 m, from which it matters; a choice. What the real recordings of
the tests are sure of stays below 1e-3; synthetic boards that moved by 2 mm at 0.6 m are at 2.2e-3
to 3.5e-3."""
_EXPLAINED = 1 / 3
"""Disagreement that a motion of the camera may leave. Synthetic motions of 0.5 mm and more leave up
to 0.1, single bad frames 0.5 to 1, and so do the real recordings of the tests."""

Key = tuple[str, str]


def judge_agreement(
    rig: RigSolution, lone: Mapping[Key, LoneView], middle_board: FloatArray
) -> Iterator[Finding]:
    """Ask whether the cameras agree on where the board was.

    Parameters
    ----------
    rig
        The solution.
    lone
        Where each view alone has the board.
    middle_board : (3,) float, metres
        Of the board.
    """
    moved = []
    while (step := _surest_step(rig, disagreements(rig, lone, middle_board))) is not None:
        camera, others, motion = step
        moved.append(camera)
        lone = {key: view for key, view in lone.items() if key[0] != camera}
        who = f"Camera {camera}" if len(others) > 1 else f"Camera {camera} or {others[0]}"
        yield finding(
            "camera_moved",
            f"{who} stands elsewhere from frame {motion.first} on: moved by about "
            f"{motion.distance_m * 1e3:.2g} mm and {np.degrees(motion.angle_rad):.2g} degrees, or "
            f"its files are another camera's. Calibrate the frames before and after apart, or "
            f"record again.",
            cameras=[camera] if len(others) > 1 else [camera, *others],
            first=motion.first, distance_m=motion.distance_m, angle_rad=motion.angle_rad,
        )  # fmt: skip
    yield from _judge_frames(rig, lone, middle_board, known=bool(moved))
    if rig.turned:
        names = [f"{camera}/{frame}" for camera, frame in rig.turned]
        yield finding(
            "turned_views",
            f"In {', '.join(names[:5])} the corners were counted from the other end of the board; "
            f"they were turned round.",
            views=names,
        )  # fmt: skip


def _surest_step(
    rig: RigSolution, found: Mapping[Key, Disagreement]
) -> tuple[str, list[str], MotionStep] | None:
    """Return the camera whose motion explains most, the cameras it was seen by, and the motion."""
    best: tuple[str, list[str], MotionStep] | None = None
    for camera in rig.lenses:
        by_frame = {
            frame: found[camera, frame]
            for frame in rig.dataset.views[camera]
            if (camera, frame) in found
        }
        step = motion_step(by_frame)
        if (
            step is None
            or step.before < _SURE
            or step.left > _EXPLAINED
            or step.share < _FAR
            or (best is not None and step.left >= best[2].left)
        ):
            continue
        others = sorted({other for other, frame in found if frame in by_frame} - {camera})
        best = camera, others, step
    return best


def _judge_frames(
    rig: RigSolution, lone: Mapping[Key, LoneView], middle_board: FloatArray, *, known: bool
) -> Iterator[Finding]:
    """Name the frames in which cameras contradict each other.

    Parameters
    ----------
    rig, lone, middle_board
        As in `judge_agreement`.
    known
        Whether a camera that moved was named: it may be why views stand apart.
    """
    frames: dict[str, set[str]] = {}
    farthest_m = 0.0
    left = dict(lone)
    while True:
        found = disagreements(rig, left, middle_board)
        off = {
            key: item
            for key, item in found.items()
            if item.per_freedom > _SURE and item.share > _FAR
        }
        if not off:
            break
        for frame in {frame for _, frame in off}:
            own = {key: item for key, item in off.items() if key[1] == frame}
            worst = max(own, key=lambda key: own[key].per_freedom)
            farthest_m = max(farthest_m, own[worst].distance_m)
            seen = {camera for camera, other in found if other == frame}
            # of two, nobody can tell which is right
            frames.setdefault(frame, set()).update(seen if len(seen) == 2 else {worst[0]})
            del left[worst]
    for camera, frame in () if known else rig.apart:
        frames.setdefault(frame, {camera})
    if frames:
        cameras = sorted(set().union(*frames.values()))
        names = [frame for frame in rig.dataset.frames if frame in frames]
        yield finding(
            "unsynchronised",
            f"In frames {', '.join(names[:5])} the cameras have the board in places up to "
            f"{farthest_m * 1e3:.2g} mm apart (most off: {', '.join(cameras[:5])}). It moved "
            f"between their pictures, or files are swapped. Hold it still for each shot; equal "
            f"frame names must be equal instants.",
            cameras=cameras, frames=names, distance_m=farthest_m,
        )  # fmt: skip

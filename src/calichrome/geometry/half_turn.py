"""Boards that look the same after a turn: the rig decides which way up each one was.

A board whose colours survive half a turn gives every view two readings (a square board of even
corner counts four). Only with the right ones does one rigid rig explain all frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.errors import AmbiguousBoardError
from calichrome.geometry.adjustment import PlanarView, planar_view, rms_px
from calichrome.geometry.lenses import Lens
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["SolvedViews", "resolve_half_turns", "resolve_turns"]

_CLEAR = 2.0
"""The runner-up must explain a frame twice as badly. With honest pixels it is tens of times worse
(a wrong half-turn moves corners by half the board), so 2 only sorts out frames that cannot tell."""

_CONTRADICTS, _FALSE_PX = 10.0, 2.0
"""A frame is false, not ambiguous, if even its best reading misses by ten times the median frame
and by 2 px more; choices: wrong turns and swapped frames miss by tens of pixels."""

_NOTHING_PX = 1e-3  # errors below are rounding: a single frame fits every reading exactly
_MAX_SEEDS = 24  # frames whose motion is tried as the rig's; more add time, not certainty


@dataclass(frozen=True, slots=True, eq=False)
class SolvedViews:
    """One camera's lens, with its views and their cam_from_board by frame."""

    lens: Lens
    views: Mapping[str, PlanarView]
    poses: Mapping[str, Pose]


def resolve_half_turns(
    cameras: Mapping[str, SolvedViews], symmetries: Sequence[IntArray]
) -> dict[str, dict[str, int]]:
    """Choose for every view which symmetry renumbers its corners.

    Parameters
    ----------
    cameras
        By camera id; every view holds all corners in the order of the board.
    symmetries
        Permutations of the corners that the board cannot be told from; the first is the identity.

    Returns
    -------
    dict
        camera -> frame -> position in `symmetries`; renumbered pixels are ``pixels[permutation]``.

    Raises
    ------
    AmbiguousBoardError
        Naming the frames that no rig decides.
    """
    turns: dict[str, dict[str, int]] = {}
    doubtful: set[str] = set()
    for camera in _by_overlap(cameras):
        own = cameras[camera]
        others = sorted(turns, key=lambda other: -len(_shared(cameras[other], own)))
        shared = {frame for other in others for frame in _shared(cameras[other], own)}
        decided: dict[str, int] = {}
        for other in others:
            frames = _shared(cameras[other], own)
            if any(frame not in decided for frame in frames):
                decided |= _agree(cameras[other], turns[other], own, decided, frames, symmetries)
        doubtful |= shared - decided.keys()
        # which way up a frame was is free for the first camera that sees it
        turns[camera] = dict.fromkeys(own.views, 0) | decided
    if doubtful:
        raise AmbiguousBoardError(sorted(doubtful))
    return turns


def resolve_turns(
    dataset: Dataset,
    target: Target,
    lenses: Mapping[str, Lens],
    poses: Mapping[str, Mapping[str, Pose]],
) -> Dataset:
    """Renumber the corners of every view so that one rigid rig explains all frames.

    Parameters
    ----------
    dataset
        Views of whole boards.
    target
        The board.
    lenses
        By camera.
    poses
        camera -> frame -> cam_from_board as each camera alone has it.

    Raises
    ------
    AmbiguousBoardError
        See `resolve_half_turns`.
    """
    cameras = {
        camera: SolvedViews(
            lenses[camera],
            {frame: planar_view(view, target) for frame, view in own.items()},
            poses[camera],
        )
        for camera, own in dataset.views.items()
    }
    turns = resolve_half_turns(cameras, target.symmetries)
    views = {
        camera: {
            frame: replace(
                view,
                corners_px=view.corners_px[target.symmetries[turns[camera][frame]]],
                cov_px=None
                if view.cov_px is None
                else view.cov_px[target.symmetries[turns[camera][frame]]],
                half_turn_ambiguous=False,
            )
            for frame, view in own.items()
        }
        for camera, own in dataset.views.items()
    }
    return dataset.with_views(views)


def _shared(a: SolvedViews, b: SolvedViews) -> list[str]:
    return [frame for frame in a.views if frame in b.views]


def _by_overlap(cameras: Mapping[str, SolvedViews]) -> list[str]:
    """Order cameras so that each shares as many frames as possible with one before it."""
    order: list[str] = []
    while len(order) < len(cameras):
        rest = [camera for camera in cameras if camera not in order]
        order.append(
            max(
                rest,
                key=lambda camera: max(
                    (len(_shared(cameras[camera], cameras[other])) for other in order or rest
                     if other != camera),
                    default=0,
                ),
            )
        )  # fmt: skip
    return order


def _agree(
    known: SolvedViews,
    known_turns: Mapping[str, int],
    new: SolvedViews,
    decided: Mapping[str, int],
    frames: Sequence[str],
    symmetries: Sequence[IntArray],
) -> dict[str, int]:
    """Return the frames that one motion between the two cameras decides, and how."""
    corners = known.views[frames[0]].points_board
    board_turns = [_board_turn(corners, permutation) for permutation in symmetries]
    known_poses = {frame: known.poses[frame] @ board_turns[known_turns[frame]] for frame in frames}

    def errors_px(new_from_known: Pose) -> FloatArray:
        rows = []
        for frame in frames:
            predicted = new.lens.project((new_from_known @ known_poses[frame]).apply(corners))
            pixels = new.views[frame].pixels
            rows.append([rms_px(predicted - pixels[permutation]) for permutation in symmetries])
        errors = np.nan_to_num(np.array(rows), nan=np.inf)
        for row, frame in enumerate(frames):
            if frame in decided:
                errors[row, np.arange(len(symmetries)) != decided[frame]] = np.inf
        return np.asarray(errors)

    seeds = frames[:: -(-len(frames) // _MAX_SEEDS)]
    readings = [
        errors_px(new.poses[frame] @ turn @ known_poses[frame].inverse())
        for frame in seeds
        for turn in board_turns
    ]
    totals = [float(errors.min(axis=1).sum()) for errors in readings]
    best = readings[int(np.argmin(totals))]
    choice = best.argmin(axis=1)
    clear = np.ones(len(frames), dtype=bool)
    for errors, total in zip(readings, totals, strict=True):
        differs = errors.argmin(axis=1) != choice
        if total < _CLEAR * min(totals) + _NOTHING_PX:
            clear &= ~differs
    ordered = np.sort(best, axis=1)
    clear &= ordered[:, 1] > _CLEAR * ordered[:, 0] + _NOTHING_PX
    # a frame that no reading explains is not ambiguous but false: who checks frames will find it
    clear |= ordered[:, 0] > _CONTRADICTS * np.median(ordered[:, 0]) + _FALSE_PX
    return {
        frame: int(turn)
        for frame, turn, sure in zip(frames, choice, clear, strict=True)
        if sure and frame not in decided
    }


def _board_turn(corners: FloatArray, permutation: IntArray) -> Pose:
    """Return the motion of the board plane that takes corner i to corner permutation[i]."""
    turned = corners[permutation]
    x_axis = (turned[1] - turned[0]) / np.linalg.norm(corners[1] - corners[0])
    z_axis = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1)
    return Pose(rotation, turned[0] - rotation @ corners[0])

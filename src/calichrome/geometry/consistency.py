"""Frames whose cameras contradict each other, and what mends them.

A frame in which the board moved between two shutters, whose files were swapped, or whose corners
were counted from the other end fits no single place of the board. The largest group of views that
share one is kept; the others are tried half turned, and else stand apart with a place of their own:
they still tell of their lens.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import (
    BoardShape,
    BundleState,
    Free,
    Observations,
    ObservedView,
    residuals_px,
    solve_bundle,
)
from calichrome.geometry.camera_start import mirrored_place
from calichrome.geometry.lenses import Lens
from calichrome.geometry.rig_start import half_turned

__all__ = ["Contradictions", "RigPlaces", "contradictions"]

Key = tuple[str, str]
Slot = str | Key

_LIMIT = 4.0
"""Median residual of a view over that of its camera alone. Views of the real recordings of the
tests are below 2; a view moved by one pixel against corners good to 0.2 px is at 4 to 5."""
_MEDIAN = 1.1774  # of the length of a 2-D residual of unit noise per axis (Rayleigh)
_HUBER = 1.345


@dataclass(frozen=True, slots=True, eq=False)
class RigPlaces:
    """What is known of a rig when its frames are checked.

    Parameters
    ----------
    lenses, cams_from_ref
        By camera.
    noise
        camera -> by what its residuals exceed their stated noise when it is solved alone. The noise
        of the joint solution would not do: where most views of a camera contradict the others, it
        is made of the contradictions.
    places
        Frame -> ref_from_board; (camera, frame) of a view that stands apart -> the same.
    points_board : (n, 3) float, metres
        With the board's shape.
    """

    lenses: Mapping[str, Lens]
    cams_from_ref: Mapping[str, Pose]
    noise: Mapping[str, float]
    places: Mapping[Slot, Pose]
    points_board: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Contradictions:
    """What to change.

    Parameters
    ----------
    boards
        Frame -> ref_from_board.
    apart
        (camera, frame) -> cam_from_board of all views that stand apart from now on.
    turned
        Views whose corners are to be counted from the other end.
    nothing
        True if all is as it was.
    """

    boards: Mapping[str, Pose]
    apart: Mapping[Key, Pose]
    turned: tuple[Key, ...]
    nothing: bool


def contradictions(
    views: Mapping[str, Mapping[str, ObservedView]], rig: RigPlaces
) -> Contradictions:
    """Check every frame that several cameras see."""
    before = {slot for slot in rig.places if not isinstance(slot, str)}
    boards = {slot: place for slot, place in rig.places.items() if isinstance(slot, str)}
    apart = {key: rig.cams_from_ref[key[0]] @ rig.places[key] for key in sorted(before)}
    turned: list[Key] = []
    bad = {
        frame: cameras
        for frame in boards
        if (cameras := _explained_badly(frame, views, rig, before))
    }
    suspicion = {
        camera: sum(camera in cameras for cameras in bad.values()) for camera in rig.lenses
    }
    for frame in dict.fromkeys([*bad, *(frame for _, frame in before if frame in boards)]):
        seen = {camera: own[frame] for camera, own in views.items() if frame in own}
        group = [camera for camera in seen if (camera, frame) not in before]
        start = rig.places[frame]
        if frame in bad and len(group) > 1:
            group, start = _largest_group(group, seen, start, rig, suspicion)
        for camera in [camera for camera in seen if camera not in group]:
            own = apart.get((camera, frame)) or rig.cams_from_ref[camera] @ start
            group, start, is_turned = _joined(camera, group, seen, start, own, rig)
            if is_turned:
                turned.append((camera, frame))
            if camera in group:
                apart.pop((camera, frame), None)
            else:
                apart[camera, frame] = own
        boards[frame] = start
    return Contradictions(boards, apart, tuple(turned), nothing=not turned and set(apart) == before)


def _explained_badly(
    frame: str,
    views: Mapping[str, Mapping[str, ObservedView]],
    rig: RigPlaces,
    apart: set[Key],
) -> list[str]:
    """Return the cameras of a frame of several whose view misses the limit."""
    seen = {
        camera: own[frame]
        for camera, own in views.items()
        if frame in own and (camera, frame) not in apart
    }
    if len(seen) < 2:
        return []
    return [
        camera
        for camera, view in seen.items()
        if _median(view, camera, rig.cams_from_ref[camera] @ rig.places[frame], rig) > _LIMIT
    ]


def _median(view: ObservedView, camera: str, cam_from_board: Pose, rig: RigPlaces) -> float:
    points = cam_from_board.apply(rig.points_board[view.corner_ids])
    residuals = rig.lenses[camera].project(points) - view.pixels
    if view.whitening is not None:
        residuals = np.einsum("nij,nj->ni", view.whitening, residuals)
    lengths = np.nan_to_num(np.linalg.norm(residuals, axis=1), nan=np.inf)
    return float(np.median(lengths)) / (_MEDIAN * rig.noise[camera])


def _largest_group(
    group: list[str],
    seen: Mapping[str, ObservedView],
    start: Pose,
    rig: RigPlaces,
    suspicion: Mapping[str, int],
) -> tuple[list[str], Pose]:
    """Leave out one view after the other until one place of the board explains the rest."""
    while True:
        (place, worst), *_ = _refitted([group], seen, [start], rig)
        if worst <= _LIMIT or len(group) == 1:
            return group, place
        if len(group) == 2:  # who is right cannot be told: the less suspicious stays
            keeper = min(group, key=lambda camera: suspicion[camera])
            group, start = [keeper], place
            continue
        smaller = [[camera for camera in group if camera != out] for out in group]
        fits = _refitted(smaller, seen, [place] * len(smaller), rig)
        best = int(np.argmin([error for _, error in fits]))
        group, start = smaller[best], fits[best][0]


def _joined(
    camera: str,
    group: list[str],
    seen: Mapping[str, ObservedView],
    start: Pose,
    own: Pose,
    rig: RigPlaces,
) -> tuple[list[str], Pose, bool]:
    """Try whether a view belongs to the group after all, or does when counted the other way."""
    turned = dict(seen) | {camera: half_turned(seen[camera], len(rig.points_board))}
    wider = [*group, camera]
    other = rig.cams_from_ref[camera].inverse() @ own
    for candidate, is_turned in ((seen, False), (turned, True)):
        starts = [start] if is_turned else [start, other]
        for place, worst in _refitted([wider] * len(starts), candidate, starts, rig):
            if worst <= _LIMIT:
                return wider, place, is_turned
    return group, start, False


def _refitted(
    groups: Sequence[Sequence[str]],
    seen: Mapping[str, ObservedView],
    starts: Sequence[Pose],
    rig: RigPlaces,
) -> list[tuple[Pose, float]]:
    """Place the board for each group of cameras; return the place and its worst view's median.

    Every group is tried from its start and from the mirrored place there, all in one adjustment.
    """
    middle = rig.points_board.mean(axis=0)
    tries: list[tuple[int, Pose]] = []
    for index, (group, start) in enumerate(zip(groups, starts, strict=True)):
        first = rig.cams_from_ref[group[0]]
        ways = (start, first.inverse() @ mirrored_place(first @ start, middle))
        tries += [(index, way) for way in ways if _has_images(way, group, seen, rig)]
    best = [(start, np.inf) for start in starts]
    if not tries:
        return best
    cameras = list(rig.lenses)
    keys = [(slot, camera) for slot, (index, _) in enumerate(tries) for camera in groups[index]]
    whitenings = [_by_noise(seen[camera], rig.noise[camera]) for _, camera in keys]
    views = [
        replace(seen[camera], camera=cameras.index(camera), frame=slot, whitening=whitening)
        for (slot, camera), whitening in zip(keys, whitenings, strict=True)
    ]
    observations = Observations.pack(
        views, rig.points_board, [type(lens) for lens in rig.lenses.values()], len(tries)
    )
    state = BundleState.build(
        list(rig.lenses.values()),
        [rig.cams_from_ref[camera] for camera in cameras],
        [way for _, way in tries],
        BoardShape.flat(rig.points_board),
    )
    state = solve_bundle(
        observations, state, Free.only_boards(state), huber=_HUBER, max_iterations=30,
        relative_decrease=1e-6,
    ).state  # fmt: skip
    worst = np.zeros(len(tries))
    for (slot, _), part, w in zip(keys, residuals_px(observations, state), whitenings, strict=True):
        lengths = np.linalg.norm(np.einsum("nij,nj->ni", w, part), axis=1)
        worst[slot] = max(worst[slot], float(np.median(lengths)) / _MEDIAN)
    for (index, _), place, error in zip(tries, state.ref_from_boards, worst, strict=True):
        if error < best[index][1]:
            best[index] = place, float(error)
    return best


def _has_images(
    ref_from_board: Pose, group: Sequence[str], seen: Mapping[str, ObservedView], rig: RigPlaces
) -> bool:
    """Whether every camera of a group has an image of every corner that it saw."""
    return all(
        np.isfinite(
            rig.lenses[camera].project(
                (rig.cams_from_ref[camera] @ ref_from_board).apply(
                    rig.points_board[seen[camera].corner_ids]
                )
            )
        ).all()
        for camera in group
    )


def _by_noise(view: ObservedView, noise: float) -> FloatArray:
    whitening = np.eye(2)[None] if view.whitening is None else view.whitening
    return np.asarray(np.broadcast_to(whitening, (len(view.pixels), 2, 2)) / noise)

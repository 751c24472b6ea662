"""Where to begin with a rig: where the cameras are, and where the board was in each frame.

Every frame that two cameras share says where one is from the other, each view in two ways; the
motion that most frames accept is taken, whatever the rest say. Then each frame places the board
where most of its views want it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import ObservedView
from calichrome.geometry.camera_start import CameraStart, PlacedView
from calichrome.geometry.lenses import Lens
from calichrome.geometry.pairs import PairSolution
from calichrome.geometry.rig_graph import connect_cameras

__all__ = ["RigStart", "SeenBoard", "half_turned", "place_frame", "start_rig"]

_MAX_SEEDS = 12  # frames whose motion is tried as the pair's; more add time, not certainty
_SAMPLED = 15  # corners of a view that vote on a motion; their median bears seven false ones
_AGREES = 0.02
"""Of the picture's larger side: a view is explained when the median corner is nearer. A start errs
by some tenths of that; a wrong half-turn or a neighbour's frame by tens of times more."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoard:
    """A view, the lens it came through, and the places that it allows.

    Parameters
    ----------
    view, lens, placed
        Of one camera in one frame.
    limit_px
        Median error up to which a place explains the view.
    """

    view: ObservedView
    lens: Lens
    placed: PlacedView
    limit_px: float

    def error_px(self, cam_from_board: Pose, points_board: FloatArray) -> float:
        """Median 2-D residual at a place; inf where a corner has no image."""
        points = cam_from_board.apply(points_board[self.view.corner_ids])
        errors = np.linalg.norm(self.lens.project(points) - self.view.pixels, axis=1)
        return float(np.median(np.nan_to_num(errors, nan=np.inf)))


@dataclass(frozen=True, slots=True, eq=False)
class RigStart:
    """A rig near the solution.

    Parameters
    ----------
    reference
        Camera whose frame is ref.
    cams_from_ref
        By camera.
    ref_from_boards
        By frame.
    apart
        (camera, frame) -> cam_from_board of views that contradict the others of their frame.
    """

    reference: str
    cams_from_ref: Mapping[str, Pose]
    ref_from_boards: Mapping[str, Pose]
    apart: Mapping[tuple[str, str], Pose]


def start_rig(
    cameras: Mapping[str, CameraStart],
    views: Mapping[str, Mapping[str, ObservedView]],
    sizes_wh: Mapping[str, tuple[int, int]],
    points_board: FloatArray,
    reference: str | None,
) -> RigStart:
    """Place cameras and boards.

    Parameters
    ----------
    cameras
        Lens and places by camera, in the order of `views[camera]`.
    views
        camera -> frame -> view.
    sizes_wh
        By camera, pixels.
    points_board : (n, 3) float, metres
    reference
        Reference camera; None: the one with the least total path error.

    Raises
    ------
    DisconnectedRigError
        If some cameras are not connected.
    """
    seen = {
        camera: {
            frame: SeenBoard(view, cameras[camera].lens, placed, _AGREES * max(sizes_wh[camera]))
            for (frame, view), placed in zip(own.items(), cameras[camera].views, strict=True)
        }
        for camera, own in views.items()
    }
    pairs = {}
    for a, b in combinations(seen, 2):
        shared = [frame for frame in seen[a] if frame in seen[b]]
        if shared:
            pairs[a, b] = _pair(
                [seen[a][frame] for frame in shared],
                [seen[b][frame] for frame in shared],
                points_board,
            )
    graph = connect_cameras(list(seen), pairs, reference)
    cams_from_ref = {camera: place.pose for camera, place in graph.cams_from_ref.items()}
    boards: dict[str, Pose] = {}
    apart: dict[tuple[str, str], Pose] = {}
    for frame in dict.fromkeys(frame for own in seen.values() for frame in own):
        own_views = {camera: own[frame] for camera, own in seen.items() if frame in own}
        boards[frame], strangers = place_frame(own_views, cams_from_ref, points_board)
        for camera in strangers:
            apart[camera, frame] = own_views[camera].placed.cams_from_board[0]
    return RigStart(graph.reference, cams_from_ref, boards, apart)


def place_frame(
    seen: Mapping[str, SeenBoard], cams_from_ref: Mapping[str, Pose], points_board: FloatArray
) -> tuple[Pose, tuple[str, ...]]:
    """Place the board where most views explain it, and name the cameras that do not."""
    ways = [
        cams_from_ref[camera].inverse() @ place
        for camera, board in seen.items()
        for place in board.placed.cams_from_board
    ]
    if len(seen) == 1:
        return ways[0], ()
    errors = np.array(
        [
            [board.error_px(cams_from_ref[camera] @ way, points_board) / board.limit_px
             for camera, board in seen.items()]
            for way in ways
        ]
    )  # fmt: skip
    best = int(np.argmin(np.minimum(errors, 1.0).sum(axis=1)))
    return ways[best], tuple(
        camera for camera, error in zip(seen, errors[best], strict=True) if error > 1
    )


def half_turned(view: ObservedView, n_corners: int) -> ObservedView:
    """Count the corners of a view from the other end of the board."""
    return ObservedView(
        view.camera, view.frame, n_corners - 1 - view.corner_ids, view.pixels, view.whitening
    )


def _pair(
    first: Sequence[SeenBoard], second: Sequence[SeenBoard], points_board: FloatArray
) -> PairSolution:
    """Find the motion from the first camera to the second that most frames accept."""
    a, b = _Samples.of(first, points_board), _Samples.of(second, points_board)
    seeds = range(0, len(first), -(-len(first) // _MAX_SEEDS))
    motions = [
        to_b @ to_a.inverse()
        for index in seeds
        for to_a in first[index].placed.cams_from_board
        for to_b in second[index].placed.cams_from_board
    ]
    errors = np.stack([_errors(motion, a, b) for motion in motions])
    cost = np.minimum(errors, 1.0).mean(axis=1)
    best = int(np.argmin(cost))
    chosen, accepted = motions[best], errors[best]
    agreeing = np.flatnonzero(accepted < 1).tolist()
    if len(agreeing) > 2:  # the mean of those who agree is mostly better than any of them
        mean = Pose.mean(
            [
                second[index].placed.cams_from_board[0]
                @ first[index].placed.cams_from_board[0].inverse()
                for index in agreeing
            ]
        )
        refined = _errors(mean, a, b)
        if np.minimum(refined, 1.0).mean() < cost[best]:
            chosen, accepted = mean, refined
    return PairSolution(
        b_from_a=chosen,
        errors=None,
        rms_px=float(np.minimum(accepted, 1.0).mean()) * second[0].limit_px,
        n_shared=int((accepted < 1).sum()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Some corners of each view of one camera: enough for a median, and of equal number.

    Parameters
    ----------
    pixels : (F, n, 2) float
    places : (2, F, n, 3) float
        The corners in the camera, at the better and the other place of the board.
    """

    lens: Lens
    pixels: FloatArray
    places: FloatArray
    limit_px: float

    @classmethod
    def of(cls, seen: Sequence[SeenBoard], points_board: FloatArray) -> "_Samples":
        pixels, places = [], []
        for board in seen:
            rows = np.linspace(0, len(board.view.pixels) - 1, _SAMPLED).round().astype(np.int64)
            points = points_board[board.view.corner_ids[rows]]
            both = board.placed.cams_from_board
            pixels.append(board.view.pixels[rows])
            places.append([both[0].apply(points), both[-1].apply(points)])
        return cls(seen[0].lens, np.stack(pixels), np.stack(places, axis=1), seen[0].limit_px)

    def errors(self, own_from_other: Pose, other: "_Samples") -> FloatArray:
        """Median error of each frame over what is allowed, by the better of the other's places."""
        projected = self.lens.project(own_from_other.apply(other.places))
        errors = np.nan_to_num(np.linalg.norm(projected - self.pixels, axis=-1), nan=np.inf)
        return np.asarray(np.median(errors, axis=-1).min(axis=0) / self.limit_px)


def _errors(b_from_a: Pose, a: _Samples, b: _Samples) -> FloatArray:
    """Error of each frame over what is allowed, both ways."""
    both = np.maximum(b.errors(b_from_a, a), a.errors(b_from_a.inverse(), b))
    return np.minimum(both, 1e3)

"""Where the boards of new pictures are, whether or not the cameras are where they were."""

from collections.abc import Mapping

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.bundle import ObservedView
from calichrome.geometry.camera_start import PlacedView, place_views
from calichrome.geometry.lenses import Lens

__all__ = ["Places", "Views", "gated", "place_frames"]

Views = Mapping[str, Mapping[str, ObservedView]]
Places = Mapping[tuple[str, str], PlacedView]

_MEDIAN = 1.1774  # of the length of a 2-D residual of unit noise per axis (Rayleigh)
_LOST = 1e-3  # good corners that the gate may take in all; as in the calibration
_AT_MOST_PX = 50.0  # error of one view that counts where a board is placed: one must not decide


def gated(
    views: Views, lenses: Mapping[str, Lens], points_board: FloatArray
) -> tuple[Views, Places]:
    """Leave out corners that lie, and place every view by itself.

    Raises
    ------
    SolveError
        If a view lies where its lens has no rays.
    """
    n_corners = sum(len(view.pixels) for own in views.values() for view in own.values())
    limit = np.sqrt(2 * np.log(n_corners / _LOST)) / _MEDIAN
    kept: dict[str, dict[str, ObservedView]] = {}
    places: dict[tuple[str, str], PlacedView] = {}
    for camera, own in views.items():
        placed = place_views(list(own.values()), points_board, lenses[camera])
        kept[camera] = {}
        for (frame, view), place in zip(own.items(), placed, strict=True):
            errors = _errors(view, lenses[camera], place.cams_from_board[0], points_board)
            good = errors <= limit * max(float(np.median(errors)), 1e-9)
            whitening = None if view.whitening is None else view.whitening[good]
            kept[camera][frame] = ObservedView(
                view.camera, view.frame, view.corner_ids[good], view.pixels[good], whitening
            )
            places[camera, frame] = place
    return kept, places


def place_frames(
    views: Views,
    lenses: Mapping[str, Lens],
    cams_from_ref: Mapping[str, Pose],
    points_board: FloatArray,
    places: Places,
) -> dict[str, Pose]:
    """Return ref_from_board of every frame: of all the views' own, what most cameras accept."""
    boards = {}
    for frame in dict.fromkeys(frame for own in views.values() for frame in own):
        seen = {camera: own[frame] for camera, own in views.items() if frame in own}
        ways = [
            cams_from_ref[camera].inverse() @ cam_from_board
            for camera in seen
            for cam_from_board in places[camera, frame].cams_from_board
        ]
        misses = [
            sum(
                min(
                    float(np.median(_errors(view, lenses[camera], cams_from_ref[camera] @ way,
                                            points_board))), _AT_MOST_PX)
                for camera, view in seen.items()
            )
            for way in ways
        ]  # fmt: skip
        boards[frame] = ways[int(np.argmin(misses))]
    return boards


def _errors(
    view: ObservedView, lens: Lens, cam_from_board: Pose, points_board: FloatArray
) -> FloatArray:
    """2-D residuals, pixels; infinite where the lens has no image."""
    projected = lens.project(cam_from_board.apply(points_board[view.corner_ids]))
    errors = np.linalg.norm(projected - view.pixels, axis=1)
    return np.asarray(np.nan_to_num(errors, nan=np.inf))

"""Other detectors behind one face: a grey picture in, points and perhaps their ids out.

A package that cannot be imported makes its detector None; the tables then say "not run".
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Literal

import cv2
import numpy as np
from benchmarks.detection.scenes import charuco_board

from calichrome.core.arrays import FloatArray, IntArray, UInt8Array
from calichrome.detection import detect_board
from calichrome.imaging import Image
from calichrome.observations import BoardView
from calichrome.target import Target

__all__ = ["DETECTORS", "Detection", "Detector", "corner_spacing"]


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """What a detector says.

    Parameters
    ----------
    points_px : (N, 2) float
    corner_ids : (N,) int, or None
        Ids on the board; None for points only or a grid of unknown place.
    cov_px : (N, 2, 2) float, or None
    """

    points_px: FloatArray
    corner_ids: IntArray | None = None
    cov_px: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Detector:
    """A detector as the table knows it.

    Parameters
    ----------
    find
        Picture and target to a detection; None if there is none.
    ids
        "absolute"; "whole": ids of a whole board, right up to a half turn; "none".
    own_board
        Whether it has a board of its own, the ChArUco one.
    """

    find: Callable[[UInt8Array, Target], Detection | None] | None
    ids: Literal["absolute", "whole", "none"]
    own_board: bool = False


def corner_spacing(points_px: FloatArray, corners_xy: tuple[int, int]) -> float:
    """Return the smallest distance of neighbours in a whole grid of corners (N, 2)."""
    grid = points_px.reshape(corners_xy[1], corners_xy[0], 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    return float(min(steps))


def _calichrome(picture: UInt8Array, target: Target) -> Detection | None:
    view = detect_board(Image(pixels=picture, encoding="linear", bits=8), target)
    if not isinstance(view, BoardView):
        return None
    return Detection(view.corners_px, view.corner_ids, view.cov_px)


def _whole(found: bool, points: object, target: Target) -> Detection | None:  # noqa: FBT001
    if not found:
        return None
    flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return Detection(flat, np.arange(target.n_corners))


def _classic(picture: UInt8Array, target: Target) -> Detection | None:
    return _whole(*cv2.findChessboardCorners(picture, target.corners_xy), target)


def _sector_based(picture: UInt8Array, target: Target) -> Detection | None:
    return _whole(*cv2.findChessboardCornersSB(picture, target.corners_xy), target)


def _refined(
    half_window: int | None,
) -> Callable[[UInt8Array, Target], Detection | None]:
    """Classic with cornerSubPix; a half window of None is 0.3 of the smallest spacing."""

    def find(picture: UInt8Array, target: Target) -> Detection | None:
        start = _classic(picture, target)
        if start is None:
            return None
        half = half_window
        if half is None:
            half = max(2, round(0.3 * corner_spacing(start.points_px, target.corners_xy)))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
        points = start.points_px.astype(np.float32).reshape(-1, 1, 2)
        refined = cv2.cornerSubPix(picture, points, (half, half), (-1, -1), stop)
        return _whole(True, refined, target)  # noqa: FBT003

    return find


def _charuco(picture: UInt8Array, target: Target) -> Detection | None:
    corners, ids, _, _ = _charuco_detector(target.squares).detectBoard(picture)
    if ids is None or not len(ids):
        return None
    return Detection(np.float64(corners).reshape(-1, 2), np.int64(ids).ravel())


@cache
def _charuco_detector(squares: tuple[int, int]) -> cv2.aruco.CharucoDetector:
    return cv2.aruco.CharucoDetector(charuco_board(squares))


def _optional(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def _chess_corners() -> Callable[[UInt8Array, Target], Detection | None] | None:
    module = _optional("chess_corners")
    if module is None:
        return None
    config = module.DetectorConfig.chess().with_chess(refiner=module.ChessRefiner.saddle_point())
    detector = module.Detector(config)

    def find(picture: UInt8Array, _: Target) -> Detection | None:
        points = np.asarray(detector.detect(picture).xy, dtype=np.float64)
        return Detection(points.reshape(-1, 2)) if len(points) else None

    return find


def _calib_targets() -> Callable[[UInt8Array, Target], Detection | None] | None:
    module = _optional("calib_targets")
    if module is None:
        return None

    def find(picture: UInt8Array, _: Target) -> Detection | None:
        result = module.detect_chessboard(picture)
        if result is None:
            return None
        points = [tuple(corner.position) for corner in result.corners]
        return Detection(np.array(points, dtype=np.float64).reshape(-1, 2))

    return find


DETECTORS: Mapping[str, Detector] = {
    "calichrome": Detector(_calichrome, "absolute"),
    "classic + cornerSubPix(0.3 x spacing)": Detector(_refined(None), "whole"),
    "classic + cornerSubPix(5)": Detector(_refined(5), "whole"),
    "classic + cornerSubPix(11)": Detector(_refined(11), "whole"),
    "findChessboardCornersSB": Detector(_sector_based, "whole"),
    "chess-corners, saddle_point (points only)": Detector(_chess_corners(), "none"),
    "calib-targets (grid, ids unknown)": Detector(_calib_targets(), "none"),
    "ChArUco, its own board": Detector(_charuco, "absolute", own_board=True),
}
"""Names as in the table; "calichrome" is this package."""

"""Real recordings: python -m benchmarks.detection.real --data FOLDER.

Per camera: in how many pictures each detector finds the board, and the held-out error of
`cv2.calibrateCamera` (k3 = 0, no weights) on the corners of each, same views and same corners:
four folds over views, pose of a held-out view from the corners themselves.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from benchmarks.detection.peers import DETECTORS, Detection

from calichrome.core.arrays import FloatArray, IntArray, UInt8Array
from calichrome.detection import detect_board
from calichrome.imaging import Image, read_image
from calichrome.observations import BoardView
from calichrome.target import Target
from calichrome.target.board import chessboard
from calichrome.target.file import load_target

__all__ = ["held_out_rms_px", "main"]

_FOLDS = 4
_CLASSIC_5 = "classic + cornerSubPix(5)"
_CLASSIC_SPACING = "classic + cornerSubPix(0.3 x spacing)"
_SECTOR_BASED = "findChessboardCornersSB"
_OURS = "calichrome"


@dataclass(frozen=True, slots=True)
class _RealSet:
    """Where a recording is and what it shows; `target` is a file or the number of corners."""

    folder: str
    target: str | tuple[int, int]
    cameras: Mapping[str, str]


_SETS = (
    _RealSet("opencv_stereo", (9, 6), {"left": "left*.jpg", "right": "right*.jpg"}),
    _RealSet("boofcv_bumblebee2_chess", (4, 6), {"left": "left*.jpg", "right": "right*.jpg"}),
    _RealSet(
        "boofcv_trinocular_odd",
        (9, 13),
        {name: f"{name}/*.jpg" for name in ("left", "middle", "right")},
    ),
    _RealSet(
        "render/recording", "render/recording/target.json", {"cam0": "cam0/*.*", "cam1": "cam1/*.*"}
    ),
)


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    print(
        "| camera | pictures | found: ours | classic | SB | same views | held-out RMS px: "
        "cornerSubPix(5) | (0.3 x spacing) | ours | ours / better of both |"
    )
    print("|" + " --- |" * 10)
    notes: list[str] = []
    for real_set in _SETS:
        if not (options.data / real_set.folder).is_dir():
            print(f"| {real_set.folder} | not there |")
            continue
        target = _target(options.data, real_set)
        for camera, pattern in real_set.cameras.items():
            paths = sorted((options.data / real_set.folder).glob(pattern))
            notes += _camera_row(f"{real_set.folder} {camera}", paths, target)
    print("\n".join(["", *notes]))


def _target(data: Path, real_set: _RealSet) -> Target:
    if isinstance(real_set.target, str):
        return load_target(data / real_set.target)
    return chessboard(real_set.target, (1.0, 1.0))


def _camera_row(name: str, paths: Sequence[Path], target: Target) -> list[str]:
    """Print the row of a camera; return why pictures have no board by ours."""
    found: dict[str, dict[Path, Detection]] = {
        key: {} for key in (_OURS, _CLASSIC_5, _CLASSIC_SPACING, _SECTOR_BASED)
    }
    notes = []
    size_wh = (0, 0)
    for path in paths:
        image = read_image(path)
        if not isinstance(image, Image):
            notes.append(f"{path.name}: {image.reason}")
            continue
        size_wh = image.size_wh
        view = detect_board(image, target)
        if isinstance(view, BoardView):
            found[_OURS][path] = Detection(view.corners_px, view.corner_ids, view.cov_px)
        else:
            notes.append(f"{name} {path.name}: {view.reason}")
        for key in (_CLASSIC_5, _CLASSIC_SPACING, _SECTOR_BASED):
            find = DETECTORS[key].find
            detection = None if find is None else find(_grey8(image), target)
            if detection is not None:
                found[key][path] = detection
    print(f"| {name} | {len(paths)} | {_comparison(found, target, size_wh)} |")
    return notes


def _comparison(
    found: Mapping[str, dict[Path, Detection]], target: Target, size_wh: tuple[int, int]
) -> str:
    views = [path for path in found[_OURS] if path in found[_CLASSIC_5]]
    errors = []
    for key in (_CLASSIC_5, _CLASSIC_SPACING, _OURS):
        corners = [_matched(found[key][path], found[_OURS][path]) for path in views]
        errors.append(held_out_rms_px(corners, target, size_wh))
    counts = [len(found[key]) for key in (_OURS, _CLASSIC_5, _SECTOR_BASED)]
    return " | ".join(
        [
            *map(str, counts),
            str(len(views)),
            *(f"{error:.4f}" for error in errors),
            f"{errors[2] / min(errors[:2]):.3f}",
        ]
    )


def _matched(detection: Detection, ours: Detection) -> tuple[IntArray, FloatArray]:
    """Ids and points of the corners that ours has, numbered as ours numbers them."""
    ids = _ids(ours)
    mine = _ids(detection)
    if detection is ours:
        return ids, detection.points_px
    points = detection.points_px[np.argsort(mine)]
    straight, turned = points[ids], points[::-1][ids]
    offsets = [np.median(np.linalg.norm(p - ours.points_px, axis=1)) for p in (straight, turned)]
    return ids, straight if offsets[0] <= offsets[1] else turned


def _ids(detection: Detection) -> IntArray:
    if detection.corner_ids is None:
        raise ValueError("real: a detector without ids cannot calibrate")
    return detection.corner_ids


def held_out_rms_px(
    views: Sequence[tuple[IntArray, FloatArray]], target: Target, size_wh: tuple[int, int]
) -> float:
    """Calibrate on three quarters of the views, predict the others; RMS of 2-D errors, px."""
    if len(views) < 2 * _FOLDS:
        return float("nan")
    squares = []
    for fold in range(_FOLDS):
        kept = [view for index, view in enumerate(views) if index % _FOLDS != fold]
        left = [view for index, view in enumerate(views) if index % _FOLDS == fold]
        objects = [np.float32(target.corners_board[ids]) for ids, _ in kept]
        pictures = [np.float32(points) for _, points in kept]
        _, matrix, distortion, _, _ = cv2.calibrateCamera(
            objects, pictures, size_wh, None, None, flags=cv2.CALIB_FIX_K3
        )
        for ids, points in left:
            board = target.corners_board[ids]
            _, turn, shift = cv2.solvePnP(board, points, matrix, distortion)
            seen = cv2.projectPoints(board, turn, shift, matrix, distortion)[0].reshape(-1, 2)
            squares.append(((seen - points) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))


def _grey8(image: Image) -> UInt8Array:
    return np.rint(np.clip(image.grey(), 0, 255)).astype(np.uint8)


if __name__ == "__main__":
    main()

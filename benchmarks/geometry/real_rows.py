"""Row difference of rectified corners in frames that the calibration has not seen."""

from collections.abc import Callable

import cv2
import numpy as np
from benchmarks.geometry.real_sets import Recorded
from numpy.typing import NDArray

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady, Lens
from calichrome.geometry.rectification import rectify_pair
from calichrome.observations import Dataset

__all__ = ["Pair", "opencv_pair", "row_differences_px"]

Pair = tuple[Lens, Lens, Pose]
"""Lens of a, lens of b, b_from_a."""


def row_differences_px(
    recorded: Recorded, camera_a: str, camera_b: str, calibrate: Callable[[Dataset], Pair]
) -> FloatArray:
    """Leave out one frame after the other and rectify its corners.

    Parameters
    ----------
    recorded
        Views of the cameras.
    camera_a, camera_b
        A horizontal pair.
    calibrate
        From all frames but one.

    Returns
    -------
    (N,) float
        y of a less y of b of all corners of all frames, in pixels of camera a as recorded: times
        its focal length (mean of fx and fy) over that of the rectified picture, which is a choice.
    """
    sizes = recorded.dataset.sizes_wh
    differences = []
    for frame in recorded.dataset.shared_frames(camera_a, camera_b):
        lens_a, lens_b, b_from_a = calibrate(recorded.dataset.without_frames(frozenset([frame])))
        rectified = rectify_pair(lens_a, lens_b, b_from_a, sizes[camera_a], sizes[camera_b])
        _, pixels_a, pixels_b = _shared(recorded.dataset, frame, camera_a, camera_b)
        rows_a = rectified.rectify_points("a", pixels_a)[:, 1]
        rows_b = rectified.rectify_points("b", pixels_b)[:, 1]
        focal_px = float(lens_a.parameters[:2].mean())
        differences.append((rows_a - rows_b) * focal_px / rectified.focal_px)
    return np.concatenate(differences)


def opencv_pair(recorded: Recorded, camera_a: str, camera_b: str, dataset: Dataset) -> Pair:
    """Calibrate both cameras, then all together with the lenses freed, in OpenCV.

    The model is that of `BrownConrady`, all nine numbers; corners without weights.
    """
    points, pixels_a, pixels_b = [], [], []
    for frame in dataset.shared_frames(camera_a, camera_b):
        ids, own_a, own_b = _shared(dataset, frame, camera_a, camera_b)
        points.append(_single(recorded.target.corners_board[ids]))
        pixels_a.append(_single(own_a))
        pixels_b.append(_single(own_b))
    size_wh = dataset.sizes_wh[camera_a]
    starts = [
        cv2.calibrateCamera(points, pixels, size_wh, np.eye(3), np.zeros(5))[1:3]
        for pixels in (pixels_a, pixels_b)
    ]
    (matrix_a, coeffs_a), (matrix_b, coeffs_b) = starts
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
    _, matrix_a, coeffs_a, matrix_b, coeffs_b, rotation, shift, _, _ = cv2.stereoCalibrate(
        points, pixels_a, pixels_b, matrix_a, coeffs_a, matrix_b, coeffs_b, size_wh,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=criteria,
    )  # fmt: skip
    return (
        _lens(matrix_a, coeffs_a),
        _lens(matrix_b, coeffs_b),
        Pose(rotation, shift.ravel()),
    )


def _shared(
    dataset: Dataset, frame: str, camera_a: str, camera_b: str
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Ids and pixels of the corners that both cameras see."""
    view_a, view_b = dataset.views[camera_a][frame], dataset.views[camera_b][frame]
    ids, rows_a, rows_b = np.intersect1d(view_a.corner_ids, view_b.corner_ids, return_indices=True)
    return ids.astype(np.int64), view_a.corners_px[rows_a], view_b.corners_px[rows_b]


def _single(values: FloatArray) -> NDArray[np.float32]:
    return values.astype(np.float32)


def _lens(matrix: FloatArray, coeffs: FloatArray) -> BrownConrady:
    return BrownConrady.from_parameters(
        np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], coeffs.ravel()[:5]])
    )

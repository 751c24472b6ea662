"""Other calibrations behind one face; what cannot run is None, and the tables say "not run".

OpenCV is a dependency of the package. lensboy needs an OpenCV of its own, so it runs in an
environment of its own: ``--lensboy PYTHON`` names its interpreter.
"""

import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations import Dataset
from calichrome.target import Target

__all__ = ["CameraFit", "lensboy_cameras", "opencv_camera", "opencv_multiview"]

_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
"""200 iterations, 1e-12: OpenCV's default stops earlier, away from its minimum."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """A lens, and the sum of squared residuals of its fit, px^2."""

    lens: BrownConrady
    cost_px2: float


def _in_squares(target: Target) -> FloatArray:
    """Corners in units of squares: single precision, which OpenCV takes, holds them exactly."""
    return target.corners_board / [*target.square_m, 1.0]


def opencv_camera(dataset: Dataset, target: Target) -> CameraFit | None:
    """`cv2.calibrateCamera` on a dataset of one camera with square squares."""
    (views,) = dataset.views.values()
    (size_wh,) = dataset.sizes_wh.values()
    corners = _in_squares(target)
    objects = [corners[view.corner_ids].astype(np.float32) for view in views.values()]
    pixels = [view.corners_px.astype(np.float32) for view in views.values()]
    try:
        _, matrix, coefficients, rotvecs, trans = cv2.calibrateCamera(
            objects, pixels, size_wh, None, None, criteria=_STOP
        )
    except cv2.error:
        return None
    lens = _lens(matrix, coefficients)
    cost = 0.0
    for view, rotvec, shift in zip(views.values(), rotvecs, trans, strict=True):
        points_cam = Pose.from_rotvec(rotvec.ravel(), shift.ravel()).apply(corners[view.corner_ids])
        cost += float(((lens.project(points_cam) - view.corners_px) ** 2).sum())
    return CameraFit(lens, cost)


def opencv_multiview(dataset: Dataset, target: Target) -> dict[str, Pose] | None:
    """`cv2.calibrateMultiview`, lenses and poses from nothing: cams_from_ref, ref the first camera.

    None if it gives up or returns numbers that are not finite.
    """
    cameras, frames = list(dataset.views), list(dataset.frames)
    corners = _in_squares(target)
    unseen = np.full((target.n_corners, 2), -1.0, dtype=np.float32)  # its own sign for "not seen"
    pixels = []
    for camera in cameras:
        of_camera = []
        for frame in frames:
            at = unseen.copy()
            view = dataset.views[camera].get(frame)
            if view is not None:
                at[view.corner_ids] = view.corners_px
            of_camera.append(at)
        pixels.append(of_camera)
    mask = np.array(
        [[frame in dataset.views[camera] for frame in frames] for camera in cameras], dtype=np.uint8
    )
    try:
        _, _, _, rotations, trans = cv2.calibrateMultiview(  # type: ignore[call-overload]
            [corners.astype(np.float32)] * len(frames),
            pixels,
            [dataset.sizes_wh[camera] for camera in cameras],
            mask,
            np.full(len(cameras), cv2.CALIB_MODEL_PINHOLE, dtype=np.uint8),
            *([] for _ in range(4)),
            criteria=_STOP,
        )
    except cv2.error:
        return None
    poses = {}
    for camera, turn, shift in zip(cameras, rotations, trans, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            return None
        rotation = cv2.Rodrigues(turn)[0] if np.size(turn) == 3 else np.asarray(turn)
        poses[camera] = Pose(rotation, np.ravel(shift) * target.square_m[0])
    return poses


def lensboy_cameras(
    python: Path | None, datasets: Sequence[Dataset], target: Target
) -> list[BrownConrady | None] | None:
    """Run lensboy as it is set up by default: gate of 5 sigma, five terms of bow.

    Parameters
    ----------
    python
        Interpreter of an environment with lensboy; None: not run.
    datasets
        Of one camera each, all of one picture size and with whole boards.

    Returns
    -------
    list or None
        A lens, or None where it failed, for each; None if lensboy cannot be imported.
    """
    if python is None:
        return None
    (size_wh,) = datasets[0].sizes_wh.values()
    pixels = np.array(
        [
            [view.corners_px for (views,) in [dataset.views.values()] for view in views.values()]
            for dataset in datasets
        ]
    )
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npy"
        np.savez(given, corners=target.corners_board, pixels=pixels, size_wh=size_wh)
        worker = Path(__file__).with_name("lensboy_worker.py")
        command = [str(python), str(worker), str(given), str(made)]
        done = subprocess.run(command, capture_output=True, check=False, text=True)  # noqa: S603
        if done.returncode != 0:
            print(f"lensboy: {done.stderr.strip().splitlines()[-1]}")
            return None
        rows = np.load(made)
    return [BrownConrady.from_parameters(row) if np.isfinite(row).all() else None for row in rows]


def _lens(matrix: FloatArray, coefficients: FloatArray) -> BrownConrady:
    """From OpenCV's matrix and k1 k2 p1 p2 k3."""
    return BrownConrady.from_parameters(
        np.array([*np.diag(matrix)[:2], *matrix[:2, 2], *np.ravel(coefficients)[:5]])
    )

"""Four cameras that converge at 2 m: python -m benchmarks.geometry.converging --seeds 100.

40 frames, 1 % gross errors, nothing known beforehand: rotation and position of three cameras
against the first, held against the Cramér-Rao bound of the geometry and `cv2.calibrateMultiview`.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from benchmarks.geometry import ours
from benchmarks.geometry.bound import (
    N_CAMERA,
    N_LENS,
    View,
    camera_covariance,
    minimise,
    problem_of,
    state_of,
)
from benchmarks.geometry.peers import opencv_multiview
from benchmarks.geometry.rigs import (
    Recording,
    Scene,
    observed,
)
from benchmarks.geometry.scenes import (
    converging,
)
from benchmarks.geometry.tables import Bar, print_bars, print_table

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose

__all__ = ["bound_medians", "main", "pose_errors"]

_BOUND_DRAWS = 20_000
_BOOTSTRAPS = 200
_MEDIAN_SHARE = 1 / 5  # of calibrateMultiview's error


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--geometry", type=int, default=0, help="seed of lenses and poses")
    options = parser.parse_args(argv)
    cv2.setNumThreads(0)
    scene = converging(options.geometry)
    bound = bound_medians(scene)
    mine, others, without, known, cpu_s = [], [], [], [], np.zeros(3)
    for seed in range(options.seeds):
        draw = [options.geometry, seed]
        recording = observed(scene, draw, gross_share=0.01)
        dirty = recording.dataset
        clean = observed(scene, draw).dataset
        times = [time.process_time()]
        solved = ours.solve(dirty, scene.target)
        times.append(time.process_time())
        multiview = opencv_multiview(dirty, scene.target)
        times.append(time.process_time())
        multiview_clean = opencv_multiview(clean, scene.target)
        times.append(time.process_time())
        cpu_s += np.diff(times)
        mine.append(pose_errors(scene, solved.cams_from_ref))
        others.append(pose_errors(scene, multiview))
        without.append(pose_errors(scene, multiview_clean))
        known.append(pose_errors(scene, _knowing(scene, recording)))
        if (seed + 1) % 20 == 0:
            print(f"{seed + 1} seeds", flush=True)
    cpu_s /= options.seeds
    medians = {
        "calichrome": _medians(mine),
        "calibrateMultiview": _medians(others),
        "calibrateMultiview without gross errors": _medians(without),
        "least squares from the truth, flat board, without the gross errors": _medians(known),
        "Cramér-Rao bound": bound,
    }
    times_of = dict(zip(medians, [*(f"{value:.2f}" for value in cpu_s), "", ""], strict=True))
    print_table(
        ("solver", "median rotation error, deg", "median position error, mm", "CPU s"),
        [
            (name, f"{np.degrees(value[0]):.4f}", f"{1e3 * value[1]:.3f}", times_of[name])
            for name, value in medians.items()
        ],
    )
    _print_bars(medians["calichrome"], _spread(mine), medians["calibrateMultiview"], bound)


def _print_bars(mine: FloatArray, spread: FloatArray, other: FloatArray, bound: FloatArray) -> None:
    bars = []
    for index, name in enumerate(("rotation", "position")):
        ratio = float(mine[index] / bound[index])
        bars.append(
            Bar(
                f"median {name} error over the bound's",
                ratio,
                high=1.1,
                sigma=float(spread[index] / bound[index]),
            )
        )
        share = float(mine[index] / other[index])
        bars.append(Bar(f"median {name} error over OpenCV's", share, high=_MEDIAN_SHARE))
    print_bars(bars)


def _knowing(scene: Scene, recording: Recording) -> Mapping[str, Pose]:
    """Solve as one who knows which corners are gross errors; its errors show what chance did."""
    views = {
        (camera, frame): View(view.corner_ids[good], view.corners_px[good])
        for camera, seen in recording.dataset.views.items()
        for frame, view in seen.items()
        for good in [~recording.gross[camera, frame]]
    }
    problem = replace(problem_of(scene), views=views)
    return minimise(problem, state_of(scene))[0].cams_from_ref


def pose_errors(scene: Scene, cams_from_ref: Mapping[str, Pose] | None) -> FloatArray:
    """Return angle (rad) and distance (m) by which each other camera is off, (C - 1, 2).

    inf where there is no answer.
    """
    cameras = list(scene.lenses)[1:]
    if cams_from_ref is None:
        return np.full((len(cameras), 2), np.inf)
    errors = []
    for camera in cameras:
        true, found = scene.cams_from_ref[camera].inverse(), cams_from_ref[camera].inverse()
        turn = Pose(found.rotation @ true.rotation.T, np.zeros(3)).rotvec_rad
        errors.append((np.linalg.norm(turn), np.linalg.norm(found.trans_m - true.trans_m)))
    return np.array(errors)


def bound_medians(scene: Scene) -> FloatArray:
    """Medians over all cameras of `pose_errors` drawn from the Cramér-Rao bound, (2,)."""
    covariance = camera_covariance(scene)
    rng = np.random.default_rng(0)
    errors = []
    for index, camera in enumerate(scene.lenses):
        if camera == scene.reference:
            continue
        columns = slice(N_CAMERA * index + N_LENS, N_CAMERA * (index + 1))
        drawn = rng.multivariate_normal(np.zeros(6), covariance[columns, columns], _BOUND_DRAWS)
        omega, tau = drawn[:, :3], drawn[:, 3:]
        # the centre -R' t moves by R' (omega x t - tau)
        moved = np.cross(omega, scene.cams_from_ref[camera].trans_m) - tau
        errors.append(np.stack([np.linalg.norm(omega, axis=1), np.linalg.norm(moved, axis=1)], 1))
    return np.asarray(np.median(np.concatenate(errors), axis=0))


def _medians(errors: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(np.median(np.concatenate(errors), axis=0))


def _spread(errors: Sequence[FloatArray]) -> FloatArray:
    """Return the standard error of the medians over the seeds, by bootstrap."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(errors), size=(_BOOTSTRAPS, len(errors)))
    medians = [_medians([errors[index] for index in row]) for row in drawn]
    return np.asarray(np.std(medians, axis=0))


if __name__ == "__main__":
    main()

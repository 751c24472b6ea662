"""mrcal on a problem, in an interpreter that has it: `python -m benchmarks.solver.mrcal_peer`.

The same free parameters as ours: LENSMODEL_OPENCV5, all camera poses but the reference, all board
poses. Regularisation, rejection of outliers and warp of the board are off.
"""

import ctypes
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import mrcal  # type: ignore[import-not-found]  # no package of this environment
import numpy as np
from benchmarks.solver.exchange import (
    WARM_UPS,
    FloatArray,
    Problem,
    Solution,
    engine_arguments,
    measured,
)


def main() -> None:
    """Solve a small problem, so that first calls cost nothing, then the problem."""
    task = engine_arguments()
    for _ in range(WARM_UPS):
        warm_up = _inputs(task.warm_up)
        mrcal.optimize(**warm_up)
        _covariance(warm_up)
    inputs = _inputs(task.problem)
    stats, meter = measured(lambda: mrcal.optimize(**inputs))
    cost = _cost(stats)
    polished_cost = _cost(mrcal.optimize(**inputs))
    covariance, covariance_cpu_s, iterations = np.empty((0, 0)), np.nan, np.nan
    if task.with_details:
        iterations = _count_iterations(task.problem)
        covariance, covariance_meter = measured(lambda: _covariance(inputs))
        covariance_cpu_s = covariance_meter.cpu_s
    cam_from_ref = mrcal.Rt_from_rt(inputs["rt_cam_ref"])
    Solution(
        cost=cost,
        polished_cost=polished_cost,
        iterations=iterations,
        cpu_s=meter.cpu_s,
        growth_mb=meter.growth_mb,
        covariance_cpu_s=covariance_cpu_s,
        covariance=covariance,
        lens=inputs["intrinsics"],
        cam_from_ref_rotation=np.concatenate([np.eye(3)[None], cam_from_ref[:, :3]]),
        cam_from_ref_m=np.concatenate([np.zeros((1, 3)), cam_from_ref[:, 3]]),
    ).save(task.solution_path)


def _inputs(problem: Problem) -> dict[str, Any]:
    """Say a problem, at its start, in mrcal's words."""
    nx, ny = problem.corners_xy
    spacing_m = float(problem.board_m[1, 0])
    grid = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2) * spacing_m
    if not np.allclose(problem.board_m[:, :2], grid) or problem.board_m[:, 2].any():
        raise ValueError("board_m: mrcal takes flat boards of square fields only")
    observations = np.ones((len(problem.pixels), ny, nx, 3))
    observations[..., :2] = problem.pixels.reshape(-1, ny, nx, 2)
    indices = [problem.frame_index, problem.camera_index, problem.camera_index - 1]
    start = problem.start
    return {
        "lensmodel": "LENSMODEL_OPENCV5",
        "intrinsics": start.lens.copy(),
        "rt_cam_ref": _rt(start.cam_from_ref_rotation[1:], start.cam_from_ref_m[1:]),
        "rt_ref_frame": _rt(start.ref_from_board_rotation, start.ref_from_board_m),
        "observations_board": observations,
        "indices_frame_camintrinsics_camextrinsics": np.stack(indices, axis=1).astype(np.int32),
        "imagersizes": np.tile(problem.size_wh, (len(start.lens), 1)).astype(np.int32),
        "calibration_object_spacing": spacing_m,
        "do_optimize_calobject_warp": False,
        "do_apply_regularization": False,
        "do_apply_outlier_rejection": False,
    }


def _rt(rotation: FloatArray, trans_m: FloatArray) -> FloatArray:
    """Return rotation vectors and translations, (N, 6)."""
    rt = mrcal.rt_from_Rt(np.concatenate([rotation, trans_m[:, None]], axis=1))
    back = mrcal.Rt_from_rt(rt)[:, :3]
    if not np.allclose(back, rotation, rtol=0, atol=1e-12):  # 100x what was seen near half turns
        raise ValueError("rotation: lost accuracy on its way to a rotation vector")
    return np.asarray(rt)


def _cost(stats: dict[str, Any]) -> float:
    return float(0.5 * np.vdot(stats["x"], stats["x"]))


def _covariance(inputs: dict[str, Any]) -> FloatArray:
    """Invert the normal equations for the rows of the camera parameters.

    mrcal solves for scaled parameters; with their scales s, cov = s (J'J)^-1 s. Its rotation
    vectors r become the turns omega of our convention by the left Jacobian of SO(3) [1]_.

    References
    ----------
    .. [1] J. Solà, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
       2018, eq. (145).
    """
    packed, _, _, factorization = mrcal.optimizer_callback(**inputs, no_jacobian=True)
    n_lens, n_rt = inputs["intrinsics"].size, inputs["rt_cam_ref"].size
    scale = np.ones_like(packed)
    mrcal.unpack_state(scale, **inputs)
    rows = np.zeros((n_lens + n_rt, len(packed)))
    np.fill_diagonal(rows, scale)
    covariance = factorization.solve_xt_JtJ_bt(rows)[:, : n_lens + n_rt] * scale[: n_lens + n_rt]
    for k, rotvec in enumerate(inputs["rt_cam_ref"][:, :3]):
        first = n_lens + 6 * k
        turn = _left_jacobian(rotvec)
        covariance[first : first + 3] = turn @ covariance[first : first + 3]
        covariance[:, first : first + 3] = covariance[:, first : first + 3] @ turn.T
    return np.asarray(covariance)


def _left_jacobian(rotvec: FloatArray) -> FloatArray:
    """Return J with exp(r + dr) = exp(J dr) exp(r) to first order, (3, 3)."""
    angle = float(np.linalg.norm(rotvec))
    if angle < 1e-4:  # the next term is below 1e-8
        return np.eye(3) + _cross(rotvec) / 2
    axis = _cross(rotvec / angle)
    one_minus_cos = 2 * np.sin(angle / 2) ** 2
    return np.asarray(
        np.eye(3) + one_minus_cos / angle * axis + (1 - np.sin(angle) / angle) * axis @ axis
    )


def _cross(vector: FloatArray) -> FloatArray:
    """Return [v]x, (3, 3)."""
    return np.asarray(np.cross(np.eye(3), vector))


def _count_iterations(problem: Problem) -> float:
    """Count accepted steps; only the log of another solve tells."""
    flush = ctypes.CDLL(None).fflush
    inputs = _inputs(problem)
    with tempfile.TemporaryFile("w+") as log, Path(os.devnull).open("w") as nowhere:
        own = {stream: os.dup(stream) for stream in (1, 2)}
        os.dup2(log.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)  # every residual
        try:
            mrcal.optimize(**inputs, verbose=True)
            flush(None)
        finally:
            for stream, copy in own.items():
                os.dup2(copy, stream)
        log.seek(0)
        # step number, accepted, norm2 before and after: "-" where no step was tried
        return float(sum(bool(re.match(r"\d+ 1 \S+ [^-\s]", line)) for line in log))


if __name__ == "__main__":
    main()

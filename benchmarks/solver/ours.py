"""calichrome's joint solve on a problem: `python -m benchmarks.solver.ours`."""

import numpy as np
from benchmarks.solver.exchange import WARM_UPS, Problem, Solution, engine_arguments, measured

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.geometry.bundle import (
    BoardShape,
    BundleResult,
    BundleState,
    Free,
    Observations,
    ObservedView,
    solve_bundle,
)
from calichrome.geometry.bundle.robust import solve_robust
from calichrome.geometry.lenses import BrownConrady

_BOW_TERMS = 5
_OUTLIERS = 0.01
_OUTLIER_PX = (3.0, 20.0)
_EXTRA_NOISE = 1.0  # of the problem's own, as the typical size of what each corner has on top


def main() -> None:
    """Solve a small problem, so that first calls cost nothing, then the problem."""
    task = engine_arguments()
    if task.robust:
        for _ in range(WARM_UPS):
            _robust(task.warm_up, *_spoiled(task.warm_up))
        pixels, whitening = _spoiled(task.problem)
        result, meter = measured(lambda: _robust(task.problem, pixels, whitening))
    else:
        for _ in range(WARM_UPS):
            _covariance(_plain(task.warm_up))
        result, meter = measured(lambda: _plain(task.problem))
    covariance, covariance_cpu_s = np.empty((0, 0)), np.nan
    if task.with_details:
        covariance, covariance_meter = measured(lambda: _covariance(result))
        covariance_cpu_s = covariance_meter.cpu_s
    Solution(
        cost=result.cost,
        polished_cost=result.cost if task.robust else _plain(task.problem, result.state).cost,
        iterations=result.n_iterations,
        cpu_s=meter.cpu_s,
        growth_mb=meter.growth_mb,
        covariance_cpu_s=covariance_cpu_s,
        covariance=covariance,
        lens=result.state.lens_parameters,
        cam_from_ref_rotation=result.state.cam_rotations,
        cam_from_ref_m=result.state.cam_trans_m,
    ).save(task.solution_path)


def _plain(problem: Problem, start: BundleState | None = None) -> BundleResult:
    """Pack and solve: equal weights, flat board."""
    state = start or _start(problem, BoardShape.flat(problem.board_m))
    return solve_bundle(_packed(problem, problem.pixels), state, Free.everything(state))


def _robust(problem: Problem, pixels: FloatArray, whitening: FloatArray) -> BundleResult:
    """Pack and solve: a covariance for each corner, outliers, bow."""
    state = _start(problem, BoardShape.bowed(problem.board_m, _BOW_TERMS))
    observations = _packed(problem, pixels, whitening)
    return solve_robust(observations, state, Free.everything(state)).result


def _spoiled(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Give each corner its own noise and covariance, and some an error, (V, N, 2), (V, N, 2, 2)."""
    rng = np.random.default_rng(2)
    shape = problem.pixels.shape
    spread = _EXTRA_NOISE * problem.sigma_px * rng.normal(0.0, 0.5, (*shape, 2))
    pixels = problem.pixels + (spread @ rng.normal(size=(*shape, 1)))[..., 0]
    covariance = spread @ spread.swapaxes(-1, -2) + problem.sigma_px**2 * np.eye(2)
    is_outlier = rng.uniform(size=shape[:2]) < _OUTLIERS
    length_px = rng.uniform(*_OUTLIER_PX, is_outlier.sum())
    angle_rad = rng.uniform(0.0, 2 * np.pi, len(length_px))
    pixels[is_outlier] += length_px[:, None] * np.stack([np.cos(angle_rad), np.sin(angle_rad)], 1)
    return pixels, np.linalg.inv(np.linalg.cholesky(covariance))


def _start(problem: Problem, shape: BoardShape) -> BundleState:
    start = problem.start
    return BundleState(
        models=(BrownConrady,) * len(start.lens),
        lens_parameters=start.lens,
        cam_rotations=start.cam_from_ref_rotation,
        cam_trans_m=start.cam_from_ref_m,
        board_rotations=start.ref_from_board_rotation,
        board_trans_m=start.ref_from_board_m,
        shape=shape,
        shape_parameters=np.zeros(len(shape)),
    )


def _packed(
    problem: Problem, pixels: FloatArray, whitening: FloatArray | None = None
) -> Observations:
    ids: IntArray = np.arange(len(problem.board_m))
    views = [
        ObservedView(
            int(camera), int(frame), ids, pixels[row], None if whitening is None else whitening[row]
        )
        for row, (camera, frame) in enumerate(
            zip(problem.camera_index, problem.frame_index, strict=True)
        )
    ]
    n_cameras, n_frames = len(problem.start.lens), len(problem.start.ref_from_board_m)
    return Observations.pack(views, problem.board_m, (BrownConrady,) * n_cameras, n_frames)


def _covariance(result: BundleResult) -> FloatArray:
    """Joint covariance of the cameras in the order of `Solution`: lenses, then poses."""
    covariance = result.equations.covariance()
    if covariance is None:
        raise ValueError("covariance: the data leave a direction open")
    n_cameras, n_lens = result.state.lens_parameters.shape
    places = np.arange(n_cameras * (n_lens + 6)).reshape(n_cameras, n_lens + 6)
    order = np.concatenate([places[:, :n_lens].ravel(), places[1:, n_lens:].ravel()])
    return np.asarray(covariance[np.ix_(order, order)])


if __name__ == "__main__":
    main()

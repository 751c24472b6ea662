"""The joint least-squares problem once more, written apart from the package's solver.

One dense Jacobian a frame, the board's pose eliminated by a QR of its six columns: slow and short.
At the truth it gives the Cramér-Rao bound of every camera parameter; minimised from the truth it
is the reference that a blind solve has to reach.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.geometry.rigs import (
    SIGMA_PX,
    Scene,
)

from calichrome.core.arrays import BoolArray, FloatArray, IntArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.lenses import BrownConrady

__all__ = [
    "Problem",
    "State",
    "View",
    "camera_covariance",
    "cost_of",
    "minimise",
    "problem_of",
    "state_of",
]

N_LENS = len(BrownConrady.NAMES)
N_CAMERA = N_LENS + 6
_MAX_STEPS = 200
_SMALL_DECREASE = 1e-13  # of the cost: what rounding leaves

_ViewKey = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Corners that count: which, and where they were seen, (N,) and (N, 2) pixels."""

    corner_ids: IntArray
    pixels: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """All unknowns; boards by place, `bow` (S,) multiplies `Problem.basis`."""

    lenses: Mapping[str, BrownConrady]
    cams_from_ref: Mapping[str, Pose]
    ref_from_boards: Mapping[str, Pose]
    bow: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """What counts and what is free.

    Parameters
    ----------
    corners_board : (n, 3) float, metres
    basis : (S, 3, n) float
        How the bow moves the corners.
    views
        (camera, place) -> view; a place of the board, mostly a frame, is shared by cameras.
    weights
        camera -> by what its residuals are multiplied.
    free : (15 C + S,) bool
        Of each camera lens, then omega, tau; then the bow. Boards are always free.
    """

    corners_board: FloatArray
    basis: FloatArray
    views: Mapping[_ViewKey, View]
    weights: Mapping[str, float]
    free: BoolArray


def state_of(scene: Scene, n_bow: int = 0) -> State:
    """Return the truth of a board whose bow is not described by `n_bow` parameters."""
    return State(
        lenses=scene.lenses,
        cams_from_ref=scene.cams_from_ref,
        ref_from_boards=scene.ref_from_boards,
        bow=np.zeros(n_bow),
    )


def problem_of(scene: Scene, basis: FloatArray | None = None) -> Problem:
    """Return the scene's own problem without noise: everything free but the reference's pose."""
    ids = np.arange(scene.target.n_corners)
    basis = np.zeros((0, 3, len(ids))) if basis is None else basis
    free = np.ones(N_CAMERA * len(scene.lenses) + len(basis), dtype=bool)
    free[N_LENS:N_CAMERA] = False
    return Problem(
        corners_board=scene.corners_board,
        basis=basis,
        views={
            (camera, frame): View(ids, scene.exact_px(camera, frame))
            for camera, frames in scene.seen.items()
            for frame in frames
        },
        weights=dict.fromkeys(scene.lenses, 1.0),
        free=free,
    )


def camera_covariance(
    scene: Scene, basis: FloatArray | None = None, *, sigma_px: float = SIGMA_PX
) -> FloatArray:
    """Cramér-Rao bound of lenses, poses and bow, (15 C + S, 15 C + S); 0 where nothing is free.

    Pose columns are (omega, tau) as `Pose` defines them.
    """
    problem = problem_of(scene, basis)
    reduced, _, _ = _normal(problem, state_of(scene, len(problem.basis)))
    return _embedded(_inverse(reduced[np.ix_(problem.free, problem.free)]), problem.free, sigma_px)


def minimise(problem: Problem, start: State) -> tuple[State, float]:
    """Levenberg-Marquardt; return the state of least cost and that cost.

    Frames and cameras without a view stay where they are.
    """
    state, damping = start, 1e-6
    cost = cost_of(problem, state)
    for _ in range(_MAX_STEPS):
        reduced, gradient, boards = _normal(problem, state)
        free = problem.free & (np.diag(reduced) > 0)
        scale = np.sqrt(np.diag(reduced)[free])
        matrix = reduced[np.ix_(free, free)] / np.outer(scale, scale)
        decrease = 0.0
        while damping < 1e8:
            step = np.zeros(len(free))
            damped = matrix + damping * np.eye(len(matrix))
            step[free] = np.linalg.solve(damped, gradient[free] / scale) / scale
            trial = _moved(state, step, boards)
            trial_cost = cost_of(problem, trial)
            if trial_cost <= cost:
                decrease = cost - trial_cost
                state, cost, damping = trial, trial_cost, max(damping / 10, 1e-14)
                break
            damping *= 10
        if decrease <= _SMALL_DECREASE * cost:
            return state, cost
    return state, cost


_Boards = dict[str, tuple[FloatArray, FloatArray]]
"""frame -> offset (6,) and matrix (6, 15 C + S): its step is offset - matrix @ camera step."""


def _points(problem: Problem, state: State, key: _ViewKey) -> tuple[FloatArray, FloatArray]:
    """Return the corners of a view on the bent board and in ref, (N, 3)."""
    ids = problem.views[key].corner_ids
    bow = np.tensordot(state.bow, problem.basis[:, :, ids], axes=1)
    corners = problem.corners_board[ids] + bow.T
    return corners, state.ref_from_boards[key[1]].apply(corners)


def cost_of(problem: Problem, state: State) -> float:
    """Sum of squared weighted residuals; inf behind a camera."""
    total = 0.0
    for key, view in problem.views.items():
        _, points_ref = _points(problem, state, key)
        points_cam = state.cams_from_ref[key[0]].apply(points_ref)
        residual = state.lenses[key[0]].project(points_cam) - view.pixels
        total += problem.weights[key[0]] ** 2 * float((residual**2).sum())
    return total if np.isfinite(total) else np.inf


def _view_jacobian(
    problem: Problem, state: State, key: _ViewKey
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return residuals (2N,) and their derivatives by camera (15), board (6) and bow (S)."""
    camera, frame = key
    weight = problem.weights[camera]
    cam_from_ref, ref_from_board = state.cams_from_ref[camera], state.ref_from_boards[frame]
    corners, points_ref = _points(problem, state, key)
    lens = state.lenses[camera]
    pixels, d_lens, d_point = lens.project_with_jacobians(cam_from_ref.apply(points_ref))
    d_turned = d_point @ cam_from_ref.rotation
    by_cam = -d_point @ cross_matrix(points_ref @ cam_from_ref.rotation.T)
    by_board = -d_turned @ cross_matrix(corners @ ref_from_board.rotation.T)
    moves = problem.basis[:, :, problem.views[key].corner_ids]
    by_bow = np.einsum("nij,jk,skn->nis", d_turned, ref_from_board.rotation, moves)
    rows = 2 * len(pixels)
    return (
        weight * (pixels - problem.views[key].pixels).ravel(),
        weight * np.concatenate([d_lens, by_cam, d_point], axis=2).reshape(rows, N_CAMERA),
        weight * np.concatenate([by_board, d_turned], axis=2).reshape(rows, 6),
        weight * by_bow.reshape(rows, -1),
    )


def _normal(problem: Problem, state: State) -> tuple[FloatArray, FloatArray, _Boards]:
    """Return J'J and -J'r of the camera side with the boards eliminated, and how boards follow."""
    cameras = list(state.lenses)
    n_columns = N_CAMERA * len(cameras) + len(problem.basis)
    reduced, gradient = np.zeros((n_columns, n_columns)), np.zeros(n_columns)
    boards: _Boards = {}
    frames = dict.fromkeys(frame for _, frame in problem.views)
    for frame in frames:
        keys = [(camera, frame) for camera in cameras if (camera, frame) in problem.views]
        parts = [_view_jacobian(problem, state, key) for key in keys]
        residual = np.concatenate([part[0] for part in parts])
        jacobian = np.zeros((len(residual), n_columns))
        row = 0
        for (camera, _), part in zip(keys, parts, strict=True):
            rows, column = slice(row, row + len(part[0])), N_CAMERA * cameras.index(camera)
            jacobian[rows, column : column + N_CAMERA] = part[1]
            jacobian[rows, N_CAMERA * len(cameras) :] = part[3]
            row = rows.stop
        orthogonal, triangle = np.linalg.qr(np.concatenate([part[2] for part in parts]))
        inside_jacobian, inside_residual = orthogonal.T @ jacobian, orthogonal.T @ residual
        reduced += jacobian.T @ jacobian - inside_jacobian.T @ inside_jacobian
        gradient -= jacobian.T @ residual - inside_jacobian.T @ inside_residual
        boards[frame] = (
            -np.linalg.solve(triangle, inside_residual),
            np.linalg.solve(triangle, inside_jacobian),
        )
    return reduced, gradient, boards


def _moved(state: State, step: FloatArray, boards: _Boards) -> State:
    cameras = list(state.lenses)
    by_camera = step[: N_CAMERA * len(cameras)].reshape(-1, N_CAMERA)
    lenses, cams = {}, {}
    for camera, own in zip(cameras, by_camera, strict=True):
        lens = state.lenses[camera]
        lenses[camera] = type(lens).from_parameters(lens.parameters + own[:N_LENS])
        cams[camera] = state.cams_from_ref[camera].perturbed(own[N_LENS:])
    moved = dict(state.ref_from_boards)
    for frame, (offset, matrix) in boards.items():
        moved[frame] = moved[frame].perturbed(offset - matrix @ step)
    return replace(
        state,
        lenses=lenses,
        cams_from_ref=cams,
        ref_from_boards=moved,
        bow=state.bow + step[N_CAMERA * len(cameras) :],
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    """Invert after scaling to a unit diagonal: raw condition numbers are 1e8 to 1e11."""
    scale = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale))


def _embedded(covariance: FloatArray, free: BoolArray, sigma_px: float) -> FloatArray:
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = covariance * sigma_px**2
    return whole

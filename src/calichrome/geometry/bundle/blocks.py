"""One small Hessian a view.

With the pose of the *view* perturbed on the left, a corner has P lens columns, six of pose and S of
the board's shape; the derivatives by camera pose and board pose follow from the six of the view by
the adjoint, once a view instead of once a corner. No Jacobian outlives its chunk.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.geometry.bundle.observations import Chunk, Observations
from calichrome.geometry.bundle.state import BundleState

__all__ = ["ViewBlocks", "chunk_residuals", "residual_cost", "view_blocks", "whiten"]


@dataclass(frozen=True, slots=True, eq=False)
class ViewBlocks:
    """J'J of every view, residual last.

    Parameters
    ----------
    products : (V, K + 1, K + 1) float
        K = P + 6 + S columns: lens, pose of the view (omega, tau), shape; then the residuals, so
        that the last column is J'r.
    cost : float
        Half the sum of (robust) squares.
    """

    products: FloatArray
    cost: float


def view_blocks(
    observations: Observations, state: BundleState, huber: float | None = None
) -> ViewBlocks:
    """Linearise all views.

    Parameters
    ----------
    observations, state
        What was seen, and where things are thought to be.
    huber
        Whitened 2-D residual from which the cost grows linearly; None: nowhere.

    References
    ----------
    .. [1] P. J. Huber, "Robust Estimation of a Location Parameter", Ann. Math. Stat. 35 (1), 1964.
    """
    n_lens, n_shape = state.lens_parameters.shape[1], len(state.shape)
    n_columns = n_lens + 6 + n_shape
    products = np.zeros((len(observations.camera), n_columns + 1, n_columns + 1))
    points_board = state.shape.displaced(observations.points_board, state.shape_parameters).T
    cost = 0.0
    scratch = np.empty(0)
    for chunk in observations.chunks:
        n_own = len(chunk.model.NAMES)
        n_rows, n_points = chunk.corner_ids.shape
        shape = n_rows, n_own + 6 + n_shape + 1, 2, n_points
        if scratch.size < np.prod(shape):
            scratch = np.empty(np.prod(shape))
        jacobian = scratch[: np.prod(shape)].reshape(shape)
        cost += _fill(jacobian, chunk, observations, state, points_board, huber)
        flat = jacobian.reshape(n_rows, shape[1], 2 * n_points)
        product = flat @ flat.transpose(0, 2, 1)
        if n_own == n_lens:
            products[chunk.views] = product
        else:  # a shorter lens: its columns stand where those of the longest do
            places = np.r_[0:n_own, n_lens : n_columns + 1]
            products[np.ix_(chunk.views, places, places)] = product
    return ViewBlocks(products, cost)


def chunk_residuals(observations: Observations, state: BundleState) -> list[FloatArray]:
    """Projected minus observed, (V, 2, N), pixels, not whitened, by chunk."""
    points_board = state.shape.displaced(observations.points_board, state.shape_parameters).T
    parts = []
    for chunk in observations.chunks:
        parameters, points, _ = _points(chunk, observations, state, points_board)
        parts.append(chunk.model.project_views(parameters, points) - chunk.pixels)
    return parts


def residual_cost(
    observations: Observations, residuals: Sequence[FloatArray], huber: float | None = None
) -> float:
    """Half the sum of (robust) squares of what `chunk_residuals` returned."""
    return sum(
        _weights(rows, chunk.whitening, huber)[0]
        for chunk, rows in zip(observations.chunks, residuals, strict=True)
    )


def _points(
    chunk: Chunk, observations: Observations, state: BundleState, points_board: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lens parameters (V, P), points in the camera (V, 3, N), rotations of the views."""
    camera, frame = observations.camera[chunk.views], observations.frame[chunk.views]
    cam_rotations = state.cam_rotations[camera]
    rotations = cam_rotations @ state.board_rotations[frame]
    trans_m = (cam_rotations @ state.board_trans_m[frame, :, None])[..., 0]
    trans_m += state.cam_trans_m[camera]
    points = np.empty((len(chunk.views), 3, chunk.corner_ids.shape[1]))
    for axis in range(3):
        np.take(points_board[axis], chunk.corner_ids, out=points[:, axis], mode="clip")
    points = rotations @ points
    points += trans_m[:, :, None]
    return state.lens_parameters[camera, : len(chunk.model.NAMES)], points, rotations


def _fill(
    jacobian: FloatArray,
    chunk: Chunk,
    observations: Observations,
    state: BundleState,
    points_board: FloatArray,
    huber: float | None,
) -> float:
    """Write all whitened columns of a chunk, (V, K + 1, 2, N), and return its cost.

    Lens, point and residual are whitened; turns and shape are sums of what is by the point.
    """
    n_own, n_shape = len(chunk.model.NAMES), len(state.shape)
    parameters, points, rotations = _points(chunk, observations, state, points_board)
    by_lens, by_point = jacobian[:, :n_own], jacobian[:, n_own + 3 : n_own + 6]
    pixels = chunk.model.project_block(parameters, points, by_lens, by_point)
    residuals = jacobian[:, -1]
    np.subtract(pixels, chunk.pixels, out=residuals)
    cost, weights = _weights(residuals, chunk.whitening, huber)
    if weights is not None:
        _whiten_in_place((by_lens, by_point, jacobian[:, -1:]), weights)
    turn = jacobian[:, n_own : n_own + 3]  # d pixel / d omega = point x (d pixel / d point)
    for row, (b, c) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(points[:, b, None], by_point[:, c], out=turn[:, row])
        turn[:, row] -= points[:, c, None] * by_point[:, b]
    if n_shape:
        _fill_shape(jacobian[:, n_own + 6 : n_own + 6 + n_shape], by_point, rotations, chunk, state)
    return cost


def _fill_shape(
    columns: FloatArray,
    by_point: FloatArray,
    rotations: FloatArray,
    chunk: Chunk,
    state: BundleState,
) -> None:
    columns[:] = 0
    n_rows, _, _, n_points = by_point.shape
    flat = by_point.reshape(n_rows, 3, 2 * n_points)
    for axis in range(3):
        moved = np.flatnonzero(state.shape.basis[:, axis].any(axis=1))
        if len(moved):
            along = (rotations[:, None, :, axis] @ flat).reshape(n_rows, 2, n_points)
            heights = np.take(state.shape.basis[moved, axis], chunk.corner_ids, axis=1)
            for term, height in zip(moved, heights, strict=True):
                columns[:, term] += along * height[:, None]


def _weights(
    residuals: FloatArray, whitening: FloatArray | None, huber: float | None
) -> tuple[float, FloatArray | None]:
    """Return the cost, and what all columns are to be multiplied by, (V, 2, 2, N) or None."""
    whitened = residuals if whitening is None else whiten(whitening, residuals)
    if huber is None:
        return 0.5 * float(np.vdot(whitened, whitened)), whitening
    length = np.hypot(whitened[:, 0], whitened[:, 1])
    far = length > huber
    cost = float(np.where(far, huber * (length - 0.5 * huber), 0.5 * length**2).sum())
    root = np.sqrt(np.where(far, huber / np.maximum(length, huber), 1.0))
    return cost, root[:, None, None] * (np.eye(2)[:, :, None] if whitening is None else whitening)


def _whiten_in_place(parts: Sequence[FloatArray], w: FloatArray) -> None:
    """Apply weights (V, 2, 2, N) to columns (V, k, 2, N); triangular ones in fewer passes."""
    has_above, has_below = w[:, 0, 1].any(), w[:, 1, 0].any()
    for columns in parts:
        u, v = columns[:, :, 0], columns[:, :, 1]
        above = w[:, None, 0, 1] * v if has_above else None
        v *= w[:, None, 1, 1]
        if has_below:
            v += w[:, None, 1, 0] * u
        u *= w[:, None, 0, 0]
        if above is not None:
            u += above


def whiten(whitening: FloatArray, residuals: FloatArray) -> FloatArray:
    """Apply (V, 2, 2, N) to (V, 2, N)."""
    return np.asarray(whitening[:, :, 0] * residuals[:, :1] + whitening[:, :, 1] * residuals[:, 1:])

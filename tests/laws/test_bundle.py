"""Blocks, steps and covariances of a bundle are those of the dense problem."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose, cross_matrix
from calichrome.geometry.bundle import (
    BoardShape,
    BundleEquations,
    BundleState,
    Free,
    Observations,
    ObservedView,
    Priors,
)
from calichrome.geometry.bundle.blocks import view_blocks
from calichrome.geometry.lenses import LENSES, Lens

_SIZE_WH = (640, 480)
_FOCAL_PX = 330.0  # 88 degrees wide: the lens parameters tell in the picture
_GRID = np.stack([*map(np.ravel, np.meshgrid(np.arange(6.0), np.arange(5.0))), np.zeros(30)], 1)
_BOARD = _GRID * [0.04, 0.04, 1.0]
_MODELS = tuple(LENSES.values())
_SEEN = {
    "by most": [(0, 0), (1, 0), (2, 0), (0, 1), (2, 1), (1, 2), (0, 3), (1, 3), (1, 4), (2, 4)],
    "by few": [((frame + k) % 7, frame) for frame in range(14) for k in (0, 1)],
    "by one": [(0, frame) for frame in range(6)],
}
"""(camera, frame)."""


def _state(
    rng: np.random.Generator, n_frames: int, models: tuple[type[Lens], ...] = _MODELS
) -> BundleState:
    """A rig whose cameras stand side by side before a board that fills much of each picture."""
    lenses = []
    for model in models:
        parameters = model.start(_SIZE_WH, _FOCAL_PX).parameters
        parameters[:4] *= rng.uniform(0.97, 1.03, 4)
        parameters[4:] = rng.normal(0, 0.01, len(parameters) - 4)
        lenses.append(model.from_parameters(parameters))
    cams_from_ref = [
        Pose.from_rotvec(rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.04, 0.04, 3)) for _ in models
    ]
    cams_from_ref[0] = Pose.identity()
    boards = []
    for _ in range(n_frames):
        turn = Pose.from_rotvec(rng.uniform(-0.6, 0.6, 3), np.zeros(3))
        middle = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.18, 0.3)])
        boards.append(Pose(turn.rotation, middle - turn.apply(_BOARD.mean(axis=0))))
    shape = BoardShape.bowed(_BOARD, 2, aspect=True)
    return BundleState.build(lenses, cams_from_ref, boards, shape, rng.normal(0, 1e-3, 4))


def _projected(state: BundleState, camera: int, frame: int) -> FloatArray:
    """Pixels (n, 2) of the whole board, by way of the public value types only."""
    cam_from_board = state.cams_from_ref[camera] @ state.ref_from_boards[frame]
    points_board = _BOARD + np.tensordot(state.shape_parameters, state.shape.basis, axes=1).T
    return state.lenses[camera].project(cam_from_board.apply(points_board))


def _views(
    state: BundleState,
    rng: np.random.Generator,
    *,
    noise_px: float = 0.5,
    whiten: bool = True,
    pairs: Sequence[tuple[int, int]] | None = None,
) -> list[ObservedView]:
    """Views in no order, of unequal length; their corners are unequally sure and correlated."""
    n_cameras, n_frames = len(state.models), len(state.board_trans_m)
    pairs = pairs or [(camera, frame) for camera in range(n_cameras) for frame in range(n_frames)]
    views = []
    for camera, frame in rng.permutation(pairs):
        ids = np.sort(rng.permutation(len(_BOARD))[: rng.integers(15, 31)])
        pixels = _projected(state, camera, frame)[ids]
        pixels += rng.normal(0, noise_px, pixels.shape)
        whitening = rng.normal(0, 1, (len(ids), 2, 2)) + 2 * np.eye(2) if whiten else None
        views.append(ObservedView(int(camera), int(frame), ids, pixels, whitening))
    return views


def _seen(kind: str, rng: np.random.Generator) -> tuple[BundleState, list[ObservedView]]:
    """A rig of the cameras and frames that `_SEEN` names."""
    pairs = _SEEN[kind]
    n_cameras, n_frames = np.max(pairs, axis=0) + 1
    models = tuple(_MODELS[camera % len(_MODELS)] for camera in range(n_cameras))
    state = _state(rng, n_frames, models)
    return state, _views(state, rng, pairs=pairs)


def _pack(views: list[ObservedView], state: BundleState) -> Observations:
    return Observations.pack(views, _BOARD, state.models, len(state.board_trans_m))


def _disturbed(state: BundleState, rng: np.random.Generator) -> BundleState:
    """Move all unknowns but the reference camera: 1 % of focal length, 0.6 degrees, 2 mm."""
    n_cameras, n_lens = state.lens_parameters.shape
    lens_steps = np.full(n_lens, 3e-3)
    lens_steps[:4] = 3
    own = np.tile([*lens_steps, *[1e-2] * 3, *[2e-3] * 3], (n_cameras, 1))
    own *= np.hstack([Free.everything(state).lenses, np.ones((n_cameras, 6))])
    own[0, n_lens:] = 0
    boards = np.tile([*[1e-2] * 3, *[2e-3] * 3], len(state.board_trans_m))
    steps = np.concatenate([own.ravel(), np.full(len(state.shape), 5e-4), boards])
    return state.moved(steps * rng.uniform(-1, 1, len(steps)))


def _dense(
    views: list[ObservedView], state: BundleState, poses: Literal["left", "apart"] = "left"
) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals (M,) and their Jacobian (M, C (P + 6) + S + 6 F), written down plainly.

    Poses change by x -> exp(omega) x + tau ("left"), or as `Pose.perturbed` says ("apart").
    """
    n_cameras, n_lens = state.lens_parameters.shape
    n_shape, n_frames = len(state.shape), len(state.board_trans_m)
    first_shape = n_cameras * (n_lens + 6)
    residuals, rows = [], []
    for view in views:
        lens = state.lenses[view.camera]
        cam, board = state.cams_from_ref[view.camera], state.ref_from_boards[view.frame]
        points_ref = board.apply(state.shape.displaced(_BOARD, state.shape_parameters))
        points_ref = points_ref[view.corner_ids]
        points_cam = cam.apply(points_ref)
        pixels, d_lens, d_points = lens.project_with_jacobians(points_cam)
        arm_cam, arm_board = points_cam, points_ref
        if poses == "apart":
            arm_cam, arm_board = points_cam - cam.trans_m, points_ref - board.trans_m
        identity = np.broadcast_to(np.eye(3), (len(pixels), 3, 3))
        row = np.zeros((len(pixels), 2, first_shape + n_shape + 6 * n_frames))
        start = view.camera * (n_lens + 6)
        row[..., start : start + len(lens.NAMES)] = d_lens
        start += n_lens
        by_cam = np.concatenate([-cross_matrix(arm_cam), identity], axis=2)
        row[..., start : start + 6] = d_points @ by_cam
        turned = cam.rotation @ board.rotation @ state.shape.basis[:, :, view.corner_ids]
        row[..., first_shape : first_shape + n_shape] = np.einsum("nij,sjn->nis", d_points, turned)
        start = first_shape + n_shape + 6 * view.frame
        by_board = cam.rotation @ np.concatenate([-cross_matrix(arm_board), identity], axis=2)
        row[..., start : start + 6] = d_points @ by_board
        white = np.eye(2)[None] if view.whitening is None else view.whitening
        residuals.append((white @ (pixels - view.pixels)[..., None]).ravel())
        rows.append((white @ row).reshape(2 * len(pixels), -1))
    return np.concatenate(residuals), np.concatenate(rows)


def _free(kind: str, state: BundleState) -> Free:
    everything = Free.everything(state)
    everything.lenses[1::3, 9:] = False  # the quotient of the rational lens: hardly determined
    if kind == "all but the reference":
        return everything
    if kind == "boards only":
        return Free.only_boards(state)
    lenses, cameras = everything.lenses.copy(), everything.cameras.copy()
    lenses[0, 4:], lenses[1] = False, False
    cameras[2] = False
    return Free(lenses=lenses, cameras=cameras, shape=np.arange(len(state.shape)) == 1)


def _priors(state: BundleState, rng: np.random.Generator) -> Priors:
    """Something is known of every other lens parameter and of the first term of the shape."""
    n_lens = state.lens_parameters.size
    sigma = np.where(np.arange(n_lens) % 2, 0.3, np.inf).reshape(state.lens_parameters.shape)
    sigma[~Free.everything(state).lenses] = np.inf
    return Priors(
        lens_mean=state.lens_parameters + rng.normal(size=sigma.shape),
        lens_sigma=sigma,
        shape_mean=state.shape_parameters + 1e-3,
        shape_sigma=np.where(np.arange(len(state.shape)) == 0, 2e-3, np.inf),
    )


class _DenseEquations:
    """The dense normal equations over what is free; a prior is one more residual."""

    def __init__(
        self,
        views: list[ObservedView],
        state: BundleState,
        free: Free,
        priors: Priors | None,
        poses: Literal["left", "apart"] = "left",
    ) -> None:
        residuals, jacobian = _dense(views, state, poses)
        if priors is not None:
            n_cameras, n_lens = state.lens_parameters.shape
            places = np.arange(n_cameras)[:, None] * (n_lens + 6) + np.arange(n_lens)
            columns = [*places.ravel(), *n_cameras * (n_lens + 6) + np.arange(len(state.shape))]
            sigma = np.concatenate([priors.lens_sigma.ravel(), priors.shape_sigma])
            off = np.concatenate(
                [
                    (state.lens_parameters - priors.lens_mean).ravel(),
                    state.shape_parameters - priors.shape_mean,
                ]
            )
            rows = np.zeros((len(columns), jacobian.shape[1]))
            rows[np.arange(len(columns)), columns] = 1 / sigma
            residuals, jacobian = np.r_[residuals, off / sigma], np.vstack([jacobian, rows])
        n_boards = 6 * len(state.board_trans_m)
        self.free = np.concatenate([free.mask, np.ones(n_boards, dtype=bool)])
        self.cost = 0.5 * float(residuals @ residuals)
        self.hessian = jacobian[:, self.free].T @ jacobian[:, self.free]
        self.gradient = jacobian[:, self.free].T @ residuals
        self.scale = np.sqrt(np.diag(self.hessian))

    def solve(self, damping: float) -> FloatArray:
        scaled = self.hessian / np.outer(self.scale, self.scale)
        scaled += damping * np.eye(len(scaled))
        return np.asarray(np.linalg.solve(scaled, -self.gradient / self.scale) / self.scale)

    def covariance(self) -> FloatArray:
        outer = np.outer(self.scale, self.scale)
        return np.asarray(np.linalg.inv(self.hessian / outer) / outer)


def _equations(
    views: list[ObservedView], state: BundleState, free: Free, priors: Priors | None = None
) -> BundleEquations:
    observations = _pack(views, state)
    return BundleEquations(observations, state, free, view_blocks(observations, state), priors)


def _covariance(equations: BundleEquations) -> FloatArray:
    covariance = equations.covariance()
    assert covariance is not None
    return covariance


def test_a_step_turns_and_shifts_points_on_the_left(rng: np.random.Generator) -> None:
    state = _state(rng, 2)
    n_cameras, n_lens = state.lens_parameters.shape
    step = rng.normal(0, 0.3, n_cameras * (n_lens + 6) + len(state.shape) + 12)
    moved = state.moved(step)
    by_camera = step[: n_cameras * (n_lens + 6)].reshape(n_cameras, -1)
    pose_steps = [*by_camera[:, n_lens:], *step[-12:].reshape(2, 6)]
    before = [*state.cams_from_ref, *state.ref_from_boards]
    after = [*moved.cams_from_ref, *moved.ref_from_boards]
    points = rng.normal(size=(5, 3))
    for old, new, (*omega, x, y, z) in zip(before, after, pose_steps, strict=True):
        expected = Rotation.from_rotvec(omega).apply(old.apply(points)) + np.array([x, y, z])
        np.testing.assert_allclose(new.apply(points), expected, atol=1e-12)
    np.testing.assert_array_equal(
        moved.lens_parameters, state.lens_parameters + by_camera[:, :n_lens]
    )
    n_shape = len(state.shape)
    np.testing.assert_array_equal(
        moved.shape_parameters, state.shape_parameters + step[-12 - n_shape : -12]
    )


@pytest.mark.parametrize("whiten", [False, True])
def test_products_of_a_view_are_those_of_finite_differences(
    *, whiten: bool, rng: np.random.Generator
) -> None:
    truth = _state(rng, 3)
    views = _views(truth, rng, whiten=whiten)
    state = _disturbed(truth, rng)
    observations = _pack(views, state)
    blocks = view_blocks(observations, state)
    n_lens, n_shape = state.lens_parameters.shape[1], len(state.shape)
    total = 0.0
    for found, position in zip(blocks.products, observations.order, strict=True):
        view = views[position]
        n_own = len(state.models[view.camera].NAMES)
        residuals = _moved_view(view, state, 0, 0.0)
        columns = []
        for column in range(n_own + 6 + n_shape):
            ahead, back = (_moved_view(view, state, column, step) for step in (1e-5, -1e-5))
            columns.append((ahead - back) / 2e-5)
        total += 0.5 * float(residuals @ residuals)
        jacobian = np.stack([*columns, residuals], axis=1)
        expected = np.zeros_like(found)
        places = np.r_[0:n_own, n_lens : n_lens + 6 + n_shape + 1]
        expected[np.ix_(places, places)] = jacobian.T @ jacobian
        size = np.maximum(np.sqrt(np.diag(expected)), 1)
        # Of 1e-5 (px, 1, rad, m): second order is (1e-5)^2 / 6, rounding 1e-13 px / 1e-5
        np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size),
                                   atol=1e-6)  # fmt: skip
    assert blocks.cost == pytest.approx(total, rel=1e-12)


def test_huber_cost_and_its_slope(rng: np.random.Generator) -> None:
    """Quadratic up to the threshold, then straight; the gradient is that of the cost itself."""
    truth = _state(rng, 3)
    views = _views(truth, rng, noise_px=2.0)
    state = _disturbed(truth, rng)
    observations = _pack(views, state)
    threshold = 4.0
    blocks = view_blocks(observations, state, threshold)
    n_lens, n_shape = state.lens_parameters.shape[1], len(state.shape)
    total, n_far = 0.0, 0
    for found, position in zip(blocks.products, observations.order, strict=True):
        view = views[position]
        n_own = len(state.models[view.camera].NAMES)

        def cost(column: int, step: float, view: ObservedView = view) -> float:
            residuals = _moved_view(view, state, column, step).reshape(-1, 2)
            length = np.linalg.norm(residuals, axis=1)
            straight = threshold * length - threshold**2 / 2
            return float(np.where(length > threshold, straight, length**2 / 2).sum())

        total += cost(0, 0.0)
        n_columns = n_own + 6 + n_shape
        # so short that hardly a corner crosses the threshold, where the slope has a kink
        slope = [(cost(k, 1e-7) - cost(k, -1e-7)) / 2e-7 for k in range(n_columns)]
        places = np.r_[0:n_own, n_lens : n_lens + 6 + n_shape]
        size = np.sqrt(np.diag(found)[places] * 2 * cost(0, 0.0))
        np.testing.assert_allclose(found[places, -1] / size, slope / size, atol=1e-6)
        length = np.linalg.norm(_moved_view(view, state, 0, 0.0).reshape(-1, 2), axis=1)
        n_far += int((length > threshold).sum())
    assert blocks.cost == pytest.approx(total, rel=1e-12)
    assert 0.05 < n_far / observations.n_corners < 0.95  # both branches count


def _moved_view(view: ObservedView, state: BundleState, column: int, step: float) -> FloatArray:
    """Whitened residuals after a step of one column of a view: lens, pose of the view, shape."""
    lens = state.lenses[view.camera]
    n_own = len(lens.NAMES)
    steps = np.zeros(n_own + 6 + len(state.shape))
    steps[column] = step
    by_lens, omega, tau, by_shape = np.split(steps, [n_own, n_own + 3, n_own + 6])
    cam_from_board = state.cams_from_ref[view.camera] @ state.ref_from_boards[view.frame]
    points = state.shape.displaced(_BOARD, state.shape_parameters + by_shape)[view.corner_ids]
    points = Rotation.from_rotvec(omega).apply(cam_from_board.apply(points)) + tau
    pixels = type(lens).from_parameters(lens.parameters + by_lens).project(points)
    residuals = pixels - view.pixels
    if view.whitening is not None:
        residuals = np.einsum("nij,nj->ni", view.whitening, residuals)
    return residuals.ravel()


@pytest.mark.parametrize(
    ("kind", "seen", "with_priors", "damping"),
    [
        ("all but the reference", "by most", False, 0.0),
        ("all but the reference", "by most", True, 1e-2),
        ("all but the reference", "by few", False, 1e-2),
        ("all but the reference", "by few", True, 0.0),
        ("all but the reference", "by one", False, 0.0),
        ("some fixed", "by most", False, 0.0),
        ("some fixed", "by most", True, 1e-2),
        ("boards only", "by most", False, 1e-2),
    ],
)
def test_a_step_solves_the_dense_normal_equations(
    *, kind: str, seen: str, with_priors: bool, damping: float, rng: np.random.Generator
) -> None:
    truth, views = _seen(seen, rng)
    state = _disturbed(truth, rng)
    free = _free(kind, state)
    priors = _priors(state, rng) if with_priors else None
    dense = _DenseEquations(views, state, free, priors)
    equations = _equations(views, state, free, priors)
    step = equations.step(damping)
    assert step is not None
    expected = dense.solve(damping)
    size = np.abs(expected * dense.scale).max()
    # The scaled Hessians have conditions of 1e3 to 1e6, and rounding is 1e-16
    found = step.vector[dense.free]
    np.testing.assert_allclose(found * dense.scale, expected * dense.scale, atol=1e-9 * size)
    assert (step.vector[~dense.free] == 0).all()
    model = dense.gradient @ expected + 0.5 * expected @ dense.hessian @ expected
    assert step.predicted == pytest.approx(-model, rel=1e-9)
    assert step.largest == pytest.approx(size, rel=1e-9)
    assert equations.cost == pytest.approx(dense.cost, rel=1e-12)


@pytest.mark.parametrize("with_priors", [False, True])
@pytest.mark.parametrize(
    ("kind", "seen"),
    [
        ("all but the reference", "by most"),
        ("all but the reference", "by few"),
        ("some fixed", "by most"),
    ],
)
def test_covariances_are_blocks_of_the_dense_inverse(
    *, kind: str, seen: str, with_priors: bool, rng: np.random.Generator
) -> None:
    """Of the Hessian by what `Pose.perturbed` moves."""
    state, views = _seen(seen, rng)
    free = _free(kind, state)
    priors = _priors(state, rng) if with_priors else None
    dense = _DenseEquations(views, state, free, priors, "apart")
    equations = _equations(views, state, free, priors)
    covariance = _covariance(equations)
    boards = equations.board_covariances(covariance)
    assert boards is not None
    assert (covariance[~free.mask] == 0).all()
    expected = dense.covariance()
    sigma = np.sqrt(np.diag(expected))
    expected /= np.outer(sigma, sigma)
    n = int(free.mask.sum())
    found = covariance[np.ix_(free.mask, free.mask)] / np.outer(sigma[:n], sigma[:n])
    np.testing.assert_allclose(found, expected[:n, :n], atol=1e-9)
    assert len(boards) == (len(sigma) - n) // 6
    for frame, found in enumerate(boards):
        own = slice(n + 6 * frame, n + 6 * frame + 6)
        np.testing.assert_allclose(
            found / np.outer(sigma[own], sigma[own]), expected[own, own], atol=1e-9
        )


@pytest.mark.parametrize("with_priors", [False, True])
def test_reweighting_is_whitening_with_other_noise(
    *, with_priors: bool, rng: np.random.Generator
) -> None:
    state, views = _seen("by most", rng)
    state = _disturbed(state, rng)
    free = _free("all but the reference", state)
    priors = _priors(state, rng) if with_priors else None
    factors = rng.uniform(0.5, 2, len(views))
    sorted_factors = factors[_pack(views, state).order]
    found = _equations(views, state, free, priors).reweighted(sorted_factors)
    other = [
        replace(view, whitening=factor * view.whitening)
        for factor, view in zip(factors, views, strict=True)
        if view.whitening is not None
    ]
    expected = _equations(other, state, free, priors)
    steps = found.step(1e-3), expected.step(1e-3)
    assert steps[0] is not None
    assert steps[1] is not None
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    size = np.abs(steps[1].vector).max()
    np.testing.assert_allclose(steps[0].vector, steps[1].vector, rtol=1e-9, atol=1e-12 * size)

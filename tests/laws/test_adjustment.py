"""Reprojection residuals: their derivatives, and what the pair's covariance rests on."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.adjustment import (
    Free,
    PlanarView,
    Scene,
    Sightings,
    rms_px,
    whitened_residuals,
)
from calichrome.geometry.lenses import BrownConrady

_GRID = np.stack([*map(np.ravel, np.meshgrid(np.arange(6.0), np.arange(4.0))), np.zeros(24)], 1)
_POINTS_BOARD = _GRID * [0.04, 0.04, 1.0]


def _scene(rng: np.random.Generator, n_cameras: int, n_boards: int) -> Scene:
    lenses = tuple(
        BrownConrady.from_parameters(
            np.array([600.0, 610, 320, 240, -0.2, 0.08, 1e-3, -5e-4, -0.01])
            * rng.uniform(0.9, 1.1, 9)
        )
        for _ in range(n_cameras)
    )
    cams_from_ref = (
        Pose.identity(),
        *(
            Pose.from_rotvec(rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.1, 0.1, 3))
            for _ in range(n_cameras - 1)
        ),
    )
    boards = tuple(
        Pose.from_rotvec(rng.uniform(-0.5, 0.5, 3), [*rng.uniform(-0.2, 0, 2), 0.7])
        for _ in range(n_boards)
    )
    return Scene(lenses, cams_from_ref, boards)


def _sightings(
    scene: Scene, rng: np.random.Generator, *, noise_px: float = 1.0, whiten: bool = True
) -> Sightings:
    """Every camera sees every board; corners are unequally sure and correlated."""
    views = []
    for camera, (lens, cam_from_ref) in enumerate(
        zip(scene.lenses, scene.cams_from_ref, strict=True)
    ):
        for board, pose in enumerate(scene.ref_from_boards):
            pixels = lens.project((cam_from_ref @ pose).apply(_POINTS_BOARD))
            pixels = pixels + rng.normal(0, noise_px, pixels.shape)
            whitening = np.tril(rng.uniform(0.5, 2, (len(pixels), 2, 2))) if whiten else None
            view = PlanarView(points_board=_POINTS_BOARD, pixels=pixels, whitening=whitening)
            views.append((camera, board, view))
    return Sightings.collect(views)


def _moved(scene: Scene, free: Free, column: int, step: float) -> Scene:
    """Move one unknown, in the order that `whitened_residuals` documents."""
    lenses, cameras = list(scene.lenses), list(scene.cams_from_ref)
    boards = list(scene.ref_from_boards)
    lens_columns = [(int(i), int(j)) for i, j in np.argwhere(free.lenses)]
    pose_step = np.zeros(6)
    if column < len(lens_columns):
        camera, parameter = lens_columns[column]
        parameters = lenses[camera].parameters
        parameters[parameter] += step
        lenses[camera] = BrownConrady.from_parameters(parameters)
    else:
        index, component = divmod(column - len(lens_columns), 6)
        pose_step[component] = step
        free_cameras = np.flatnonzero(free.cameras)
        if index < len(free_cameras):
            camera = int(free_cameras[index])
            cameras[camera] = cameras[camera].perturbed(pose_step)
        else:
            board = index - len(free_cameras)
            boards[board] = boards[board].perturbed(pose_step)
    return Scene(tuple(lenses), tuple(cameras), tuple(boards))


@pytest.mark.parametrize("kind", ["all free", "boards only", "some lens, some cameras"])
def test_jacobian_is_finite_differences(kind: str, rng: np.random.Generator) -> None:
    scene = _scene(rng, 3, 2)
    free = {
        "all free": Free(np.ones((3, 9), dtype=bool), np.ones(3, dtype=bool)),
        "boards only": Free.only_boards(3),
        "some lens, some cameras": Free(
            np.array([[True] * 4 + [False] * 5, [False] * 9, [False, True, True] * 3]),
            np.array([False, True, False]),
        ),
    }[kind]
    sightings = _sightings(scene, rng)
    residuals, jacobian = whitened_residuals(sightings, scene, free)
    assert jacobian.shape == (len(residuals), free.lenses.sum() + 6 * free.cameras.sum() + 12)
    for column in range(jacobian.shape[1]):
        # Of 1e-5 (px, 1, rad, m): second order is (1e-5)^2 / 6, rounding 1e-12 px / 1e-5
        step = 1e-5
        ahead, _ = whitened_residuals(sightings, _moved(scene, free, column, step), free)
        back, _ = whitened_residuals(sightings, _moved(scene, free, column, -step), free)
        slope = (ahead - back) / (2 * step)
        np.testing.assert_allclose(
            jacobian[:, column], slope, atol=1e-6 * np.abs(slope).max(), err_msg=f"{column}"
        )


def test_residuals_are_projected_minus_observed(rng: np.random.Generator) -> None:
    scene = _scene(rng, 1, 1)
    sightings = _sightings(scene, rng, noise_px=0, whiten=False)
    shifted = Sightings(
        sightings.camera,
        sightings.board,
        sightings.points_board,
        sightings.pixels + np.array([3.0, -4.0]),
        sightings.whitening,
    )
    residuals, _ = whitened_residuals(shifted, scene, Free.only_boards(1))
    np.testing.assert_allclose(residuals.reshape(-1, 2), [[-3.0, 4.0]] * 24, atol=1e-10)
    assert rms_px(residuals.reshape(-1, 2)) == pytest.approx(5)


def test_whitened_noise_is_white(rng: np.random.Generator) -> None:
    """W'W is the inverse covariance: residuals of that covariance come out with unit variance."""
    cov_px = np.array([[0.5, 0.3], [0.3, 0.4]])
    n_corners = 20_000
    view = PlanarView(
        points_board=np.zeros((n_corners, 3)),
        pixels=rng.multivariate_normal(np.zeros(2), cov_px, n_corners),
        whitening=np.broadcast_to(np.linalg.inv(np.linalg.cholesky(cov_px)), (n_corners, 2, 2)),
    )
    lens = BrownConrady(fx=1, fy=1, cx=0, cy=0)
    scene = Scene((lens,), (Pose.identity(),), (Pose(np.eye(3), np.array([0.0, 0, 1])),))
    residuals, _ = whitened_residuals(Sightings.collect([(0, 0, view)]), scene, Free.only_boards(1))
    found = np.cov(residuals.reshape(-1, 2).T)
    np.testing.assert_allclose(found, np.eye(2), atol=0.03)  # 3 sqrt(2 / 20000)


def test_lens_errors_and_pair_noise_do_not_correlate(rng: np.random.Generator) -> None:
    """Both are linear in the same corner noise; the product of their maps is zero.

    This is why the covariance of a pair may add the noise of its corners and that of the lenses.
    """
    scene = _scene(rng, 2, 5)
    sightings = _sightings(scene, rng, noise_px=0)
    pair_free = Free(np.zeros((2, 9), dtype=bool), np.array([False, True]))
    _, pair_jacobian = whitened_residuals(sightings, scene, pair_free)
    pair_from_noise = -_pseudo_inverse(pair_jacobian)[:6]
    lens_from_noise = block_diag(
        *(-_pseudo_inverse(_camera_jacobian(scene, sightings, camera))[:9] for camera in (0, 1))
    )
    cross = pair_from_noise @ lens_from_noise.T
    scale = np.outer(
        np.linalg.norm(pair_from_noise, axis=1), np.linalg.norm(lens_from_noise, axis=1)
    )
    np.testing.assert_allclose(cross / scale, 0, atol=1e-8)  # of correlations, rounding


def _camera_jacobian(scene: Scene, sightings: Sightings, camera: int) -> FloatArray:
    """Of one camera's own calibration: its lens and a free pose of every board it sees."""
    rows = sightings.camera == camera
    own = Sightings(
        np.zeros(int(rows.sum()), dtype=np.int64),
        sightings.board[rows],
        sightings.points_board[rows],
        sightings.pixels[rows],
        sightings.whitening[rows],
    )
    cam_from_ref = scene.cams_from_ref[camera]
    boards = tuple(cam_from_ref @ pose for pose in scene.ref_from_boards)
    alone = Scene((scene.lenses[camera],), (Pose.identity(),), boards)
    free = Free(np.ones((1, 9), dtype=bool), np.zeros(1, dtype=bool))
    return whitened_residuals(own, alone, free)[1]


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    """With the columns brought to one size first: units alone make the condition 1e9."""
    scale = np.linalg.norm(jacobian, axis=0)
    return np.asarray(np.linalg.pinv(jacobian / scale) / scale[:, None])

"""The detection benchmark: its pictures against integrals, its bound against sampling."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import erf

from calichrome.core.arrays import BoolArray, FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.detection.bound import corner_cells, cramer_rao, oracle
from benchmarks.detection.peers import Detection, Detector
from benchmarks.detection.real import held_out_rms_px
from benchmarks.detection.renderer import Canvas, checkers, rectangle
from benchmarks.detection.scenes import Scene, noisy, random_scene, render
from benchmarks.detection.scoring import compare, ratios, summary
from benchmarks.detection.variants import PartialView, cut, shows_enough, visible_corners


def _flat_canvas(sigma_px: float, turn_rad: float, origin_px: tuple[float, float]) -> Canvas:
    """One unit of the plane is one pixel, turned about `origin_px`."""
    lens = BrownConrady(fx=1000, fy=1000, cx=0, cy=0)
    x, y = origin_px
    pose = Pose.from_rotvec([0, 0, turn_rad], [x, y, 1000])
    return Canvas(lens, pose, (48, 48), 1.0, sigma_px)


def _exact_edge(distance_px: FloatArray, turn_rad: float, sigma_px: float) -> FloatArray:
    """Integral over the pixel of a Gaussian edge: exact in one axis, 400 points in the other."""
    t = (np.arange(400) + 0.5) / 400 - 0.5
    cos, sin = abs(np.cos(turn_rad)), abs(np.sin(turn_rad))
    at = (distance_px[..., None] + sin * t) / sigma_px
    half = cos / 2 / sigma_px

    def antiderivative(z: FloatArray) -> FloatArray:
        gauss = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
        return np.asarray(z * (1 + erf(z / np.sqrt(2))) / 2 + gauss)

    mean = (antiderivative(at + half) - antiderivative(at - half)) / (2 * half)
    return np.asarray(mean.mean(axis=-1))


@pytest.mark.parametrize("sigma_px", [0.5, 0.8, 1.5])
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, np.pi / 4])
def test_edge_has_its_phase(sigma_px: float, turn_rad: float) -> None:
    """The place that least squares gives an edge, over phases of the sub-pixel position."""
    bias = []
    for phase in np.linspace(0, 1, 8, endpoint=False):
        canvas = _flat_canvas(sigma_px, turn_rad, (24 + phase, 24))
        window = slice(8, 40), slice(8, 40)
        drawn = canvas.draw(rectangle((0, 100, -100, 100)), window)[0]
        u, _ = canvas.plane(window, 0)
        exact = _exact_edge(u, turn_rad, sigma_px)
        step = 1e-3
        slope = (
            _exact_edge(u + step, turn_rad, sigma_px) - _exact_edge(u - step, turn_rad, sigma_px)
        ) / (2 * step)
        bias.append(((drawn - exact) * slope).sum() / (slope**2).sum())
    assert np.abs(bias).max() < 1e-3


def test_derivative_is_the_difference_of_moved_pictures() -> None:
    scene = random_scene(0)
    step = 0.02
    nx, ny = scene.target.squares
    window = scene.canvas.window((-1, nx - 1, -1, ny - 1))
    assert window is not None
    shape = checkers((nx, ny), black_first=True)
    _, by_x, by_y = scene.canvas.draw(shape, window, derivatives=True)
    for name, derivative in (("cx", by_x), ("cy", by_y)):
        moved = []
        for sign in (1, -1):
            lens = replace(scene.lens, **{name: getattr(scene.lens, name) + sign * step})
            moved.append(replace(scene, lens=lens).canvas.draw(shape, window)[0])
        difference = (moved[0] - moved[1]) / (2 * step)
        # What 4 x 4 samples leave of the phase: 1 % of the steepest slope
        np.testing.assert_allclose(derivative, difference, atol=0.01 * np.abs(by_x).max())


def _small_scene(noise_dn: float = 2.0) -> Scene:
    scene = random_scene(1)
    return replace(scene, noise_dn=noise_dn)


def test_scenes_repeat_and_lie_inside() -> None:
    for seed in range(20):
        scene = random_scene(seed)
        np.testing.assert_array_equal(scene.corners_px, random_scene(seed).corners_px)
        assert (scene.corners_px > 0).all()
        assert (scene.corners_px < np.array(scene.size_wh)).all()
        assert 0.5 <= scene.psf_sigma_px <= 1.5
        assert 1 <= scene.noise_dn <= 5


def test_coarse_rays_are_exact() -> None:
    """The plane's coordinates, splined from every eighth pixel, at the true corners."""
    for seed in range(6):
        scene = random_scene(seed)
        corner = np.rint(scene.corners_px[0]).astype(int)
        window = slice(corner[1] - 40, corner[1] + 40), slice(corner[0] - 40, corner[0] + 40)
        u, v = scene.canvas.plane(window, 0)
        y, x = np.mgrid[window]
        back = scene.canvas.pixels_of(np.stack([u, v], axis=-1))
        assert np.abs(back - np.stack([x, y], axis=-1)).max() < 1e-4


def test_oracle_attains_the_bound() -> None:
    """56 corners x 12 noises: the mean of e' C^-1 e / 2 is 1 +- 0.04 (one standard error)."""
    scene = _small_scene()
    cells = corner_cells(scene)
    bound_px2 = cramer_rao(scene, cells)
    clean = render(scene, "plain")
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(12):
        errors = oracle(scene, cells, clean, noisy(clean, scene, rng)) - scene.corners_px
        squares.append(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(bound_px2), errors) / 2)
    # rounding adds 1/12 DN^2 to 4 DN^2, which the bound leaves out
    assert np.mean(squares) == pytest.approx(1 + 1 / 48, abs=0.12)


def test_scores() -> None:
    scene = _small_scene()
    truth, spacing = scene.corners_px, scene.spacing_px
    ids = np.arange(len(truth))
    absolute, whole = Detector(None, "absolute"), Detector(None, "whole")
    exact = compare(absolute, Detection(truth, ids), truth, spacing)
    assert exact.is_whole
    assert exact.n_wrong == 0
    turned = Detection(truth[::-1], ids)
    assert compare(whole, turned, truth, spacing).is_whole
    assert compare(absolute, turned, truth, spacing).n_wrong == len(truth)
    points = np.concatenate([truth[1:] + 0.1, [[-50, -50]]])
    score = compare(Detector(None, "none"), Detection(points), truth, spacing)
    assert len(score.ids) == len(truth) - 1
    assert score.n_false == 1
    unit = np.broadcast_to(np.eye(2) * 0.01, (len(truth), 2, 2))
    np.testing.assert_allclose(ratios(score, unit), 1.0)


def test_discs_change_their_squares_only() -> None:
    scene = _small_scene()
    disc, plain = render(scene, "disc"), render(scene, "plain")
    differs = np.argwhere(np.abs(disc - plain) > 0.5)
    assert len(differs)
    nearest = np.linalg.norm(differs[:, None, ::-1] - scene.corners_px, axis=-1).min(axis=1)
    # ratio 0.5: 0.457 of a square from disc rim to corner at no tilt, less the point spread
    assert nearest.min() > 0.25 * scene.spacing_px.min() - 3 * scene.psf_sigma_px


def test_summary_of_an_efficient_estimator_is_one(rng: np.random.Generator) -> None:
    """200,000 errors of unit covariance: 0.5 % is four standard errors of the median."""
    errors = rng.standard_normal((200_000, 2))
    ratio = np.sqrt((errors**2).sum(axis=1) / 2)
    np.testing.assert_allclose([float(text) for text in summary([ratio])], 1, atol=0.0101)


def test_everything_is_visible_until_something_hides_it() -> None:
    scene = _small_scene()
    width, height = scene.size_wh
    hidden = np.zeros((height, width), dtype=bool)
    corners, squares = visible_corners(scene, hidden, np.zeros(2, dtype=np.int64))
    assert corners.all()
    assert squares.all()
    x, y = np.rint(scene.corners_px[9]).astype(int)
    hidden[y, x] = True
    corners, squares = visible_corners(scene, hidden, np.zeros(2, dtype=np.int64))
    assert np.flatnonzero(~corners).tolist() == [9]
    assert (~squares).sum() <= 4


def test_a_cut_keeps_the_corners_inside() -> None:
    scene = _small_scene()
    clean = render(scene)
    for seed in range(6):
        view = cut(scene, clean, np.random.default_rng(seed))
        height, width = view.clean.shape[:2]
        inside = ((view.corners_px > 0) & (view.corners_px < [width - 1, height - 1])).all(axis=1)
        assert not (view.visible & ~inside).any()
        assert not view.visible.all()


def test_enough_is_a_block_and_six_discs() -> None:
    scene = _small_scene()
    ny, nx = scene.target.squares[::-1]

    def shows(squares: BoolArray) -> bool:
        nothing = np.empty((0, 2))
        view = PartialView(
            np.empty((0, 0, 3), dtype=np.float32), squares, nothing, squares, squares
        )
        return shows_enough(scene, view)

    squares = np.zeros((ny, nx), dtype=bool)
    squares[:3, :3] = True
    assert not shows(squares)
    squares[:3] = squares[:, :4] = True
    assert shows(squares)
    ix, iy = scene.target.marker_squares.T
    squares[iy, ix] = False
    assert not shows(squares)


def test_held_out_error_is_the_noise(rng: np.random.Generator) -> None:
    """Exact corners and noise of 0.1 px per axis: 0.141 px, and a little for what is fitted."""
    scene = random_scene(0)
    ids = np.arange(scene.target.n_corners)
    views = []
    for _ in range(16):
        turn = Rotation.from_euler("xyz", rng.uniform(-0.6, 0.6, 3))
        pose = Pose(turn.as_matrix(), np.array([-0.1, -0.1, 0.5]) + rng.uniform(-0.05, 0.05, 3))
        corners = replace(scene, cam_from_board=pose).corners_px
        views.append((ids, corners + rng.normal(0, 0.1, corners.shape)))
    error = held_out_rms_px(views, scene.target, scene.size_wh)
    assert error == pytest.approx(0.141, rel=0.1)

"""Triangulated points: exact without noise, true covariances, outliers found, doubts said."""

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry import intersection
from calichrome.geometry.lenses import BrownConrady, Lens
from calichrome.geometry.lenses.kannala_brandt import KannalaBrandt
from calichrome.geometry.triangulation import TriangulatedPoints, triangulate

_SIGMA_PX = 0.2
_COV_PX2 = _SIGMA_PX**2 * np.eye(2)
_MIDDLE = np.array([0.0, 0.0, 1.5])


def _looking_at_middle(position: FloatArray) -> Pose:
    z_axis = (_MIDDLE - position) / np.linalg.norm(_MIDDLE - position)
    x_axis = np.cross([0.0, 1.0, 0.0], z_axis)
    x_axis /= np.linalg.norm(x_axis)
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return Pose(rotation, -rotation @ position)


def _rig(n_cameras: int) -> tuple[list[Lens], list[Pose]]:
    """Cameras on an arc of 1.2 m, some above it, the first at the origin of ref; one a fisheye."""
    lenses: list[Lens] = [
        BrownConrady(fx=900 + 10 * i, fy=905 + 9 * i, cx=640 + i, cy=480 - i, k1=-0.2, k2=0.08)
        for i in range(n_cameras)
    ]
    lenses[-1] = KannalaBrandt(fx=600, fy=601, cx=642, cy=477, k1=-0.01, k2=0.002)
    places = [Pose.identity()] + [
        _looking_at_middle(np.array([1.2 * i / (n_cameras - 1), 0.3 * (i % 2), 0.1 * i]))
        for i in range(1, n_cameras)
    ]
    return lenses, places


def _projected(lenses: list[Lens], poses: list[Pose], points_ref: FloatArray) -> FloatArray:
    """Pixels (N, C, 2)."""
    views = [lens.project(pose.apply(points_ref)) for lens, pose in zip(lenses, poses, strict=True)]
    return np.stack(views, axis=1)


def _points(rng: np.random.Generator, n_points: int) -> FloatArray:
    return _MIDDLE + rng.uniform(-0.3, 0.3, (n_points, 3))


def _moved(
    lenses: list[Lens], poses: list[Pose], step: FloatArray
) -> tuple[list[Lens], list[Pose]]:
    """Cameras with other parameters, in the order of `cameras_cov`."""
    new_lenses, new_poses, at = [], [], 0
    for lens, pose in zip(lenses, poses, strict=True):
        n = len(lens.NAMES)
        new_lenses.append(type(lens).from_parameters(lens.parameters + step[at : at + n]))
        new_poses.append(pose.perturbed(step[at + n : at + n + 6]))
        at += n + 6
    return new_lenses, new_poses


def _cameras_cov(lenses: list[Lens], rng: np.random.Generator) -> FloatArray:
    """Correlated errors: a pixel of focal length, 0.3 px of centre, 0.3 mrad, 0.5 mm."""
    sigmas = []
    for index, lens in enumerate(lenses):
        typical = {"fx": 1.0, "fy": 1.0, "cx": 0.3, "cy": 0.3}
        sigmas += [typical.get(name, 1e-3) for name in lens.NAMES]
        sigmas += [0.0] * 6 if index == 0 else [3e-4] * 3 + [5e-4] * 3
    mixing = rng.normal(size=(len(sigmas), len(sigmas)))
    correlated = mixing @ mixing.T
    scale = np.array(sigmas) / np.sqrt(np.diag(correlated))
    return np.asarray(correlated * np.outer(scale, scale))


def _mahalanobis(errors: FloatArray, cov: FloatArray) -> FloatArray:
    distance = np.einsum("ni,ni->n", errors, np.linalg.solve(cov, errors[..., None])[..., 0])
    return np.asarray(distance)


def _mean_tolerance(dimensions: int, n_draws: int) -> float:
    """Four sigmas of the mean of `n_draws` chi-squares: one failure in 16,000."""
    return 4 * float(np.sqrt(2 * dimensions / n_draws))


# --- points -------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_cameras", [2, 3, 8])
def test_exact_without_noise(n_cameras: int, rng: np.random.Generator) -> None:
    lenses, poses = _rig(n_cameras)
    points = _points(rng, 200)
    pixels = _projected(lenses, poses, points)
    if n_cameras == 8:  # each point in two to eight views
        hidden = rng.uniform(size=(200, 8)) < rng.uniform(0, 0.75, (200, 1))
        hidden[:, [2, 5]] = False
        pixels[hidden] = np.nan
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    # 1e-8 of a sigma, where the steps stop, of points with sigmas below 2 mm
    np.testing.assert_allclose(found.points_ref, points, rtol=0, atol=2e-11)
    np.testing.assert_array_equal(found.used, np.isfinite(pixels).all(axis=2))
    np.testing.assert_allclose(found.chi_square, 0, atol=1e-10)
    np.testing.assert_array_equal(found.freedom, 2 * found.used.sum(axis=1) - 3)
    for flag in (found.few_views, found.behind, found.inconsistent, found.small_angle):
        assert not flag.any()


def test_points_beside_and_behind_a_fisheye(rng: np.random.Generator) -> None:
    """Rays beyond 90 degrees are rays like others."""
    lens = KannalaBrandt(fx=250, fy=251, cx=321, cy=237, k1=-0.01, k2=0.003)
    poses = [Pose.identity(), Pose.from_rotvec([0.1, 0, 0], [0, 0.5, 0])]
    points = rng.uniform([0.7, -0.3, -0.2], [0.9, 0.3, 0.1], (50, 3))
    assert (points[:, 2] < 0).any()
    found = triangulate(_projected([lens] * 2, poses, points), [lens] * 2, poses, cov_px2=_COV_PX2)
    np.testing.assert_allclose(found.points_ref, points, rtol=0, atol=1e-10)


def test_the_minimum_of_the_whitened_error(rng: np.random.Generator) -> None:
    lenses, poses = _rig(3)
    mixing = rng.normal(size=(20, 3, 2, 2))
    cov_px2 = mixing @ mixing.swapaxes(2, 3) + 0.1 * np.eye(2)
    pixels = _projected(lenses, poses, _points(rng, 20)) + rng.normal(0, 1, (20, 3, 2))
    found = triangulate(pixels, lenses, poses, cov_px2=cov_px2)
    assert found.used.all()
    whitening = np.linalg.inv(np.linalg.cholesky(cov_px2))
    for index in range(20):

        def residuals(point: FloatArray, index: int = index) -> FloatArray:
            error = _projected(lenses, poses, point[None])[0] - pixels[index]
            return np.asarray((whitening[index] @ error[..., None]).ravel())

        best = least_squares(residuals, _MIDDLE, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        # its derivatives are differences
        np.testing.assert_allclose(found.points_ref[index], best.x, atol=1e-7)
        assert found.chi_square[index] == pytest.approx(2 * best.cost, rel=1e-9)
        np.testing.assert_allclose(
            np.linalg.inv(found.cov_m2[index]), best.jac.T @ best.jac, rtol=1e-4
        )


def test_blocks_of_points_do_not_matter(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    lenses, poses = _rig(4)
    pixels = _projected(lenses, poses, _points(rng, 23)) + rng.normal(0, 0.2, (23, 4, 2))
    pixels[::5, 1] += 30
    cov = _cameras_cov(lenses, rng)
    whole = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=cov)
    monkeypatch.setattr(intersection, "_MOST_NUMBERS", 3 * 8 * len(cov))  # 3 points at a time
    apart = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=cov)
    np.testing.assert_allclose(apart.points_ref, whole.points_ref, rtol=0, atol=1e-12)
    np.testing.assert_allclose(apart.cov_m2, whole.cov_m2, rtol=1e-9)
    np.testing.assert_array_equal(apart.used, whole.used)


# --- covariances --------------------------------------------------------------------------------


@pytest.mark.parametrize("n_cameras", [2, 4])
def test_errors_scatter_as_predicted_from_pixels(n_cameras: int, rng: np.random.Generator) -> None:
    lenses, poses = _rig(n_cameras)
    n_draws = 4000
    mixing = rng.normal(size=(n_draws, n_cameras, 2, 2))
    cov_px2 = 0.02 * mixing @ mixing.swapaxes(2, 3) + 0.01 * np.eye(2)
    noise = np.linalg.cholesky(cov_px2) @ rng.normal(size=(n_draws, n_cameras, 2, 1))
    points = _points(rng, n_draws)
    pixels = _projected(lenses, poses, points) + noise[..., 0]
    found = triangulate(pixels, lenses, poses, cov_px2=cov_px2)
    distance = _mahalanobis(found.points_ref - points, found.cov_m2)
    assert distance.mean() == pytest.approx(3, abs=_mean_tolerance(3, n_draws))
    freedom = 2 * n_cameras - 3
    assert found.chi_square.mean() == pytest.approx(freedom, abs=_mean_tolerance(freedom, n_draws))


def test_derivatives_by_the_cameras(rng: np.random.Generator) -> None:
    lenses, poses = _rig(3)
    points = _points(rng, 5)
    pixels = _projected(lenses, poses, points)
    cov = _cameras_cov(lenses, rng)
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=cov)
    assert found.d_points_d_cameras is not None
    for column in range(len(cov)):
        derivative = found.d_points_d_cameras[:, :, column]
        size = np.abs(derivative).max()
        step = np.zeros(len(cov))
        step[column] = 1e-5 / size  # moves the points by 10 um, which are exact to 1e-11 m
        ahead, behind = (
            triangulate(pixels, *_moved(lenses, poses, sign * step), cov_px2=_COV_PX2).points_ref
            for sign in (1, -1)
        )
        slope = (ahead - behind) / (2 * step[column])
        np.testing.assert_allclose(derivative, slope, rtol=0, atol=1e-5 * size)


@pytest.mark.slow
def test_errors_scatter_as_predicted_from_calibration(rng: np.random.Generator) -> None:
    """Two points at a time: alone, together and their distance, when the cameras are wrong, too."""
    lenses, poses = _rig(3)
    cov = _cameras_cov(lenses, rng)
    variances, vectors = np.linalg.eigh(cov)
    root = vectors * np.sqrt(np.maximum(variances, 0))
    n_draws = 600
    alone, together, lengths, chi_square, ignorant = [], [], [], [], []
    for draw in range(n_draws):
        points = _points(rng, 2)
        pixels = _projected(lenses, poses, points) + rng.normal(0, _SIGMA_PX, (2, 3, 2))
        wrong = _moved(lenses, poses, root @ rng.normal(size=len(cov)))
        found = triangulate(pixels, *wrong, cov_px2=_COV_PX2, cameras_cov=cov)
        errors = found.points_ref - points
        alone.append(_mahalanobis(errors, found.cov_m2)[0])
        joint = found.joint_covariance([0, 1]).reshape(6, 6)
        together.append(_mahalanobis(errors.reshape(1, 6), joint[None])[0])
        true_m, found_m = (np.linalg.norm(p[0] - p[1]) for p in (points, found.points_ref))
        lengths.append(((found_m - true_m) / found.distance_sigma_m(0, 1)) ** 2)
        chi_square.append(found.chi_square[0])
        if draw < 50:
            exact = triangulate(pixels, *wrong, cov_px2=_COV_PX2)
            ignorant.append(_mahalanobis(exact.points_ref - points, exact.cov_m2)[0])
    for values, freedom in ((alone, 3), (together, 6), (lengths, 1), (chi_square, 3)):
        assert np.mean(values) == pytest.approx(freedom, abs=_mean_tolerance(freedom, n_draws))
    assert np.mean(ignorant) > 10  # or the cameras were not wrong enough to matter


def test_distance_sigma_is_that_of_the_joint_covariance(rng: np.random.Generator) -> None:
    lenses, poses = _rig(3)
    cov = _cameras_cov(lenses, rng)
    pixels = _projected(lenses, poses, _points(rng, 4))
    for cameras_cov in (None, cov):
        found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=cameras_cov)
        pairs = np.array(list(itertools.combinations(range(4), 2)))
        sigmas = found.distance_sigma_m(*pairs.T)
        for (i, j), sigma in zip(pairs, sigmas, strict=True):
            between = found.points_ref[i] - found.points_ref[j]
            slope = np.concatenate([between, -between]) / np.linalg.norm(between)
            joint = found.joint_covariance([i, j]).reshape(6, 6)
            assert sigma == pytest.approx(np.sqrt(slope @ joint @ slope), rel=1e-9)
        np.testing.assert_allclose(found.joint_covariance([2, 2])[0, :, 1], found.cov_m2[2])
        assert np.isnan(found.distance_sigma_m(1, 1))


# --- doubts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n_cameras", "n_wrong"), [(3, 1), (4, 1), (8, 3), (10, 2)])
def test_gross_outliers_are_found(n_cameras: int, n_wrong: int, rng: np.random.Generator) -> None:
    lenses, poses = _rig(n_cameras)
    n_points = 200
    points = _points(rng, n_points)
    noisy = _projected(lenses, poses, points) + rng.normal(0, _SIGMA_PX, (n_points, n_cameras, 2))
    wrong = np.zeros((n_points, n_cameras), dtype=bool)
    wrong[:, :n_wrong] = True
    wrong = rng.permuted(wrong, axis=1)
    direction = rng.normal(size=(n_points, n_cameras, 2))
    direction *= rng.uniform(20, 60, (n_points, n_cameras, 1)) / np.linalg.norm(
        direction, axis=2, keepdims=True
    )
    found = triangulate(
        np.where(wrong[..., None], noisy + direction, noisy), lenses, poses, cov_px2=_COV_PX2
    )
    without = triangulate(
        np.where(wrong[..., None], np.nan, noisy), lenses, poses, cov_px2=_COV_PX2
    )
    right = (found.used == ~wrong).all(axis=1)
    # of three views any two agree when the error of one lies along an epipolar line: it is said
    unclear = found.inconsistent
    assert (right | unclear).all()
    # what remains is doubted once in a thousand; 2 of 200 leave room for chance (0.1 %)
    assert unclear.mean() <= (0.15 if n_cameras == 3 else 0.01)
    np.testing.assert_allclose(
        found.points_ref[right], without.points_ref[right], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("n_cameras", [3, 4])
def test_no_innocent_view_is_blamed(n_cameras: int, rng: np.random.Generator) -> None:
    """An outlier of 4 to 12 sigmas may stay unclear, but others do not pay for it."""
    lenses, poses = _rig(n_cameras)
    n_points = 4000
    pixels = _projected(lenses, poses, _points(rng, n_points))
    pixels += rng.normal(0, _SIGMA_PX, pixels.shape)
    rows, wrong = np.arange(n_points), rng.integers(0, n_cameras, n_points)
    angle, size = rng.uniform(0, 2 * np.pi, n_points), rng.uniform(4, 12, n_points) * _SIGMA_PX
    pixels[rows, wrong] += (size * [np.cos(angle), np.sin(angle)]).T
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    blamed = ~found.used
    blamed[rows, wrong] = False
    # a subset is taken when all others are a thousandth as likely
    assert blamed.any(axis=1).mean() <= 1e-3 + 4 * np.sqrt(1e-3 / n_points)


@pytest.mark.parametrize("n_cameras", [2, 3, 5, 9])
def test_clean_points_lose_no_view(n_cameras: int, rng: np.random.Generator) -> None:
    lenses, poses = _rig(n_cameras)
    n_points = 20_000
    pixels = _projected(lenses, poses, _points(rng, n_points))
    pixels += rng.normal(0, _SIGMA_PX, pixels.shape)
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    doubted = found.inconsistent | ~found.used.all(axis=1)
    # the stated rate, 1e-3, within four sigmas of this many draws
    assert doubted.mean() == pytest.approx(1e-3, abs=4 * np.sqrt(1e-3 / n_points))
    assert not (found.small_angle | found.behind).any()


def _pair(baseline_m: float) -> tuple[list[Lens], list[Pose]]:
    lens = BrownConrady(fx=900, fy=900, cx=640, cy=480)
    return [lens, lens], [Pose.identity(), Pose(np.eye(3), np.array([-baseline_m, 0, 0]))]


def test_two_views_that_contradict_each_other(rng: np.random.Generator) -> None:
    lenses, poses = _pair(0.4)
    pixels = _projected(lenses, poses, _points(rng, 100))
    pixels[:50, 1, 1] += 5  # 25 sigmas across the row
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    assert found.inconsistent[:50].all()
    assert not found.inconsistent[50:].any()
    assert found.used.all()
    assert np.isfinite(found.points_ref).all()


def test_two_against_two_is_not_decided(rng: np.random.Generator) -> None:
    """Two cameras look at one thing, two at another."""
    lenses, poses = _rig(4)
    pixels = _projected(lenses, poses, _points(rng, 50))
    pixels[:, 2:] = _projected(lenses, poses, _points(rng, 50))[:, 2:]
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    assert (found.inconsistent | found.behind).all()
    assert found.used.all()


@pytest.mark.parametrize(("baseline_m", "fires"), [(0.002, True), (0.4, False)])
def test_small_angle(baseline_m: float, *, fires: bool, rng: np.random.Generator) -> None:
    lenses, poses = _pair(baseline_m)
    points = _MIDDLE + rng.uniform(-0.1, 0.1, (300, 3))
    pixels = _projected(lenses, poses, points) + rng.normal(0, _SIGMA_PX, (300, 2, 2))
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    there = np.isfinite(found.points_ref).all(axis=1)
    assert (found.small_angle[there] == fires).all()
    # sigma of depth: Z^2 sqrt(2) sigma / (f b), a tenth of Z at b = 5 mm
    share = np.sqrt(found.cov_m2[there, 2, 2]) / found.points_ref[there, 2]
    assert ((share > 0.1) == fires).all()


def test_angle_between_rays(rng: np.random.Generator) -> None:
    lenses, poses = _rig(4)
    points = _points(rng, 30)
    found = triangulate(_projected(lenses, poses, points), lenses, poses, cov_px2=_COV_PX2)
    rays = points[:, None] - np.stack([pose.inverse().trans_m for pose in poses])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    angles = np.arccos(np.einsum("nci,ndi->ncd", rays, rays).clip(-1, 1))
    np.testing.assert_allclose(found.angle_rad, angles.max(axis=(1, 2)), atol=1e-7)


def test_rays_that_do_not_meet_before_the_cameras() -> None:
    lenses, poses = _pair(0.4)
    pixels = np.array(
        [
            [[700.0, 480], [640, 480]],  # meet at 6 m
            [[640.0, 480], [700, 480]],  # meet behind
            [[640.0, 480], [640, 480]],  # parallel
            [[640.0, 480], [np.nan, np.nan]],  # one view
            [[np.nan, 480], [np.nan, 480]],  # none
        ]
    )
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=np.zeros((30, 30)))
    np.testing.assert_allclose(found.points_ref[0], [0.4, 0, 6], atol=1e-9)
    np.testing.assert_array_equal(found.behind, [False, True, True, False, False])
    np.testing.assert_array_equal(found.few_views, [False, False, False, True, True])
    for values in (found.points_ref, found.cov_m2, found.chi_square, found.d_points_d_cameras):
        assert values is not None
        assert np.isfinite(values[0]).all()
        assert np.isnan(values[1:]).all()
    assert not found.inconsistent.any()
    assert not found.small_angle.any()
    np.testing.assert_array_equal(found.freedom, [1, 1, 1, 0, 0])


def test_an_outlier_that_puts_the_point_behind(rng: np.random.Generator) -> None:
    """It is one like others: the remaining views say where the point is."""
    lenses, poses = _rig(4)
    points = _points(rng, 40)
    pixels = _projected(lenses, poses, points)
    pixels[:, 1] = [5, 480]
    found = triangulate(pixels, lenses, poses, cov_px2=_COV_PX2)
    np.testing.assert_allclose(found.points_ref, points, rtol=0, atol=1e-10)
    assert (found.used == [True, False, True, True]).all()


def test_no_points() -> None:
    lenses, poses = _rig(2)
    found: TriangulatedPoints = triangulate(np.empty((0, 2, 2)), lenses, poses, cov_px2=_COV_PX2)
    assert found.points_ref.shape == (0, 3)
    assert found.cov_m2.shape == (0, 3, 3)


def test_wrong_calls(rng: np.random.Generator) -> None:
    lenses, poses = _rig(3)
    pixels = _projected(lenses, poses, _points(rng, 4))
    with pytest.raises(ValueError, match="pixels: expected shape"):
        triangulate(pixels[:, :2], lenses, poses, cov_px2=_COV_PX2)
    with pytest.raises(ValueError, match="two or more cameras"):
        triangulate(pixels[:, :1], lenses[:1], poses[:1], cov_px2=_COV_PX2)
    with pytest.raises(ValueError, match="two or more cameras"):
        triangulate(pixels, lenses, poses[:2], cov_px2=_COV_PX2)
    with pytest.raises(ValueError, match="not positive definite"):
        triangulate(pixels, lenses, poses, cov_px2=-np.eye(2))
    with pytest.raises(ValueError, match="cameras_cov: expected shape"):
        triangulate(pixels, lenses, poses, cov_px2=_COV_PX2, cameras_cov=np.eye(7))

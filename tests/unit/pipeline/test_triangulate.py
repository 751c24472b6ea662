"""Points of pictures in the world, with covariances that hold."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.findings import finding
from calichrome.core.pose import Pose
from calichrome.errors import FileFormatError
from calichrome.geometry.lenses import BrownConrady
from calichrome.observations.points import ImagePoints
from calichrome.pipeline.triangulate import LocatedPoints, locate_points, point_table
from calichrome.rig import Camera, CameraCovariance, Evidence, Rig
from calichrome.target import chessboard

Seen = Callable[..., ImagePoints]

_PLACES = {
    "a": Pose.identity(),
    "b": Pose.from_rotvec([0, 0.3, 0], [-0.25, 0, 0.04]),
    "c": Pose.from_rotvec([0, -0.3, 0], [0.25, 0, 0.04]),
    "d": Pose.from_rotvec([0.2, 0, 0], [0, -0.15, 0.05]),
}
_WORLD = Pose.from_rotvec([1.2, -0.4, 0.3], [0.5, -1.0, 2.0])
_SIGMA_PX = 0.2


@pytest.fixture
def rig() -> Rig:
    lens = BrownConrady(fx=600, fy=601, cx=322, cy=238, k1=-0.2, k2=0.05)
    cameras = {
        name: Camera(
            size_wh=(640, 480),
            lens=lens,
            lens_sigma=dict.fromkeys(lens.NAMES),
            cam_from_ref=place,
            sigma_rad=None,
            sigma_m=None,
            n_views=12,
            n_corners=600,
            rms_px=_SIGMA_PX * np.sqrt(2),
        )
        for name, place in _PLACES.items()
    }
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="a",
        cameras=cameras,
        pairs=(),
        frames={},
        world_from_ref=_WORLD,
    )


@pytest.fixture
def points_ref(rng: np.random.Generator) -> FloatArray:
    return rng.uniform([-0.15, -0.1, 0.8], [0.15, 0.1, 1.2], (300, 3))


@pytest.fixture
def seen(rig: Rig, points_ref: FloatArray) -> Seen:
    def points(noise_px: FloatArray | float = 0.0, cameras: str = "abcd") -> ImagePoints:
        pixels = {name: rig.cameras[name].project(points_ref) for name in cameras}
        noise = np.broadcast_to(noise_px, (len(cameras), *points_ref.shape[:1], 2))
        return ImagePoints(
            names=tuple(("1", str(index)) for index in range(len(points_ref))),
            pixels={n: own + off for (n, own), off in zip(pixels.items(), noise, strict=True)},
            cov_px2={name: np.full((len(points_ref), 2, 2), np.nan) for name in cameras},
        )

    return points


def _evidence(covariance: CameraCovariance) -> Evidence:
    nothing = np.zeros(0)
    return Evidence(
        camera=(), frame=(), corner=nothing.astype(int), pixels=nothing, residuals_px=nothing,
        cov_px=nothing, inlier=nothing.astype(bool), lens_cov={}, pose_cov={}, joint=covariance,
    )  # fmt: skip


def _stated(points: ImagePoints, sigma_px: float) -> ImagePoints:
    cov = np.broadcast_to(sigma_px**2 * np.eye(2), (len(points.names), 2, 2))
    return replace(points, cov_px2=dict.fromkeys(points.pixels, cov))


def _surprise(found: LocatedPoints, truth_world: FloatArray) -> FloatArray:
    """Squared errors in units of their covariance, (N,): chi-square of 3 degrees of freedom."""
    off = found.points_world - truth_world
    return np.asarray(np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.cov_m2), off))


def test_places_are_those_of_the_world(rig: Rig, seen: Seen, points_ref: FloatArray) -> None:
    found = locate_points(rig, None, seen())
    np.testing.assert_allclose(found.points_world, _WORLD.apply(points_ref), atol=1e-9)
    assert found.cameras == ("a", "b", "c", "d")
    assert found.used.all()
    assert not any(found.remarks)
    assert not found.with_covariance
    np.testing.assert_allclose(found.residual_px, 0, atol=1e-6)


def test_errors_scatter_as_the_covariance_says(
    rig: Rig, seen: Seen, points_ref: FloatArray, rng: np.random.Generator
) -> None:
    """In the frame of the world, with pixels as noisy as the calibration's corners were."""
    noise = rng.normal(0, _SIGMA_PX, (4, len(points_ref), 2))
    found = locate_points(rig, None, seen(noise))
    surprise = _surprise(found, _WORLD.apply(points_ref))
    # the mean of 300 chi-squares of 3 has a sigma of 0.14; that of the noise found is 5 %
    assert surprise.mean() == pytest.approx(3, abs=0.6)
    assert found.sigma_px == pytest.approx(_SIGMA_PX, rel=0.15)
    # 8 coordinates less 3 unknowns; the mean of 300 chi-squares of 5 has a sigma of 3.7 %
    expected = 2 * _SIGMA_PX**2 * 5 / 8
    assert np.mean(found.residual_px**2) == pytest.approx(expected, rel=0.15)


def test_noise_that_nobody_stated_is_found(
    rig: Rig, seen: Seen, points_ref: FloatArray, rng: np.random.Generator
) -> None:
    """Clicked by hand: five times as noisy as corners, and one in twenty on another thing."""
    noise = rng.normal(0, 5 * _SIGMA_PX, (4, len(points_ref), 2))
    noise[1, ::20] += 40
    found = locate_points(rig, None, seen(noise))
    assert found.sigma_found
    assert not found.all_stated
    assert found.sigma_px == pytest.approx(5 * _SIGMA_PX, rel=0.15)
    assert found.left_out[::20, 1].mean() > 0.9
    surprise = _surprise(found, _WORLD.apply(points_ref))
    assert np.median(surprise) == pytest.approx(2.37, abs=0.5)  # of chi-square of 3


def test_few_points_cannot_tell_their_noise(rig: Rig, seen: Seen) -> None:
    points = seen(3.0)
    few = ImagePoints(
        names=points.names[:19],
        pixels={name: own[:19] for name, own in points.pixels.items()},
        cov_px2={name: own[:19] for name, own in points.cov_px2.items()},
    )
    found = locate_points(rig, None, few)
    assert not found.sigma_found
    assert found.sigma_px == pytest.approx(_SIGMA_PX)


def test_stated_noise_is_believed(rig: Rig, seen: Seen) -> None:
    found = locate_points(rig, None, _stated(seen(), 1.0))
    assert found.all_stated
    alone = locate_points(rig, None, seen())
    np.testing.assert_allclose(found.cov_m2, alone.cov_m2 / _SIGMA_PX**2, rtol=1e-6)


def test_the_doubts_of_the_calibration_count(
    rig: Rig, seen: Seen, points_ref: FloatArray, rng: np.random.Generator
) -> None:
    """Rigs drawn from their covariance scatter the points as stated."""
    sigma = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 0, 0, 0, 0, *[3e-4] * 3, *[3e-4] * 3])
    parameters = [*BrownConrady.NAMES, *(f"{k}_{axis}" for k in ("omega", "tau") for axis in "xyz")]
    free = {name: sigma * (np.arange(15) < 9 if name == "a" else 1) for name in rig.cameras}
    joint = CameraCovariance(
        camera=tuple(name for name in rig.cameras for _ in parameters),
        parameter=tuple(parameters * len(rig.cameras)),
        matrix=np.diag(np.concatenate([free[name] ** 2 for name in rig.cameras])),
    )
    surprises = []
    for _ in range(40):
        drawn = {}
        for name, camera in rig.cameras.items():
            step = rng.normal(0, 1, 15) * free[name]
            lens = BrownConrady.from_parameters(camera.lens.parameters + step[:9])
            place = camera.cam_from_ref.perturbed(step[9:])
            drawn[name] = replace(camera, lens=lens, cam_from_ref=place)
        noise = rng.normal(0, _SIGMA_PX, (4, len(points_ref), 2))
        points = _stated(seen(noise), _SIGMA_PX)
        found = locate_points(replace(rig, cameras=drawn), _evidence(joint), points)
        assert found.with_covariance
        surprises.append(_surprise(found, _WORLD.apply(points_ref)).mean())
    # points of one rig share its error: the mean of 40 draws of 3 has a sigma of at most 0.39
    assert np.mean(surprises) == pytest.approx(3, abs=0.8)


def test_an_unmeasured_board_leaves_the_scale_open(rig: Rig, seen: Seen) -> None:
    unsure = replace(rig, findings=(finding("scale_unverified", "nominal"),))
    found = locate_points(unsure, None, seen())
    distance = np.linalg.norm(found.points_world, axis=1)
    along = found.points_world / distance[:, None]
    variance = np.einsum("ni,nij,nj->n", along, found.cov_m2, along)
    exact = locate_points(rig, None, seen())
    variance -= np.einsum("ni,nij,nj->n", along, exact.cov_m2, along)
    np.testing.assert_allclose(np.sqrt(variance), 0.005 * distance, rtol=1e-9)


def test_outliers_and_doubts_are_said_of_each_point(rig: Rig, seen: Seen) -> None:
    points = seen()
    pixels = {name: own.copy() for name, own in points.pixels.items()}
    pixels["b"][0] += [9, 4]  # four cameras: the one that lies is told
    pixels["a"][1], pixels["b"][1] = np.nan, np.nan
    pixels["c"][1] += [0, 9]  # two cameras: which one lies is not
    for name in "abc":
        pixels[name][2] = np.nan
    pixels["a"][3] = pixels["b"][3] = np.nan
    pixels["c"][3] = rig.cameras["c"].project(np.array([0.0, 0, 900.0]))
    pixels["d"][3] = rig.cameras["d"].project(np.array([0.0, 0, 900.0]))
    found = locate_points(rig, None, replace(points, pixels=pixels))
    assert found.remarks[:4] == ((), ("inconsistent",), ("few_views",), ("small_angle",))
    assert found.left_out[0].tolist() == [False, True, False, False]
    assert not found.located[2]
    header, *rows = point_table(found)
    cells = [dict(zip(header, row, strict=True)) for row in rows]
    assert (cells[0]["cameras"], cells[0]["left_out"]) == ("a;c;d", "b")
    assert (cells[2]["x"], cells[2]["cameras"], cells[2]["remark"]) == ("", "d", "few_views")


def test_one_camera_is_not_enough(rig: Rig, seen: Seen) -> None:
    with pytest.raises(FileFormatError, match="only c has points"):
        locate_points(rig, None, seen(cameras="c"))

"""Fall-off of lenses: recovered from what several cameras see of one board in one instant."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calichrome.colour.light import Neighbourhoods
from calichrome.colour.shading import Vignetting
from calichrome.colour.shading_fit import VignettingFit, fit_vignetting
from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.detection import measure_discs
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import Image, open_recording
from calichrome.observations import BoardView, Dataset, DiscSamples
from calichrome.synthetic import Renderer, Scene, SceneCamera, picture, random_scene
from calichrome.synthetic.exposure import exposed
from calichrome.synthetic.scene import cosine_vignetting, irradiance
from calichrome.synthetic.visibility import project_visible
from calichrome.target import Target, load_target

_POWERS = (4.0, 2.0, 3.0, 1.0)
_NOISE = 0.003  # of a square's level, relative: 8 bits and some hundred pixels


def _log_gain(camera: SceneCamera, pixels: FloatArray) -> FloatArray:
    rays_cam = camera.lens.unproject(pixels)
    return np.log(cosine_vignetting(camera, rays_cam / rays_cam[..., 2:]))


def _scene(target: Target, n_cameras: int, seed: int) -> Scene:
    scene = random_scene(target, n_cameras, 12, (640, 480), seed=seed)
    cameras = tuple(
        replace(camera, vignetting_power=power)
        for camera, power in zip(scene.cameras, _POWERS, strict=False)
    )
    return exposed(replace(scene, cameras=cameras))


def _readings(scene: Scene, rng: np.random.Generator) -> Dataset:
    """White levels beside the discs as detection reads them, from the lamps of the scene.

    Channels see its two lamps in different shares, so that the colour of the light changes.
    """
    target, around = scene.target, Neighbourhoods.around_discs(scene.target)
    squares = np.column_stack([around.squares_board, np.zeros(len(around.squares_board))])
    views: dict[str, dict[str, BoardView]] = {}
    for index, camera in enumerate(scene.cameras):
        shares = np.array([[1.0, 0.7, 0.4], [0.3, 0.5, 0.9]]) + 0.04 * index
        shares = shares[[0, 1, 0, 1]]  # two lamps, two ambients
        views[camera.camera_id] = {}
        for frame, world_from_board in scene.world_from_board.items():
            points = world_from_board.apply(squares)
            seen = project_visible(camera, points)
            centres = project_visible(camera, world_from_board.apply(target.marker_centres_board))
            if not (np.isfinite(seen).all() and np.isfinite(centres).all()):
                continue
            light = irradiance(scene, points, -world_from_board.rotation[:, 2]) @ shares
            level = light * np.exp(_log_gain(camera, seen))[:, None]
            level *= 0.2 * rng.normal(1, _NOISE, level.shape)
            views[camera.camera_id][frame] = _view(centres, around.weights @ level)
    return Dataset(sizes_wh=dict.fromkeys(views, (640, 480)), views=views)


def _view(centres_px: FloatArray, white_rgb: FloatArray) -> BoardView:
    n = len(centres_px)
    discs = DiscSamples(
        marker_ids=np.arange(n),
        centres_px=centres_px,
        mean_rgb=white_rgb,
        median_rgb=white_rgb,
        cov_rgb=np.zeros((n, 3, 3)),
        n_px=np.full(n, 50),
        clipped=np.zeros(n),
        white_rgb=white_rgb,
        black_rgb=0.05 * white_rgb,
    )
    return BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)), discs=discs)


def _principal_points(scene: Scene) -> dict[str, FloatArray]:
    return {
        camera.camera_id: np.array([camera.lens.cx, camera.lens.cy]) for camera in scene.cameras
    }


def _covered(dataset: Dataset, camera_id: str) -> FloatArray:
    parts = [view.discs for view in dataset.views[camera_id].values()]
    return np.concatenate([discs.centres_px for discs in parts if discs is not None])


def _largest_error(
    fitted: VignettingFit | str, pixels: FloatArray, log_gain: Callable[[FloatArray], FloatArray]
) -> float:
    assert isinstance(fitted, VignettingFit), fitted
    off = np.log(fitted.vignetting.gain(pixels)) - log_gain(pixels)[:, None]
    return float(np.abs(off).max())


@pytest.mark.parametrize(("n_cameras", "seed"), [(2, 0), (2, 1), (4, 0)])
def test_fall_off_of_each_lens_is_recovered(
    n_cameras: int, seed: int, standard_target: Target, rng: np.random.Generator
) -> None:
    scene = _scene(standard_target, n_cameras, seed)
    dataset = _readings(scene, rng)
    fits = fit_vignetting(dataset, standard_target, _principal_points(scene))
    for camera in scene.cameras:
        pixels = _covered(dataset, camera.camera_id)
        error = _largest_error(fits[camera.camera_id], pixels, partial(_log_gain, camera))
        assert error < 0.01  # 30 to 50 % of fall-off; 0.2 to 0.6 % over ten seeds


def test_order_of_cameras_and_frames_does_not_matter(
    standard_target: Target, rng: np.random.Generator
) -> None:
    scene = _scene(standard_target, 2, 0)
    dataset, centres = _readings(scene, rng), _principal_points(scene)
    backwards = dataset.with_views(
        {
            camera: dict(reversed(list(dataset.views[camera].items())))
            for camera in reversed(dataset.cameras)
        }
    )
    first = fit_vignetting(dataset, standard_target, centres)
    second = fit_vignetting(backwards, standard_target, centres)
    for camera in dataset.cameras:
        a, b = first[camera], second[camera]
        assert isinstance(a, VignettingFit)
        assert isinstance(b, VignettingFit)
        np.testing.assert_allclose(a.vignetting.coefficients, b.vignetting.coefficients, atol=1e-6)


def test_exposure_does_not_matter(standard_target: Target, rng: np.random.Generator) -> None:
    scene = _scene(standard_target, 2, 0)
    dataset, centres = _readings(scene, rng), _principal_points(scene)
    brighter = {
        frame: _view(view.discs.centres_px, 1.7 * view.discs.white_rgb)
        for frame, view in dataset.views["cam1"].items()
        if view.discs is not None
    }
    other = dataset.with_views({"cam0": dataset.views["cam0"], "cam1": brighter})
    for camera in dataset.cameras:
        a = fit_vignetting(dataset, standard_target, centres)[camera]
        b = fit_vignetting(other, standard_target, centres)[camera]
        assert isinstance(a, VignettingFit)
        assert isinstance(b, VignettingFit)
        # weights follow the level, and the rounds end at 1 % of the variances
        np.testing.assert_allclose(a.vignetting.coefficients, b.vignetting.coefficients, atol=3e-3)


def test_a_shadow_on_one_camera_is_ignored(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """A hand before one lens: no light of the board explains it."""
    scene = _scene(standard_target, 2, 0)
    dataset = _readings(scene, rng)
    for frame in list(dataset.views["cam0"])[:3]:
        discs = dataset.views["cam0"][frame].discs
        assert discs is not None
        discs.white_rgb[5:15] *= 0.7
    fits = fit_vignetting(dataset, standard_target, _principal_points(scene))
    camera = scene.cameras[0]
    error = _largest_error(fits["cam0"], _covered(dataset, "cam0"), partial(_log_gain, camera))
    assert error < 0.015


def test_one_camera_cannot_tell(standard_target: Target, rng: np.random.Generator) -> None:
    dataset = _readings(_scene(standard_target, 2, 0), rng)
    alone = dataset.with_views({"cam0": dataset.views["cam0"]})
    assert "one camera alone" in str(fit_vignetting(alone, standard_target)["cam0"])
    frames = list(dataset.views["cam0"])
    apart = dataset.with_views(
        {
            "cam0": {name: dataset.views["cam0"][name] for name in frames[:6]},
            "cam1": {
                name: view for name, view in dataset.views["cam1"].items() if name not in frames[:6]
            },
        }
    )
    assert all(isinstance(item, str) for item in fit_vignetting(apart, standard_target).values())


def test_cameras_that_see_the_same_place_cannot_tell(
    standard_target: Target, rng: np.random.Generator
) -> None:
    """Twins at one place: any fall-off common to both cancels."""
    scene = _scene(standard_target, 2, 0)
    first = scene.cameras[0]
    twin = replace(first, camera_id="cam1")
    dataset = _readings(replace(scene, cameras=(first, twin)), rng)
    fits = fit_vignetting(dataset, standard_target, _principal_points(scene))
    assert all("stays open" in str(item) for item in fits.values())


@pytest.mark.slow
def test_error_is_what_sigma_says(standard_target: Target, rng: np.random.Generator) -> None:
    ratios = []
    for seed in range(4):
        scene = _scene(standard_target, 2, seed)
        dataset = _readings(scene, rng)
        for camera_id, fitted in fit_vignetting(
            dataset, standard_target, _principal_points(scene)
        ).items():
            pixels, camera = _covered(dataset, camera_id), scene.camera(camera_id)
            error = _largest_error(fitted, pixels, partial(_log_gain, camera))
            assert isinstance(fitted, VignettingFit)
            ratios.append(error / fitted.sigma)
    # the largest of some hundred places against the largest sigma: 1 to 2.5 of it
    assert 0.3 < np.mean(ratios) < 3


def _vignetting(*, covered_radius: float = 0.8) -> Vignetting:
    coefficients = np.array([[-0.5, 0.1, -0.05, 0.01, 0.0]] * 3) * [[1.0], [1.1], [0.9]]
    return Vignetting(
        centre_px=np.array([310.0, 250.0]),
        half_diagonal_px=400.0,
        coefficients=coefficients,
        covariance=np.repeat(1e-6 * np.eye(5)[None], 3, axis=0),
        covered_radius=covered_radius,
    )


def test_gain_is_its_formula() -> None:
    vignetting = _vignetting()
    u, v = 0.3, -0.4
    pixel = np.array([310 + 400 * u, 250 + 400 * v])
    expected = np.exp(1.1 * (-0.5 * 0.25 + 0.1 * 0.25**2 - 0.05 * 0.25**3 + 0.01 * u))
    np.testing.assert_allclose(vignetting.gain(pixel)[1], expected, rtol=1e-12)
    np.testing.assert_allclose(vignetting.gain(np.array([310.0, 250.0])), 1, rtol=1e-12)
    every = vignetting.gain_map((640, 480))
    assert every.shape == (480, 640, 3)
    np.testing.assert_allclose(every[90, 430], vignetting.gain(pixel), rtol=1e-12)


def test_gain_neither_jumps_nor_rises_outside_what_was_seen() -> None:
    for last in (-0.05, 2.0):  # a polynomial that falls, and one that would shoot up
        vignetting = replace(
            _vignetting(covered_radius=0.5), coefficients=np.array([[-0.5, 0.0, last, 0, 0]] * 3)
        )
        radius = np.linspace(0.5, 5, 200)
        pixels = np.array([310.0, 250.0]) + 400 * np.stack([radius, 0 * radius], axis=1)
        gain = vignetting.gain(pixels)[:, 0]
        inside = vignetting.gain(pixels[:1] - [1e-6, 0])[0, 0]
        assert gain[0] == pytest.approx(inside, rel=1e-6)
        assert (np.diff(gain) <= 1e-15).all()
        assert (gain > 0).all()


def test_json_keeps_everything() -> None:
    vignetting = _vignetting()
    again = Vignetting.from_json(json.loads(json.dumps(vignetting.to_json())))
    pixels = np.array([[0.0, 0.0], [639.0, 20.0]])
    np.testing.assert_array_equal(again.gain(pixels), vignetting.gain(pixels))
    np.testing.assert_array_equal(again.sigma(pixels), vignetting.sigma(pixels))


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="coefficients"):
        replace(_vignetting(), coefficients=np.zeros((3, 4)))
    with pytest.raises(ValueError, match="positive"):
        replace(_vignetting(), covered_radius=0.0)


@pytest.mark.slow
def test_fall_off_is_recovered_from_pictures(standard_target: Target) -> None:
    scene = _scene(standard_target, 2, 5)
    renderer = Renderer(scene)
    views: dict[str, dict[str, BoardView]] = {}
    for camera in scene.cameras:
        views[camera.camera_id] = {}
        for frame, world_from_board in scene.world_from_board.items():
            cam_from_board = camera.cam_from_world @ world_from_board
            pixels = picture(renderer, camera.camera_id, frame)
            image = Image(pixels=pixels, encoding=camera.encoding, bits=camera.bits)
            views[camera.camera_id][frame] = _measured(
                image, standard_target, camera.lens, cam_from_board
            )
    dataset = Dataset(sizes_wh=dict.fromkeys(views, (640, 480)), views=views)
    fits = fit_vignetting(dataset, standard_target, _principal_points(scene))
    for camera in scene.cameras:
        pixels_px = _covered(dataset, camera.camera_id)
        error = _largest_error(fits[camera.camera_id], pixels_px, partial(_log_gain, camera))
        assert error < 0.015


def _measured(image: Image, target: Target, lens: BrownConrady, pose: Pose) -> BoardView:
    def to_pixels(points_board: FloatArray) -> FloatArray:
        return lens.project(pose.apply(points_board))

    discs = measure_discs(image, target, to_pixels, None)
    return BoardView(corner_ids=np.arange(0), corners_px=np.zeros((0, 2)), discs=discs)


def test_practice_recording_gives_its_fall_off(data: Path) -> None:
    """Two cameras 10 cm apart, two lamps; its `vignette_power` p means (1 + r^2)^-p = cos^2p.

    (So its irradiances say: with 2p they leave 0.3 % of the white squares' levels, with p 2 %.)
    """
    folder = data / "render"
    truth = json.loads((folder / "truth.json").read_text())
    target, recording = load_target(folder / "target.json"), open_recording(folder / "recording")
    views: dict[str, dict[str, BoardView]] = {name: {} for name in truth["cameras"]}
    lenses = {}
    for name, entry in truth["cameras"].items():
        k1, k2, p1, p2, k3 = entry["dist"]
        (fx, _, cx), (_, fy, cy), _ = entry["K"]
        lenses[name] = BrownConrady(fx=fx, fy=fy, cx=cx, cy=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    for item in truth["images"]:
        matrix = np.array(item["cam_from_board"])
        frame = f"{item['pose']:03d}"
        image = recording.read(item["camera"], frame)
        assert isinstance(image, Image)
        views[item["camera"]][frame] = _measured(
            image, target, lenses[item["camera"]], Pose(matrix[:3, :3], matrix[:3, 3])
        )
    dataset = Dataset(sizes_wh=dict.fromkeys(views, (1280, 960)), views=views)
    centres = {name: np.array([lens.cx, lens.cy]) for name, lens in lenses.items()}
    fits = fit_vignetting(dataset, target, centres)
    for name, lens in lenses.items():
        power = truth["cameras"][name]["vignette_power"]

        def log_gain(
            pixels: FloatArray, lens: BrownConrady = lens, power: float = power
        ) -> FloatArray:
            rays_cam = lens.unproject(pixels)
            return np.asarray(-power * np.log((rays_cam**2).sum(axis=-1) / rays_cam[..., 2] ** 2))

        assert _largest_error(fits[name], _covered(dataset, name), log_gain) < 0.02

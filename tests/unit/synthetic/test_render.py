from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import erf

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic import (
    Ambient,
    Light,
    Renderer,
    Scene,
    SceneCamera,
    SceneError,
    render_frame,
    truth_of,
)
from calichrome.synthetic.scene import irradiance
from calichrome.synthetic.spectra import camera_response, printed_palette


def _saddle(window: FloatArray) -> FloatArray:
    """Stationary point of a quadric through an odd square window, x then y about its centre."""
    half = window.shape[0] // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).astype(float)
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weight = np.exp(-(x * x + y * y) / 4)[:, None]
    c = np.linalg.lstsq(design * weight, window.ravel() * weight[:, 0], rcond=None)[0]
    matrix = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    return np.asarray(np.linalg.solve(matrix, -c[1:3]))


def test_corners_are_where_the_truth_says(clean_pair: Scene, clean_renderer: Renderer) -> None:
    truth = truth_of(clean_pair)
    errors = []
    for (camera_id, frame_id), image in list(truth.images.items())[::3]:
        if not image.whole:
            continue
        green = clean_renderer.electrons(camera_id, frame_id)[..., 1]
        for corner in image.corners_px:
            x, y = np.round(corner).astype(int)
            window = green[y - 3 : y + 4, x - 3 : x + 4]
            errors.append(_saddle(window) - (corner - [x, y]))
    errors_px = np.array(errors)
    # A quadric is not the saddle's shape: single corners are off by up to a tenth of a pixel, but
    # the same to all sides: the mean of 80 scatters by 0.004. A shift of half a sample (0.125 px)
    # or of half a pixel would show.
    assert len(errors_px) >= 80
    assert np.abs(errors_px.mean(axis=0)).max() < 0.012
    assert np.abs(np.median(errors_px, axis=0)).max() < 0.012
    assert np.sqrt((errors_px**2).mean()) < 0.05


def test_discs_are_where_the_truth_says(clean_pair: Scene, clean_renderer: Renderer) -> None:
    """Centre of brightness of a disc, against the image of its circle found by the lens."""
    scene = clean_pair
    truth = truth_of(scene)
    camera_id = scene.cameras[0].camera_id
    frame_id = truth.whole_views(camera_id)[0]
    camera = scene.camera(camera_id)
    plain = replace(scene, target=replace(scene.target, markers=()))
    with_discs = clean_renderer.electrons(camera_id, frame_id)
    change = with_discs - render_frame(plain, camera_id, frame_id)
    cam_from_board = camera.cam_from_world @ scene.world_from_board[frame_id]
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for marker, centre in zip(scene.target.markers, scene.target.marker_centres_board, strict=True):
        rim = camera.lens.project(cam_from_board.apply(centre + marker.diameter_m / 2 * circle))
        x0, y0 = np.floor(rim.min(axis=0)).astype(int) - 4
        x1, y1 = np.ceil(rim.max(axis=0)).astype(int) + 5
        weight = change[y0:y1, x0:x1].sum(axis=-1)
        y, x = np.mgrid[y0:y1, x0:x1]
        found = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        # Area centroid of the polygon; the light's slope over a disc moves it by some 0.01 px.
        ax, ay = rim.T
        bx, by = np.roll(rim, -1, axis=0).T
        cross = ax * by - bx * ay
        expected = [((ax + bx) * cross).sum(), ((ay + by) * cross).sum()] / (3 * cross.sum())
        np.testing.assert_allclose(found, expected, atol=0.03)


def test_surfaces_have_their_spectral_colours(clean_pair: Scene, clean_renderer: Renderer) -> None:
    """In the middle of a disc and of a blank square: light x reflectance x sensor, nothing else."""
    scene, truth = clean_pair, truth_of(clean_pair)
    target = scene.target
    for camera in scene.cameras:
        frame_id = truth.whole_views(camera.camera_id)[0]
        electrons = clean_renderer.electrons(camera.camera_id, frame_id)
        palette = printed_palette(target)
        response = camera_response(scene, camera.sensor.sensitivity, palette.surfaces)
        pose = scene.world_from_board[frame_id]
        blank = np.array([[7.5, 3.5, 0], [6.5, 3.5, 0]]) * target.square_m[0]  # [8, 4], [7, 4]
        points = np.concatenate([blank, target.marker_centres_board])
        surfaces = [0 if target.square_colour(8, 4) == "white" else 1]
        surfaces += [1 - surfaces[0], *range(2, 2 + len(target.markers))]
        light = irradiance(scene, pose.apply(points), -pose.rotation[:, 2])
        pixels = camera.lens.project(camera.cam_from_world.apply(pose.apply(points)))
        for surface, sources, (x, y) in zip(surfaces, light, pixels, strict=True):
            expected = camera.exposure_e * (sources @ response[surface])
            found = electrons[round(float(y)), round(float(x))]
            # half a pixel from the point: the light changes by less than 0.5 % there
            np.testing.assert_allclose(found, expected, rtol=0.005)


def test_irradiance_follows_square_and_cosines(pair: Scene) -> None:
    lamp = Light(spectrum="D65", power=8.0, centre_world=(0, 0, 0), axis_world=(0, 0, 2))
    ambient = Ambient(spectrum="A", irradiance=0.3)
    scene = replace(pair, lights=(lamp,), ambients=(ambient,))
    facing = np.array([0, 0, -1.0])
    points = np.array([[0, 0, 1.0], [0, 0, 2.0], [1, 0, 1.0], [0, 0, -1.0]])
    # On the axis 8 / d^2; at 45 degrees cos^4 of 8; behind the lamp nothing
    np.testing.assert_allclose(
        irradiance(scene, points, facing), [[8, 0.3], [2, 0.3], [2, 0.3], [0, 0.3]], atol=1e-12
    )
    assert irradiance(scene, points[:1], -facing)[0, 0] == 0  # lit from behind


def test_vignetting_is_a_power_of_the_cosine(clean_pair: Scene, clean_renderer: Renderer) -> None:
    camera = clean_pair.cameras[0]
    frame_id = next(iter(clean_pair.world_from_board))
    dark = replace(clean_pair, cameras=(replace(camera, vignetting_power=3.0),))
    clean = clean_renderer.electrons(camera.camera_id, frame_id)
    ratio = render_frame(dark, camera.camera_id, frame_id) / clean
    rays = camera.lens.unproject(np.array([[0.0, 0.0], [479.0, 100.0]]))
    cosines = 1 / np.linalg.norm(rays, axis=1)
    np.testing.assert_allclose(ratio[0, 0], cosines[0] ** 3, rtol=1e-12)
    np.testing.assert_allclose(ratio[100, 479], cosines[1] ** 3, rtol=1e-12)


def test_flare_adds_a_share_of_the_mean(clean_pair: Scene, clean_renderer: Renderer) -> None:
    camera = clean_pair.cameras[0]
    frame_id = next(iter(clean_pair.world_from_board))
    hazy = replace(clean_pair, cameras=(replace(camera, flare=0.02),))
    clean = clean_renderer.electrons(camera.camera_id, frame_id)
    added = render_frame(hazy, camera.camera_id, frame_id) - clean
    expected = np.broadcast_to(0.02 * clean.mean(axis=(0, 1)), added.shape)
    np.testing.assert_allclose(added, expected, rtol=1e-9)


def test_exposure_puts_the_brightest_white_at_85_percent(pair: Scene) -> None:
    for camera in pair.cameras:
        levels = camera.exposure_e / camera.sensor.full_well_e * np.array(camera.white_balance)
        assert min(camera.white_balance) == pytest.approx(1)
        renderer = Renderer(replace(pair, target=replace(pair.target, markers=())))
        brightest = max(
            float((renderer.electrons(camera.camera_id, frame) / camera.exposure_e * levels).max())
            for frame in pair.world_from_board
        )
        # 0.85 unless a disc lighter than the paper sets the level; flare adds under 1 %.
        assert 0.78 < brightest < 0.87


def test_cameras_see_the_surroundings_with_parallax(clean_pair: Scene) -> None:
    """The surroundings are things in space: the same in all frames, not the same to a neighbour."""
    frames = list(clean_pair.world_from_board)
    camera = clean_pair.cameras[0]
    aside = replace(
        camera,
        camera_id="aside",
        cam_from_world=Pose(np.eye(3), np.array([-0.1, 0, 0])) @ camera.cam_from_world,
    )
    both = replace(clean_pair, cameras=(camera, aside))
    renderer = Renderer(both)
    first = renderer.electrons(camera.camera_id, frames[0])
    second = renderer.electrons(camera.camera_id, frames[1])
    same = np.isclose(first, second, rtol=1e-9).all(axis=-1).mean()
    assert same > 0.4
    moved = renderer.electrons("aside", frames[0])
    assert np.isclose(first, moved, rtol=1e-3).all(axis=-1).mean() < 0.2


def test_lens_that_folds_inside_the_picture_is_refused(clean_pair: Scene) -> None:
    camera = clean_pair.cameras[0]
    folded = BrownConrady(fx=400, fy=400, cx=320, cy=240, k1=-0.9)
    bad: tuple[SceneCamera, ...] = (replace(camera, lens=folded),)
    with pytest.raises(SceneError, match="folds inside the picture"):
        render_frame(replace(clean_pair, cameras=bad), camera.camera_id, "000")


def test_blur_of_a_rendered_edge_is_the_cameras(
    clean_pair: Scene, clean_renderer: Renderer
) -> None:
    """Through lens, perspective and light: fit an erf across the paper's first vertical line."""
    truth = truth_of(clean_pair)
    camera = clean_pair.cameras[0]
    frame_id = truth.whole_views(camera.camera_id)[0]
    green = clean_renderer.electrons(camera.camera_id, frame_id)[..., 1]
    corners = truth.images[camera.camera_id, frame_id].corners_px.reshape(5, 8, 2)
    middle = (corners[2, 3] + corners[3, 3]) / 2
    along = corners[3, 3] - corners[2, 3]
    normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    x, y = np.meshgrid(np.arange(-5, 6), np.arange(-2, 3))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2) + np.round(middle).astype(int)
    distance = (pixels - middle) @ normal
    values = green[pixels[:, 1], pixels[:, 0]]

    def residuals(p: FloatArray) -> FloatArray:
        edge = erf((distance - p[0]) / (np.sqrt(2) * p[1]))
        return np.asarray(p[2] + p[3] * distance + (p[4] + p[5] * distance) * edge - values)

    start = [0.0, 0.7, values.mean(), 0.0, np.ptp(values) / 2 * np.sign(distance @ values), 0.0]
    fit = least_squares(residuals, start, x_scale=[1, 1, 100, 10, 100, 10])
    expected = np.sqrt(camera.psf_sigma_px**2 + 1 / 12)  # the pixel's own variance is 1/12
    assert fit.x[1] == pytest.approx(expected, rel=0.02)
    # The lens bows the line by less than 0.02 px between two corners.
    assert abs(fit.x[0]) < 0.02


def test_a_board_whose_horizon_is_in_the_picture_renders_finite(clean_pair: Scene) -> None:
    frame_id = next(iter(clean_pair.world_from_board))
    camera = clean_pair.cameras[0]
    # 65 degrees of tilt, near: the plane's horizon crosses the box around the board
    tilt = Rotation.from_euler("y", 65, degrees=True).as_matrix()
    middle = clean_pair.target.corners_board.mean(axis=0)
    near = Pose(tilt, np.array([0.0, 0.0, 0.35]) - tilt @ middle)
    scene = replace(
        clean_pair,
        world_from_board={frame_id: camera.cam_from_world.inverse() @ near},
    )
    assert np.isfinite(Renderer(scene).electrons(camera.camera_id, frame_id)).all()


def test_back_of_the_board_is_plain(pair: Scene) -> None:
    frame_id, world_from_board = next(iter(pair.world_from_board.items()))
    middle = pair.target.corners_board.mean(axis=0)
    half_turn = Pose.from_rotvec([0, np.pi, 0], [2 * middle[0], 0, 0])
    turned = replace(pair, world_from_board={frame_id: world_from_board @ half_turn})
    camera_id = pair.cameras[0].camera_id
    front, back = (render_frame(scene, camera_id, frame_id) for scene in (pair, turned))
    inner = truth_of(pair).images[camera_id, frame_id].corners_px
    x, y = np.nanmean(inner, axis=0).round().astype(int)
    part = slice(y - 20, y + 21), slice(x - 20, x + 21)
    steps = [np.abs(np.diff(picture[part], axis=1)).max() for picture in (front, back)]
    assert steps[1] < 0.02 * steps[0]  # shading alone
    assert np.isnan(truth_of(turned).images[camera_id, frame_id].corners_px).all()

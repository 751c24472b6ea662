"""Disc colours and the light beside them, against the spectra that were rendered."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray, IntArray
from calichrome.detection import detect_board
from calichrome.detection.board_map import BoardMap
from calichrome.detection.discs import measure_discs
from calichrome.imaging import Image
from calichrome.observations import BoardView, DiscSamples
from calichrome.synthetic import Renderer, Scene, SceneCamera, random_scene, truth_of
from calichrome.synthetic.sensor import develop
from calichrome.synthetic.spectra import camera_response, printed_palette
from calichrome.target import Target

Rendered = Callable[..., tuple[Image, FloatArray, Scene]]


def _discs(image: Image, target: Target) -> DiscSamples:
    found = detect_board(image, target)
    assert isinstance(found, BoardView)
    assert found.discs is not None
    return found.discs


def _true_rgb(scene: Scene) -> FloatArray:
    """White, black and the discs as shares of full scale, (2 + n, 3)."""
    camera = scene.cameras[0]
    surfaces = printed_palette(scene.target).surfaces
    response = camera_response(scene, camera.sensor.sensitivity, surfaces)[:, 0]
    share = camera.exposure_e / camera.sensor.full_well_e
    return np.asarray(share * response * np.array(camera.white_balance))


def test_discs_in_even_light(render: Rendered, standard_target: Target) -> None:
    image, _, scene = render(standard_target, tilt_deg=25)
    discs = _discs(image, standard_target)
    true = _true_rgb(scene)
    n = len(standard_target.markers)
    np.testing.assert_array_equal(discs.marker_ids, np.arange(n))
    # 1 % of each value, and of full scale where a channel is next to nothing
    np.testing.assert_allclose(discs.mean_rgb, true[2:], rtol=0.01, atol=1e-3)
    np.testing.assert_allclose(discs.median_rgb, true[2:], rtol=0.01, atol=1e-3)
    assert (discs.clipped == 0).all()
    assert (discs.n_px >= 9).all()


def test_local_white_and_black(render: Rendered, standard_target: Target) -> None:
    image, _, scene = render(standard_target, tilt_deg=25)
    discs = _discs(image, standard_target)
    true = _true_rgb(scene)
    n = len(standard_target.markers)
    np.testing.assert_allclose(discs.white_rgb, np.tile(true[0], (n, 1)), rtol=0.01)
    # black is 20 times darker than its neighbours: half a per cent of white leaks in
    np.testing.assert_allclose(discs.black_rgb, np.tile(true[1], (n, 1)), rtol=0.1)


def test_centres(render: Rendered, standard_target: Target) -> None:
    """From the squares' own corners, without knowing the lens."""
    image, _, scene = render(standard_target, tilt_deg=30)
    true_px = truth_of(scene).images["cam0", "0"].marker_centres_px
    error_px = np.linalg.norm(_discs(image, standard_target).centres_px - true_px, axis=1)
    # second order of the distortion over a square of 20 px; squares at the rim are extrapolated
    assert error_px.max() < 0.3


def test_clipped_discs_are_flagged(render: Rendered, standard_target: Target) -> None:
    image, _, scene = render(standard_target, gain=1.3)
    discs = _discs(image, standard_target)
    true = 1.3 * _true_rgb(scene)[2:].max(axis=1)
    assert (true > 1.02).any()
    assert (discs.clipped[true > 1.02] > 0.9).all()
    assert (discs.clipped[true < 0.95] == 0).all()


def test_clipped_white_is_unknown(render: Rendered, standard_target: Target) -> None:
    image, _, scene = render(standard_target, gain=1.5)
    assert (1.5 * _true_rgb(scene)[0]).max() > 1.05
    discs = _discs(image, standard_target)
    assert np.isnan(discs.white_rgb).all()
    assert np.isfinite(discs.black_rgb).all()


def test_something_on_a_disc_is_left_out(render: Rendered, standard_target: Target) -> None:
    """A scratch across a disc is no part of the region that grows from its middle."""
    image, _, scene = render(standard_target)
    clean = _discs(image, standard_target)
    pixels = image.pixels.copy()
    marker = 5
    x, y = np.rint(clean.centres_px[marker]).astype(int)
    pixels[y - 12 : y + 12, x + 3] = 0
    spoiled = _discs(replace(image, pixels=pixels), standard_target)
    assert spoiled.n_px[marker] < clean.n_px[marker]
    expected = _true_rgb(scene)[2 + marker]
    np.testing.assert_allclose(spoiled.mean_rgb[marker], expected, rtol=0.01, atol=1e-3)


def _covered(image: Image, centre_px: FloatArray, radius_px: float, rgb: FloatArray) -> Image:
    y, x = np.mgrid[: image.size_wh[1], : image.size_wh[0]]
    hand = np.hypot(x - centre_px[0], y - centre_px[1]) < radius_px
    return replace(image, pixels=np.where(hand[..., None], rgb.astype(np.float32), image.pixels))


def _measured(
    image: Image, target: Target, corners_px: FloatArray, corner_ids: IntArray | None = None
) -> DiscSamples:
    lattice = target.corners_board[:, :2] / target.square_m
    board_map = BoardMap.fit(lattice, corners_px, image.size_wh)
    return measure_discs(
        image, target, lambda points: board_map(points[:, :2] / target.square_m), corner_ids
    )


def test_discs_of_hidden_squares_are_absent(render: Rendered, standard_target: Target) -> None:
    """A hand of the colour of a disc: its square lacks corners, so nothing there counts."""
    image, corners_px, _ = render(standard_target)
    clean = _measured(image, standard_target, corners_px)
    hand_px = clean.centres_px[11]
    side = float(np.linalg.norm(corners_px[1] - corners_px[0]))
    found = np.flatnonzero(np.linalg.norm(corners_px - hand_px, axis=1) > side)
    assert len(found) <= standard_target.n_corners - 2
    covered = _covered(image, hand_px, side, clean.mean_rgb[11])
    discs = _measured(covered, standard_target, corners_px, found)
    assert 11 not in discs.marker_ids
    kept = np.isin(clean.marker_ids, discs.marker_ids)
    assert kept.sum() >= len(clean) - 9
    np.testing.assert_allclose(discs.mean_rgb, clean.mean_rgb[kept], rtol=1e-3, atol=1e-4)
    # nor does the hand tell the light of its neighbours
    known = np.isfinite(discs.white_rgb).all(axis=1)
    assert known.mean() > 0.9
    np.testing.assert_allclose(discs.white_rgb[known], clean.white_rgb[kept][known], rtol=0.02)


def test_discs_with_something_beside_them_are_absent(
    render: Rendered, standard_target: Target
) -> None:
    """Where all corners are guessed, the square itself shows that it is covered."""
    image, corners_px, _ = render(standard_target)
    clean = _measured(image, standard_target, corners_px)
    side = float(np.linalg.norm(corners_px[1] - corners_px[0]))
    skin = np.array([0.3, 0.2, 0.15])
    for marker in (3, 17, 30):
        covered = _covered(image, clean.centres_px[marker], 0.8 * side, skin)
        assert marker not in _measured(covered, standard_target, corners_px).marker_ids


def test_discs_cut_by_the_picture_are_absent(render: Rendered, standard_target: Target) -> None:
    image, corners_px, _ = render(standard_target)
    clean = _measured(image, standard_target, corners_px)
    cut = round(float(np.median(clean.centres_px[:, 0])))
    pixels = np.ascontiguousarray(image.pixels[:, cut:])
    moved = corners_px - [cut, 0]
    found = np.flatnonzero(moved[:, 0] > 0)
    discs = _measured(replace(image, pixels=pixels), standard_target, moved, found)
    assert 0 < len(discs) < len(clean)
    assert (discs.centres_px[:, 0] > 0).all()
    kept = np.isin(clean.marker_ids, discs.marker_ids)
    np.testing.assert_allclose(discs.mean_rgb, clean.mean_rgb[kept], rtol=1e-6)


def test_highlights_do_not_count(render: Rendered, standard_target: Target) -> None:
    image, corners_px, scene = render(standard_target)
    clean = _measured(image, standard_target, corners_px)
    marker = 7
    spot_px = clean.centres_px[marker] + [2.5, -2.0]
    lit = clean.mean_rgb[marker] + 0.3
    shiny = _measured(_covered(image, spot_px, 1.2, lit), standard_target, corners_px)
    expected = _true_rgb(scene)[2 + marker]
    at = int(np.flatnonzero(shiny.marker_ids == marker)[0])
    np.testing.assert_allclose(shiny.mean_rgb[at], expected, rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("mosaic", [True, False])
def test_covariance_of_the_mean(
    standard_target: Target,
    mosaic: bool,  # noqa: FBT001
    rng: np.random.Generator,
) -> None:
    """Squared errors of means, in units of the variance that is reported, average to one.

    Demosaiced pixels repeat each other, so they may not be taken as independent.
    """
    scene = random_scene(standard_target, 1, 1, (960, 720), seed=4, mosaic=mosaic)
    camera = scene.cameras[0]
    frame = next(iter(scene.world_from_board))
    electrons = Renderer(scene).electrons("cam0", frame)
    corners_px = truth_of(scene).images["cam0", frame].corners_px
    quiet = replace(camera, sensor=replace(camera.sensor, noise=False, adc_bits=None))

    def measured(of_camera: SceneCamera) -> DiscSamples:
        pixels = np.clip(develop(electrons, of_camera, rng), 0, 1).astype(np.float32)
        image = Image(pixels=pixels, encoding="linear", bits=32)
        return _measured(image, standard_target, corners_px)

    true = measured(quiet)
    squared = []
    for _ in range(6):
        discs = measured(camera)
        _, here, there = np.intersect1d(
            discs.marker_ids, true.marker_ids, return_indices=True, assume_unique=True
        )
        error = discs.mean_rgb[here] - true.mean_rgb[there]
        variance = np.einsum("nii->ni", discs.cov_rgb[here]) / discs.n_px[here, None]
        squared.append(error**2 / variance)
    # 288 discs: the mean is known to 8 %; the number of pixels that repeat each other to 20 %
    assert 0.7 < np.concatenate(squared).mean() < 1.4

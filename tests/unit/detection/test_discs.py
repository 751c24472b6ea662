"""Disc colours and the light beside them, against the spectra that were rendered."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.detection import detect_board
from calichrome.imaging import Image
from calichrome.observations import BoardView, DiscSamples
from calichrome.synthetic import Scene, truth_of
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

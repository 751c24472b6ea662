from dataclasses import replace

import numpy as np
import pytest

from calichrome.colorimetry.encoding import linearise
from calichrome.core.pose import Pose
from calichrome.geometry.lenses import BrownConrady
from calichrome.synthetic import SceneCamera, SceneSensor
from calichrome.synthetic.sensor import demosaic, develop, expose, mosaic, stored

_CAMERA = SceneCamera(
    camera_id="a",
    size_wh=(60, 40),
    lens=BrownConrady(fx=50, fy=50, cx=30, cy=20),
    cam_from_world=Pose.identity(),
    sensor=SceneSensor(sensitivity="Nikon 5100 (NPL)", full_well_e=8000, read_noise_e=20),
)


def test_mosaic_is_rggb() -> None:
    rgb = np.tile([1.0, 2.0, 3.0], (4, 4, 1))
    np.testing.assert_array_equal(mosaic(rgb)[:2, :2], [[1, 2], [2, 3]])


@pytest.mark.parametrize("colour", [(0.2, 0.5, 0.9), (1.0, 0.0, 0.0)])
def test_demosaic_keeps_a_constant_everywhere(colour: tuple[float, float, float]) -> None:
    rgb = np.tile(colour, (11, 14, 1))  # odd height: the border keeps the filters' order
    np.testing.assert_allclose(demosaic(mosaic(rgb)), rgb, atol=1e-14)


def test_demosaic_keeps_a_grey_ramp() -> None:
    """The kernels are symmetric and sum to one: what is linear is exact, away from the border."""
    y, x = np.mgrid[:20, :24]
    rgb = np.repeat((0.1 + 0.02 * x - 0.013 * y)[..., None], 3, axis=-1)
    inner = slice(2, -2)
    np.testing.assert_allclose(demosaic(mosaic(rgb))[inner, inner], rgb[inner, inner], atol=1e-14)


def test_demosaic_kernels_of_the_paper() -> None:
    """Response to one red, one green and one blue photosite: figure 2 of the paper, in eighths."""
    raw = np.zeros((12, 12))
    raw[4, 4] = 8  # a red photosite
    red, green, blue = np.moveaxis(demosaic(raw), -1, 0)
    np.testing.assert_allclose(red[4:6, 4:7], [[8, 4, 0], [4, 2, 0]], atol=1e-12)
    np.testing.assert_allclose(green[4, 2:7], [-1, 0, 4, 0, -1], atol=1e-12)
    np.testing.assert_allclose(blue[4, 2:7], [-1.5, 0, 6, 0, -1.5], atol=1e-12)
    assert blue[4, 5] == 0  # blue lies above and below a green of a red row, not beside it
    raw = np.zeros((12, 12))
    raw[4, 5] = 8  # a green photosite of a red row
    red, green, blue = np.moveaxis(demosaic(raw), -1, 0)
    np.testing.assert_allclose(red[4, 3:8], [-1, 0, 5, 0, -1], atol=1e-12)
    np.testing.assert_allclose(blue[2:7, 5], [-1, 0, 5, 0, -1], atol=1e-12)
    np.testing.assert_allclose(red[2:7, 5], [0.5, 0, 5, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(green[4, 4:7], [2, 8, 2], atol=1e-12)


@pytest.mark.parametrize("electrons", [0.0, 300.0, 5000.0])
def test_noise_is_shot_and_read_noise(electrons: float, rng: np.random.Generator) -> None:
    sensor = replace(_CAMERA.sensor, adc_bits=None)
    read_out = expose(np.full(400_000, electrons), sensor, rng) * sensor.full_well_e
    expected = electrons + sensor.read_noise_e**2
    # 5 sigma of a variance of 400000 values: 5 sqrt(2 / n) = 1.1 %
    assert read_out.var() == pytest.approx(expected, rel=0.012)
    assert read_out.mean() == pytest.approx(electrons, abs=5 * np.sqrt(expected / 400_000))


def test_converter_steps_and_clipping(rng: np.random.Generator) -> None:
    sensor = replace(_CAMERA.sensor, noise=False, adc_bits=12)
    electrons = np.linspace(0, 2 * sensor.full_well_e, 20_000)
    read_out = expose(electrons, sensor, rng)
    steps = np.unique(read_out)
    np.testing.assert_allclose(np.diff(steps), 1 / (4095 - 64))
    assert (read_out.min(), read_out.max()) == (0, 1)
    below = electrons < sensor.full_well_e
    half_step = 0.5 / (4095 - 64)
    assert np.abs(read_out - electrons / sensor.full_well_e)[below].max() <= half_step * 1.0001


def test_noise_in_the_dark_is_not_cut(rng: np.random.Generator) -> None:
    """The black level keeps it unbiased; without, its mean would be 0.4 of its deviation."""
    read_out = expose(np.zeros(100_000), _CAMERA.sensor, rng) * _CAMERA.sensor.full_well_e
    assert abs(read_out.mean()) < 5 * 20 / np.sqrt(100_000)


@pytest.mark.parametrize(("encoding", "bits"), [("srgb", 8), ("linear", 16)])
def test_stored_numbers_read_back(encoding: str, bits: int, rng: np.random.Generator) -> None:
    camera = replace(
        _CAMERA,
        sensor=replace(_CAMERA.sensor, noise=False, mosaic=False, adc_bits=None),
        white_balance=(2.0, 1.0, 1.5),
        encoding="srgb" if encoding == "srgb" else "linear",
        bits=8 if bits == 8 else 16,
    )
    electrons = np.full((4, 5, 3), 2000.0)  # a quarter of the full well
    numbers = stored(develop(electrons, camera, rng), camera)
    assert numbers.dtype == (np.uint8 if bits == 8 else np.uint16)
    linear = linearise(numbers / float(2**bits - 1), camera.encoding)
    np.testing.assert_allclose(linear[0, 0], [0.5, 0.25, 0.375], atol=0.005 if bits == 8 else 1e-5)


def test_psf_narrower_than_the_samples_is_refused() -> None:
    with pytest.raises(ValueError, match="psf_sigma_px"):
        replace(_CAMERA, psf_sigma_px=0.1)

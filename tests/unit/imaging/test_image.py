"""What the numbers of a picture mean."""

import numpy as np
import pytest

from calichrome.colorimetry.encoding import EncodingName, linearise
from calichrome.imaging import Image, Pixels


def _image(pixels: Pixels, encoding: EncodingName, bits: int | None = None) -> Image:
    return Image(pixels=pixels, encoding=encoding, bits=bits or 8 * pixels.dtype.itemsize)


def test_linear_of_8_bit_srgb() -> None:
    pixels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    expected = linearise(pixels / 255, "srgb")
    linear = _image(pixels, "srgb").linear()
    assert linear.shape == (16, 16, 3)
    np.testing.assert_allclose(linear, np.repeat(expected[..., None], 3, axis=2), atol=1e-15)


@pytest.mark.parametrize(("bits", "top"), [(16, 65535), (12, 4095), (10, 1023)])
def test_linear_of_16_bit(bits: int, top: int) -> None:
    pixels = np.array([[[0, top // 2, top]]], dtype=np.uint16)
    linear = _image(pixels, "linear", bits).linear()
    np.testing.assert_allclose(linear[0, 0], [0, (top // 2) / top, 1])


def test_values_above_the_significant_bits_are_full_scale() -> None:
    pixels = np.array([[[4096, 65535, 4095]]], dtype=np.uint16)
    image = _image(pixels, "linear", 12)
    np.testing.assert_allclose(image.linear(), 1)
    assert image.is_clipped((slice(None), slice(None))).all()


def test_float_pictures_have_full_scale_one() -> None:
    pixels = np.array([[[0.25, 0.5, 1.5]]], dtype=np.float32)
    image = _image(pixels, "linear")
    assert image.full_scale == 1
    np.testing.assert_allclose(image.linear(), pixels)


def test_window_is_a_part_of_the_whole(rng: np.random.Generator) -> None:
    image = _image(rng.integers(0, 256, (9, 7, 3), dtype=np.uint8), "srgb")
    window = slice(2, 6), slice(1, 5)
    np.testing.assert_array_equal(image.linear(window), image.linear()[window])


def test_clipping_in_any_channel() -> None:
    pixels = np.full((1, 3, 3), 200, np.uint8)
    pixels[0, 1, 2], pixels[0, 2, 0] = 255, 253
    clipped = _image(pixels, "srgb").is_clipped((slice(None), slice(None)))
    np.testing.assert_array_equal(clipped, [[False, True, False]])


def test_grey_of_encoded_8_bit_is_its_luma() -> None:
    pixels = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [90, 90, 90]]], dtype=np.uint8)
    # ITU-R BT.601
    expected = [[0.299 * 255, 0.587 * 255, 0.114 * 255, 90]]
    np.testing.assert_allclose(_image(pixels, "srgb").grey(), expected, atol=0.5)  # whole levels


@pytest.mark.parametrize("bits", [12, 16])
def test_grey_of_linear_pictures_is_encoded(bits: int, rng: np.random.Generator) -> None:
    """The same light gives about the same tones, stored linearly or as sRGB."""
    light = rng.uniform(0.02, 1, (40, 40, 1)) * np.ones(3)
    top = 2**bits - 1
    linear = _image(np.rint(light * top).astype(np.uint16), "linear", bits)
    tones = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    encoded = _image(np.rint(tones * 255).astype(np.uint8), "srgb")
    # half a level of rounding, and 1 % for the brightest 0.5 % that set the scale
    np.testing.assert_allclose(linear.grey(), encoded.grey(), rtol=0.01, atol=1)


def test_grey_of_a_black_picture() -> None:
    np.testing.assert_array_equal(_image(np.zeros((4, 4), np.uint16), "linear").grey(), 0)

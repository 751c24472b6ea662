"""Corrected pictures against plain float64 arithmetic."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from calichrome.apply import (
    OUTPUT_SPACES,
    Corrector,
    FrameFormat,
    OutputSpace,
    SourceMap,
    undistorting_map,
)
from calichrome.core.arrays import FloatArray
from calichrome.errors import CalichromeError
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import Image, Pixels
from calichrome.rig import Camera

# IEC 61966-2-1 and SMPTE EG 432-1, from their primaries and D65 (0.95047, 1, 1.08883)
_RGB_FROM_XYZ = {
    "srgb": np.array(
        [
            [3.2404542, -1.5371385, -0.4985314],
            [-0.9692660, 1.8760108, 0.0415560],
            [0.0556434, -0.2040259, 1.0572252],
        ]
    ),
    "display-p3": np.array(
        [
            [2.4934969, -0.9313836, -0.4027108],
            [-0.8294890, 1.7626641, 0.0236247],
            [0.0358458, -0.0761724, 0.9568845],
        ]
    ),
}


def _apply(
    image: Image,
    camera: Camera,
    space: OutputSpace = "srgb",
    source_map: SourceMap | None = None,
) -> Pixels:
    return Corrector(camera, space, source_map, frames=FrameFormat.of(image)).apply(image.pixels)


def _smooth(rng: np.random.Generator, size_wh: tuple[int, int]) -> FloatArray:
    """A colour picture without edges, 0.02..0.9, so that any interpolation is near the truth."""
    width, height = size_wh
    x, y = np.meshgrid(np.arange(width) / width, np.arange(height) / height)
    phase = rng.uniform(0, 2 * np.pi, 3)
    waves = [np.sin(3 * x + 2 * y + shift) for shift in phase]
    return 0.46 + 0.44 * np.stack(waves, axis=-1)


def _srgb(values: FloatArray) -> FloatArray:
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)


def _from_srgb(values: FloatArray) -> FloatArray:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _expected(xyz: FloatArray, space: OutputSpace) -> FloatArray:
    if space == "xyz-d65":
        return xyz
    matrix = _RGB_FROM_XYZ["display-p3" if space == "display-p3" else "srgb"]
    rgb = np.clip(xyz @ matrix.T, 0, 1)
    return rgb if space == "linear-srgb" else _srgb(rgb)


def _full_scale(pixels: Pixels) -> float:
    return 1.0 if pixels.dtype == np.float32 else float(np.iinfo(pixels.dtype).max)


@pytest.mark.parametrize("space", [space for space in OUTPUT_SPACES if space != "none"])
def test_colours_of_8_bit_pictures(
    camera: Camera, rng: np.random.Generator, space: OutputSpace
) -> None:
    pixels = np.rint(_smooth(rng, camera.size_wh) * 255).astype(np.uint8)
    image = Image(pixels=pixels, encoding="srgb", bits=8)
    assert camera.colour is not None
    corrected = _apply(image, camera, space)
    xyz = _from_srgb(pixels / 255) @ camera.colour.xyz_from_rgb(np.eye(3))
    wanted = {"srgb": np.uint8, "display-p3": np.uint8, "linear-srgb": np.uint16}
    assert corrected.dtype == wanted.get(space, np.float32)
    error = corrected / _full_scale(corrected) - _expected(xyz, space)
    assert np.abs(error).max() <= 1 / 255


@pytest.mark.parametrize("bits", [12, 16])
def test_16_bit_in_16_bit_out(linear_camera: Camera, rng: np.random.Generator, bits: int) -> None:
    top = 2**bits - 1
    pixels = np.rint(_smooth(rng, linear_camera.size_wh) * top).astype(np.uint16)
    image = Image(pixels=pixels, encoding="linear", bits=bits)
    corrected = _apply(image, linear_camera, "srgb")
    assert corrected.dtype == np.uint16
    assert linear_camera.colour is not None
    xyz = pixels / top @ linear_camera.colour.xyz_from_rgb(np.eye(3))
    # far below a step of 8 bits: the way through 16-bit tables costs a few 16-bit steps
    assert np.abs(corrected / 65535 - _expected(xyz, "srgb")).max() <= 1e-3


def test_float_pictures_give_float(linear_camera: Camera, rng: np.random.Generator) -> None:
    pixels = _smooth(rng, linear_camera.size_wh).astype(np.float32)
    image = Image(pixels=pixels, encoding="linear", bits=32)
    corrected = _apply(image, linear_camera, "xyz-d65")
    assert corrected.dtype == np.float32
    assert linear_camera.colour is not None
    expected = pixels @ linear_camera.colour.xyz_from_rgb(np.eye(3))
    np.testing.assert_allclose(corrected, expected, atol=1e-6)


def test_xyz_of_the_camera_white(linear_camera: Camera) -> None:
    """Channels are X, Y, Z with Y = 1 for the perfect diffuser."""
    width, height = linear_camera.size_wh
    image = Image(pixels=np.full((height, width, 3), 65535, np.uint16), encoding="linear", bits=16)
    corrected = _apply(image, linear_camera, "xyz-d65")
    # row sums of the matrix
    np.testing.assert_allclose(corrected[5, 5], [0.98, 1.0, 1.12], atol=1e-6)


def test_undistorted_picture_against_float64(camera: Camera, rng: np.random.Generator) -> None:
    """Resample in light with another program's interpolation, then correct."""
    pixels = np.rint(_smooth(rng, camera.size_wh) * 255).astype(np.uint8)
    source = undistorting_map(camera.lens, camera.size_wh)
    corrected = _apply(Image(pixels=pixels, encoding="srgb", bits=8), camera, "srgb", source)
    width, height = camera.size_wh
    x, y = source[..., 0].astype(np.float64), source[..., 1].astype(np.float64)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    assert inside.mean() > 0.9
    sampled = np.stack(
        [
            map_coordinates(pixels[..., channel] / 255, [y, x], order=1, mode="nearest")
            for channel in range(3)
        ],
        axis=-1,
    )
    assert camera.colour is not None
    expected = _expected(_from_srgb(sampled) @ camera.colour.xyz_from_rgb(np.eye(3)), "srgb")
    # OpenCV places samples to 1/32 px, where this picture changes by less than 0.001
    assert np.abs(corrected / 255 - expected)[inside].max() <= 1 / 255


def test_undistortion_keeps_straight_lines(camera: Camera, rng: np.random.Generator) -> None:
    """Points of a line in space come to lie where a pinhole has them: on a line."""
    width, height = camera.size_wh
    source = undistorting_map(camera.lens, camera.size_wh)
    n_lines = 0
    while n_lines < 20:
        start = rng.uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.2])
        direction = rng.normal(size=3)
        points = start + np.linspace(-0.25, 0.25, 9)[:, None] * direction
        if points[:, 2].min() < 0.3:
            continue
        distorted = camera.lens.project(points)
        ideal = points[:, :2] / points[:, 2:]
        matrix = camera.lens.matrix
        pixels = ideal * np.diag(matrix)[:2] + matrix[:2, 2]
        inside = (pixels > 1).all(axis=1) & (pixels < [width - 2, height - 2]).all(axis=1)
        if inside.sum() < 4:
            continue
        n_lines += 1
        # the map at the undistorted place leads back to where the camera saw the point
        mapped = np.stack(
            [
                map_coordinates(
                    source[..., axis].astype(np.float64), pixels[inside].T[::-1], order=1
                )
                for axis in range(2)
            ],
            axis=-1,
        )
        np.testing.assert_allclose(mapped, distorted[inside], atol=0.05)
    bent = camera.lens.project(np.array([[-0.5, 0.4, 1], [0, 0.4, 1], [0.5, 0.4, 1]]))
    assert abs(bent[1, 1] - bent[[0, 2], 1].mean()) > 2  # or there was nothing to straighten


def test_what_the_camera_cannot_see_is_black(camera: Camera) -> None:
    """Beyond the fold of the lens the formula leads back into the picture."""
    assert isinstance(camera.lens, BrownConrady)
    folding = replace(camera.lens, k1=-0.9, k2=0.0, k3=0.0)
    source = undistorting_map(folding, camera.size_wh)
    image = Image(pixels=np.full((120, 160), 255, np.uint8), encoding="srgb", bits=8)
    corrected = _apply(image, camera, "none", source)
    x, y = np.meshgrid((np.arange(160) - 82) / 120, (np.arange(120) - 57) / 121)
    folded = x**2 + y**2 > 1 / (3 * 0.9) + 0.02  # where r (1 - 0.9 r^2) has turned back
    assert folded.any()
    assert (corrected[folded] == 0).all()
    assert corrected[57, 82] == 255


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_none_leaves_numbers_alone(
    camera: Camera, rng: np.random.Generator, dtype: type[np.generic]
) -> None:
    pixels = (_smooth(rng, camera.size_wh) * 200).astype(dtype)
    image = Image(pixels=pixels, encoding="srgb", bits=8 * pixels.dtype.itemsize)
    np.testing.assert_array_equal(_apply(image, camera, "none"), pixels)


def test_size_mismatch_is_refused(camera: Camera) -> None:
    image = Image(pixels=np.zeros((60, 80, 3), np.uint8), encoding="srgb", bits=8)
    with pytest.raises(CalichromeError, match=r"80x60.*160x120.*record at that size"):
        _apply(image, camera)


def test_grey_picture_is_refused_for_colour_only(camera: Camera) -> None:
    image = Image(pixels=np.zeros((120, 160), np.uint8), encoding="srgb", bits=8)
    with pytest.raises(CalichromeError, match="--colour none"):
        _apply(image, camera)
    assert _apply(image, camera, "none").shape == (120, 160)


def test_camera_without_colour(camera: Camera) -> None:
    with pytest.raises(CalichromeError, match="no colour calibration"):
        Corrector(replace(camera, colour=None), "srgb")

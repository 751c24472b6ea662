"""Frames of 4:2:0 to RGB and back against the formulas, at any size and stride."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.kernels import native

pytestmark = pytest.mark.skipif(native is None, reason="installed without a C compiler")

# BT.709 of limited range: ITU-R BT.709-6, items 3.2 and 3.3, with the codes of 3.4
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_FORTH = np.column_stack(
    [
        np.array([219 * _LUMA, *(224 * (np.eye(3)[[2, 0]] - _LUMA) / [[1.8556], [1.5748]])]) / 255,
        [16, 128, 128],
    ]
)
_BACK = np.column_stack(
    [np.linalg.inv(_FORTH[:, :3]), -np.linalg.inv(_FORTH[:, :3]) @ _FORTH[:, 3]]
)
_ROUNDED = 0.5 + 1e-3  # float32 at 255


def _between(samples: FloatArray, size: int) -> FloatArray:
    """Interpolate along the first axis between the middles of pairs; the border goes on."""
    at = np.clip((np.arange(size) - 0.5) / 2, 0, len(samples) - 1)
    low = np.minimum(at.astype(int), max(len(samples) - 2, 0))
    high = np.minimum(low + 1, len(samples) - 1)
    share = (at - low)[:, None]
    return np.asarray((1 - share) * samples[low] + share * samples[high])


def _planes(rng: np.random.Generator, width: int, height: int) -> list[UInt8Array]:
    half = (height + 1) // 2, (width + 1) // 2
    return [rng.integers(0, 256, shape).astype(np.uint8) for shape in ((height, width), half, half)]


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(
    "size_wh", [(1, 1), (2, 2), (3, 5), (16, 4), (17, 3), (40, 6), (511, 4), (513, 5), (1040, 2)]
)
def test_rgb_follows_the_formula(
    rng: np.random.Generator,
    size_wh: tuple[int, int],
    wide: bool,  # noqa: FBT001
) -> None:
    width, height = size_wh
    planes = _planes(rng, width, height)
    out = np.zeros((height, width, 3), np.uint8)
    assert native is not None
    native.rgb_of_yuv(*planes, out, _BACK.astype(np.float32), wide)
    chroma = [_between(_between(plane.astype(float), height).T, width).T for plane in planes[1:]]
    wanted = np.stack([planes[0], *chroma, np.ones((height, width))], axis=-1) @ _BACK.T
    assert np.abs(out - np.clip(wanted, 0, 255)).max() <= _ROUNDED


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("size_wh", [(2, 2), (14, 4), (16, 2), (18, 6), (512, 4), (1038, 2)])
def test_yuv_follows_the_formula(
    rng: np.random.Generator,
    size_wh: tuple[int, int],
    wide: bool,  # noqa: FBT001
) -> None:
    width, height = size_wh
    rgb = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    rgb[:, : width // 2] = rng.choice([0, 255], 3)
    planes = _planes(rng, width, height)
    assert native is not None
    native.yuv_of_rgb(*planes, rgb, _FORTH.astype(np.float32), wide)
    means = rgb.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
    wanted = [pixels @ _FORTH[:, :3].T + _FORTH[:, 3] for pixels in (rgb, means, means)]
    for channel, plane in enumerate(planes):
        assert np.abs(plane - wanted[channel][..., channel]).max() <= _ROUNDED


@pytest.mark.parametrize("wide", [False, True])
def test_strides_and_neighbours(rng: np.random.Generator, wide: bool) -> None:  # noqa: FBT001
    """Parts of larger arrays are read and written, nothing beside them; rows may run upwards."""
    width, height = 34, 6
    planes = _planes(rng, 2 * width, 2 * height)
    parts = [plane[3 : 3 + height // (1 + (index > 0)), 5:] for index, plane in enumerate(planes)]
    parts = [part[:, : width // (1 + (index > 0))] for index, part in enumerate(parts)]
    canvas = np.full((height + 4, width + 4, 3), 7, np.uint8)
    inside = canvas[2:-2, 2:-2][::-1]
    assert native is not None
    native.rgb_of_yuv(*parts, inside, _BACK.astype(np.float32), wide)
    alone = np.zeros((height, width, 3), np.uint8)
    native.rgb_of_yuv(*(part.copy() for part in parts), alone, _BACK.astype(np.float32), wide)
    np.testing.assert_array_equal(inside, alone)
    assert canvas.sum() - inside.sum(dtype=int) == 7 * 3 * (canvas[..., 0].size - width * height)

    untouched = [plane.copy() for plane in planes]
    native.yuv_of_rgb(*parts, inside, _FORTH.astype(np.float32), wide)
    for plane, part, before in zip(planes, parts, untouched, strict=True):
        written = np.zeros(plane.shape, bool)
        written[3 : 3 + part.shape[0], 5 : 5 + part.shape[1]] = True
        np.testing.assert_array_equal(plane[~written], before[~written])


def test_what_does_not_fit_is_refused(rng: np.random.Generator) -> None:
    assert native is not None
    back, forth = _BACK.astype(np.float32), _FORTH.astype(np.float32)
    luma, blue, red = _planes(rng, 16, 8)
    out = np.zeros((8, 16, 3), np.uint8)
    wrong = "do not fit together"
    for planes, rgb in [
        ((luma, blue[1:], red), out),
        ((luma, blue, red), out[1:]),
        ((luma[0, 0], blue, red), out),
        ((luma.astype(np.uint16), blue, red), out),
        ((luma[:0], blue, red), out),
        ((luma[:, ::2], blue, red), out),
    ]:
        with pytest.raises(ValueError, match=wrong):
            native.rgb_of_yuv(*planes, rgb, back)
    odd = _planes(rng, 15, 8)
    with pytest.raises(ValueError, match=wrong):  # a chroma sample would have no second pixel
        native.yuv_of_rgb(*odd, out[:, :15], forth)
    with pytest.raises(ValueError, match="matrix"):
        native.yuv_of_rgb(luma, blue, red, out, forth[:2])
    out.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        native.rgb_of_yuv(luma, blue, red, out, back)

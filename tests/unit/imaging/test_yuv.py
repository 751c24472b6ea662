"""RGB and YUV: libswscale at full accuracy and the formulas of ITU-T H.273 as oracles."""

import av
import numpy as np
import pytest
from av.video.reformatter import Interpolation

from calichrome.core.arrays import Scratch
from calichrome.imaging import Pixels, yuv
from calichrome.imaging.yuv import frame_of_rgb, rgb_of_frame, stated_matrix


@pytest.fixture(autouse=True, params=["native", "opencv"])
def _kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "opencv":
        monkeypatch.setattr(yuv, "native", None)


_ACCURATE = Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_LAYOUTS = ["yuv420p", "yuv444p", "yuv420p10le", "yuv444p10le"]


def _patches(rng: np.random.Generator, size_wh: tuple[int, int], dtype: type[np.generic]) -> Pixels:
    """Flat colours of 16x16 px, the corners of the cube among them."""
    width, height = size_wh
    count = -(-height // 16), -(-width // 16)
    colours = rng.integers(0, 256, (*count, 3))
    corners = np.stack(np.meshgrid([0, 255], [0, 255], [0, 255]), axis=-1).reshape(-1, 3)
    colours.reshape(-1, 3)[:8] = corners
    pixels = colours.repeat(16, axis=0).repeat(16, axis=1)[:height, :width]
    return pixels.astype(dtype) * (257 if dtype == np.uint16 else 1)


def _middles(pixels: Pixels) -> Pixels:
    return pixels[8::16, 8::16].astype(np.float64)


@pytest.mark.parametrize("layout", _LAYOUTS)
@pytest.mark.parametrize("matrix", [1, 6, 9])
@pytest.mark.parametrize("full_range", [False, True])
@pytest.mark.parametrize("size_wh", [(128, 96), (127, 95)])
def test_there_and_back(
    rng: np.random.Generator,
    layout: str,
    matrix: int,
    full_range: bool,  # noqa: FBT001
    size_wh: tuple[int, int],
) -> None:
    pixels = _patches(rng, size_wh, np.uint16 if layout.endswith("10le") else np.uint8)
    frame = frame_of_rgb(pixels, layout, matrix, full_range=full_range)
    back = rgb_of_frame(frame)
    assert back.shape == pixels.shape
    # Half a code of luma and of each chroma, and half of the RGB. A code of chroma counts most in
    # blue: 2 (1 - Kb) 255/224 = 2.1 of 8 bits.
    step = 65535 / 1023 if pixels.dtype == np.uint16 else 1
    assert np.abs(_middles(back) - _middles(pixels)).max() <= 2.3 * step
    assert np.abs((_middles(back) - _middles(pixels)).mean(axis=(0, 1))).max() <= 0.35 * step


@pytest.mark.parametrize("layout", ["yuv420p", "yuv422p", "yuv444p", "yuvj420p"])
@pytest.mark.parametrize(("matrix", "height"), [(1, 96), (6, 96), (2, 96), (2, 720)])
def test_ffmpeg_reads_the_same(
    rng: np.random.Generator, layout: str, matrix: int, height: int
) -> None:
    """Its accurate conversion of our frames gives our RGB, within a code."""
    is_full = layout.startswith("yuvj")
    pixels = _patches(rng, (128, height), np.uint8)
    used = stated_matrix(matrix, height)
    frame = frame_of_rgb(pixels, layout, used, full_range=is_full)
    frame.colorspace = matrix
    theirs = frame.reformat(
        format="rgb24",
        src_colorspace=5 if used == 6 else used,
        src_color_range=2 if is_full else 1,
        dst_color_range=2,
        interpolation=_ACCURATE,
    ).to_ndarray()
    assert np.abs(_middles(rgb_of_frame(frame)) - _middles(theirs)).max() <= 1


@pytest.mark.parametrize("full_range", [False, True])
def test_ffmpeg_writes_the_same(rng: np.random.Generator, full_range: bool) -> None:  # noqa: FBT001
    pixels = _patches(rng, (128, 96), np.uint8)
    ours = frame_of_rgb(pixels, "yuv420p", 1, full_range=full_range)
    theirs = av.VideoFrame.from_ndarray(pixels, "rgb24").reformat(
        format="yuv420p",
        dst_colorspace=1,
        src_color_range=2,
        dst_color_range=2 if full_range else 1,
        interpolation=_ACCURATE,
    )
    a, b = ours.to_ndarray().astype(int), theirs.to_ndarray().astype(int)
    luma, chroma = np.s_[8:96:16, 8::16], np.s_[98::4, :]
    assert np.abs(a - b)[luma].max() <= 1
    # rows of chroma planes hold patches of 8 samples, whose borders bicubics blur
    inside = np.abs(a - b)[chroma][:, 3::8]
    assert inside.max() <= 1


@pytest.mark.parametrize("layout", ["yuv420p", "yuv422p", "yuv440p"])
def test_chroma_lies_where_it_was(layout: str) -> None:
    """A ramp of colour is not moved by subsampling, at any side of the picture."""
    width, height = 48, 40
    pixels = np.full((height, width, 3), 120, np.uint8)
    pixels[..., 0] = 30 + 4 * np.arange(width)
    pixels[..., 2] = (210 - 4 * np.arange(height))[:, None]
    back = rgb_of_frame(frame_of_rgb(pixels, layout, 1, full_range=False)).astype(float)
    error = (back - pixels)[2:-2, 2:-2]
    # half a pixel would be 2 codes; a mean of two integers, rounded up, is off by 0.7 of blue
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.9


def test_grey_becomes_grey() -> None:
    grey = np.tile(np.arange(256, dtype=np.uint8), (16, 1))
    back = rgb_of_frame(frame_of_rgb(grey, "yuv420p", 1, full_range=False)).astype(int)
    assert np.abs(back - grey[..., None]).max() <= 1


def test_arrays_used_again_change_nothing(rng: np.random.Generator) -> None:
    """Frames of different sizes and depths pass through the same arrays, in turn."""
    scratch = Scratch()
    for layout, size_wh in [
        ("yuv420p", (64, 48)),
        ("yuv420p", (64, 48)),
        ("yuv420p10le", (64, 48)),
        ("yuv420p", (63, 47)),
    ]:
        pixels = _patches(rng, size_wh, np.uint16 if layout.endswith("10le") else np.uint8)
        fresh = frame_of_rgb(pixels, layout, 1, full_range=False)
        again = frame_of_rgb(pixels, layout, 1, full_range=False, scratch=scratch)
        np.testing.assert_array_equal(rgb_of_frame(again, scratch), rgb_of_frame(fresh))


def test_depth_must_fit() -> None:
    with pytest.raises(ValueError, match="uint8 does not fit yuv420p10le"):
        frame_of_rgb(np.zeros((16, 16, 3), np.uint8), "yuv420p10le", 1, full_range=False)


@pytest.mark.parametrize("layout", ["yuv420p", "yuv444p"])
def test_pixels_may_be_a_view(rng: np.random.Generator, layout: str) -> None:
    """Of BGR in another order, every second column, upside down."""
    wide = rng.integers(0, 256, (32, 96, 3)).astype(np.uint8)
    view = wide[::-1, ::2, ::-1]
    frames = [frame_of_rgb(pixels, layout, 1, full_range=False) for pixels in (view, view.copy())]
    np.testing.assert_array_equal(frames[0].to_ndarray(), frames[1].to_ndarray())

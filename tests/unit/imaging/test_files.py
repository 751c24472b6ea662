"""Pictures in and out."""

import io
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags
from PIL import Image as PillowImage

from calichrome.errors import OutputError
from calichrome.imaging import Image, Pixels, Unreadable, read_image, read_size, write_picture


def _picture(rng: np.random.Generator, dtype: str) -> Pixels:
    if dtype == "float32":
        return rng.uniform(-0.5, 2, (7, 9, 3)).astype(np.float32)
    return rng.integers(0, np.iinfo(dtype).max, (7, 9, 3), dtype=dtype, endpoint=True)


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [
        (".png", "uint8"),
        (".png", "uint16"),
        (".tif", "uint8"),
        (".tif", "uint16"),
        (".tiff", "float32"),
    ],
)
def test_round_trip(tmp_path: Path, rng: np.random.Generator, suffix: str, dtype: str) -> None:
    pixels = _picture(rng, dtype)
    write_picture(tmp_path / f"a{suffix}", pixels)
    image = read_image(tmp_path / f"a{suffix}")
    assert isinstance(image, Image)
    assert image.pixels.dtype == np.dtype(dtype)
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.encoding == ("srgb" if dtype == "uint8" else "linear")
    assert len(image.sha256) == 64
    assert read_size(tmp_path / f"a{suffix}") == image.size_wh == (9, 7)


def test_float_tiff_keeps_the_order_of_channels(tmp_path: Path) -> None:
    """X, Y, Z for whoever reads the file, not Z, Y, X."""
    xyz = np.broadcast_to(np.array([0.25, 0.5, 1.75], np.float32), (4, 5, 3))
    write_picture(tmp_path / "xyz.tif", xyz)
    stored = cv2.imread(str(tmp_path / "xyz.tif"), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    np.testing.assert_array_equal(stored[0, 0, ::-1], [0.25, 0.5, 1.75])  # OpenCV reads B, G, R


def test_png_keeps_the_order_of_channels(tmp_path: Path) -> None:
    write_picture(tmp_path / "red.png", np.full((2, 2, 3), [200, 100, 50], np.uint8))
    with PillowImage.open(tmp_path / "red.png") as picture:
        assert picture.getpixel((0, 0)) == (200, 100, 50)


def test_jpeg_keeps_its_chroma(tmp_path: Path) -> None:
    """A line of one pixel in another hue survives 4:4:4; subsampled it would be spread to two."""
    pixels = np.full((16, 16, 3), [160, 90, 90], np.uint8)
    pixels[:, 7] = [90, 90, 160]
    write_picture(tmp_path / "a.jpg", pixels)
    image = read_image(tmp_path / "a.jpg")
    assert isinstance(image, Image)
    error = np.abs(image.pixels.astype(int) - pixels)
    assert error.max() <= 12  # quality 95; 4:2:0 gives over 30
    with PillowImage.open(tmp_path / "a.jpg") as picture:
        assert [component[1:3] for component in picture.layer] == [(1, 1)] * 3  # type: ignore[attr-defined]


def test_grey_comes_back_grey(tmp_path: Path, rng: np.random.Generator) -> None:
    grey = rng.integers(0, 255, (5, 6), dtype=np.uint8)
    write_picture(tmp_path / "grey.png", grey)
    image = read_image(tmp_path / "grey.png")
    assert isinstance(image, Image)
    assert not image.is_colour
    np.testing.assert_array_equal(image.pixels, grey)


def test_a_black_picture_of_a_colour_camera_has_colour(tmp_path: Path) -> None:
    write_picture(tmp_path / "black.png", np.zeros((5, 6, 3), dtype=np.uint8))
    image = read_image(tmp_path / "black.png")
    assert isinstance(image, Image)
    assert image.is_colour


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "1"])
def test_other_kinds_of_png(tmp_path: Path, rng: np.random.Generator, mode: str) -> None:
    """Alpha is dropped, palettes are looked up; the reference is Pillow's own conversion."""
    source = PillowImage.fromarray(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8))
    converted = source.convert("L").convert("LA") if mode == "LA" else source.convert(mode)
    converted.save(tmp_path / "a.png")
    image = read_image(tmp_path / "a.png")
    assert isinstance(image, Image)
    expected = np.array(converted.convert("RGB"))
    np.testing.assert_array_equal(image.pixels, expected if image.is_colour else expected[..., 0])


def test_exif_rotation_is_read_and_not_applied(tmp_path: Path, rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 255, (6, 8, 3), dtype=np.uint8)
    exif = PillowImage.Exif()
    exif[ExifTags.Base.Orientation] = 6
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.ExposureTime] = 0.02
    details[ExifTags.Base.ISOSpeedRatings] = 400
    PillowImage.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    image = read_image(tmp_path / "a.png")
    assert isinstance(image, Image)
    assert image.rotation_tag == 6
    assert image.exposure == {"exposure_s": pytest.approx(0.02), "iso": 400}
    np.testing.assert_array_equal(image.pixels, pixels)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_cut_off_files(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_picture(path, rng.integers(0, 255, (64, 64, 3), dtype=np.uint8))
    content = path.read_bytes()
    for share in (0.02, 0.5, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        answer = read_image(path)
        assert isinstance(answer, Unreadable)
        assert "copy it again" in answer.reason or "remove it" in answer.reason


def _encoded(rng: np.random.Generator) -> list[bytes]:
    picture = PillowImage.fromarray(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8))
    exif = PillowImage.Exif()
    exif[ExifTags.Base.Orientation] = 6
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ExposureTime] = 0.01
    contents = []
    for kind in ("PNG", "JPEG", "TIFF"):
        buffer = io.BytesIO()
        picture.save(buffer, kind, exif=exif)
        contents.append(buffer.getvalue())
    return contents


def test_damaged_bytes_give_an_answer(tmp_path: Path, rng: np.random.Generator) -> None:
    """Whatever happened to a file: a picture or a reason, no exception and no warning."""
    sources = _encoded(rng)
    path = tmp_path / "damaged"
    kinds = set()
    for index in range(900):
        content = bytearray(sources[index % 3])
        for _ in range(rng.integers(1, 6)):
            # most often in the header, where it matters
            content[rng.integers(0, len(content) if index % 2 else 300)] = rng.integers(256)
        path.write_bytes(content[: rng.integers(1, len(content))] if index % 5 == 0 else content)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            answer = read_image(path, max_megapixels=1)
        assert not caught
        kinds.add(type(answer))
    assert kinds == {Image, Unreadable}


def test_too_large_is_refused_before_decoding(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", np.zeros((100, 200), np.uint8))
    answer = read_image(tmp_path / "a.png", max_megapixels=0.019)
    assert isinstance(answer, Unreadable)
    assert "--max-megapixels" in answer.reason
    assert isinstance(read_image(tmp_path / "a.png", max_megapixels=0.02), Image)


def test_float_picture_that_is_not_finite(tmp_path: Path) -> None:
    pixels = np.ones((3, 3), np.float32)
    pixels[1, 1] = np.nan
    write_picture(tmp_path / "a.tif", pixels)
    answer = read_image(tmp_path / "a.tif")
    assert isinstance(answer, Unreadable)
    assert "finite" in answer.reason


@pytest.mark.parametrize(("suffix", "dtype"), [(".png", "float32"), (".jpg", "uint16")])
def test_format_that_would_lose_the_numbers(
    tmp_path: Path, rng: np.random.Generator, suffix: str, dtype: str
) -> None:
    with pytest.raises(ValueError, match=f"does not hold {dtype}"):
        write_picture(tmp_path / f"a{suffix}", _picture(rng, dtype))
    assert list(tmp_path.iterdir()) == []


def test_writing_is_whole_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_picture(path, np.zeros((2, 2), np.uint8))
    before = path.read_bytes()
    with pytest.raises(OutputError, match="--force"):
        write_picture(path, np.ones((2, 2), np.uint8))
    assert path.read_bytes() == before
    write_picture(path, np.ones((2, 2), np.uint8), force=True)
    assert path.read_bytes() != before
    with pytest.raises(OutputError, match="no picture name"):
        write_picture(tmp_path / "a.xyz", np.ones((2, 2), np.uint8))
    assert list(tmp_path.iterdir()) == [path]

"""What a file says of itself before a single pixel is decoded.

A 124 kB PNG can unpack to gigabytes and a truncated JPEG decodes without complaint, so size,
completeness and EXIF are read first, by Pillow, which is lazy and strict.
"""

import io
import math
import struct
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from PIL import ExifTags, TiffImagePlugin, UnidentifiedImageError
from PIL import Image as PillowImage

__all__ = ["DAMAGED", "Header", "Unreadable", "read_header"]

DAMAGED = "the file is cut off or damaged; copy it again"
_FORMATS = ("PNG", "JPEG", "TIFF")
_PILLOW = threading.Lock()
_EXPOSURE_TAGS = {
    ExifTags.Base.ExposureTime: "exposure_s",
    ExifTags.Base.FNumber: "f_number",
    ExifTags.Base.ISOSpeedRatings: "iso",
    ExifTags.Base.WhiteBalance: "white_balance_mode",
}


@dataclass(frozen=True, slots=True)
class Unreadable:
    """Why a file is no picture: a finding of its frame, not an exception."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """Size, format and EXIF of a picture file."""

    size_wh: tuple[int, int]
    file_format: str
    rotation_tag: int
    exposure: Mapping[str, float]


def read_header(content: bytes, max_megapixels: float) -> Header | Unreadable:
    """Read the header of a PNG, JPEG or TIFF and check that the file is whole.

    Parameters
    ----------
    content
        The bytes of the file.
    max_megapixels
        Larger pictures are refused before they are decoded.
    """
    with _quiet_pillow():
        try:
            picture = PillowImage.open(io.BytesIO(content), formats=_FORMATS)
            megapixels = picture.width * picture.height / 1e6
            if megapixels > max_megapixels:
                return _too_large(max_megapixels)
            if not _is_whole(content, picture):
                return Unreadable(DAMAGED)
            exposure, rotation_tag = _read_exif(picture)
        except UnidentifiedImageError:
            return _read_tiff(content, max_megapixels)
        except (OSError, ValueError, SyntaxError, EOFError):
            return Unreadable(DAMAGED)
    return Header(
        size_wh=(picture.width, picture.height),
        file_format=str(picture.format),
        rotation_tag=rotation_tag,
        exposure=exposure,
    )


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """Let Pillow neither refuse nor warn: of size, which we check, and of EXIF, which may be bad.

    Its limit and the filters of warnings belong to the process: one thread at a time.
    """
    with _PILLOW, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit, PillowImage.MAX_IMAGE_PIXELS = PillowImage.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            PillowImage.MAX_IMAGE_PIXELS = limit


def _read_tiff(content: bytes, max_megapixels: float) -> Header | Unreadable:
    """Read the header of a TIFF that Pillow does not decode, like RGB in float32."""
    stream = io.BytesIO(content)
    try:
        directory = TiffImagePlugin.ImageFileDirectory_v2(stream.read(8))
        stream.seek(directory.next)
        directory.load(stream)
    except (OSError, ValueError, SyntaxError, EOFError, struct.error):
        return Unreadable("is not a PNG, JPEG or TIFF picture; remove it")
    width, height, turned = (
        _number(directory.get(tag))
        for tag in (ExifTags.Base.ImageWidth, ExifTags.Base.ImageLength, ExifTags.Base.Orientation)
    )
    if width is None or height is None or min(width, height) < 1:
        return Unreadable(DAMAGED)
    if width * height > max_megapixels * 1e6:
        return _too_large(max_megapixels)
    return Header(
        size_wh=(int(width), int(height)),
        file_format="TIFF",
        rotation_tag=_as_rotation(turned),
        exposure={},
    )


def _as_rotation(turned: float | None) -> int:
    return int(turned) if turned is not None and turned in range(1, 9) else 1


def _too_large(limit: float) -> Unreadable:
    return Unreadable(f"has more than {limit:.0f} megapixels (--max-megapixels); scale it down")


def _read_exif(picture: PillowImage.Image) -> tuple[dict[str, float], int]:
    """Return exposure and orientation; damaged EXIF says nothing, its picture stays good."""
    try:
        exif = picture.getexif()
        details = exif.get_ifd(ExifTags.IFD.Exif)
    except (OSError, ValueError, SyntaxError, EOFError, KeyError, TypeError, struct.error):
        return {}, 1
    numbers = {name: _number(details.get(tag)) for tag, name in _EXPOSURE_TAGS.items()}
    turned = _number(exif.get(ExifTags.Base.Orientation))
    return (
        {name: value for name, value in numbers.items() if value is not None},
        _as_rotation(turned),
    )


def _number(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _is_whole(content: bytes, picture: PillowImage.Image) -> bool:
    """Whether nothing is missing; decodes only JPEGs that do not end as they should."""
    if picture.format == "PNG":
        copy = PillowImage.open(io.BytesIO(content), formats=("PNG",))
        copy.verify()  # walks all chunks and their checksums
        return b"IEND" in content[-4096:]
    if picture.format == "JPEG" and not content.rstrip(b"\0").endswith(b"\xff\xd9"):
        try:
            PillowImage.open(io.BytesIO(content), formats=("JPEG",)).load()
        except OSError:
            return False
    return True

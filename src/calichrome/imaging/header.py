"""What a file says of itself before a single pixel is decoded.

A 124 kB PNG can unpack to gigabytes and a truncated JPEG decodes without complaint, so size,
completeness and EXIF are read first, by Pillow, which is lazy and strict.
"""

import io
import math
import struct
import threading
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as PillowImage

__all__ = ["DAMAGED", "Header", "Unreadable", "read_header"]

DAMAGED = "the file is cut off or damaged; copy it again"
_FORMATS = ("PNG", "JPEG", "TIFF")
_PILLOW = threading.Lock()
_PILLOW_MEGAPIXELS = 2 * (PillowImage.MAX_IMAGE_PIXELS or 0) / 1e6
"""Pillow itself opens nothing larger; its limit belongs to the process and is left alone."""
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
    # Filters of warnings belong to the process, and recordings are read by several threads.
    with _PILLOW, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of size, which we refuse, and of EXIF, which we check
        try:
            picture = PillowImage.open(io.BytesIO(content), formats=_FORMATS)
            megapixels = picture.width * picture.height / 1e6
            if megapixels > max_megapixels:
                return _too_large(max_megapixels)
            if not _is_whole(content, picture):
                return Unreadable(DAMAGED)
            exposure, rotation_tag = _read_exif(picture)
        except UnidentifiedImageError:
            return Unreadable("is not a PNG, JPEG or TIFF picture; remove it")
        except PillowImage.DecompressionBombError:
            return _too_large(min(max_megapixels, _PILLOW_MEGAPIXELS))
        except (OSError, ValueError, SyntaxError, EOFError):
            return Unreadable(DAMAGED)
    return Header(
        size_wh=(picture.width, picture.height),
        file_format=str(picture.format),
        rotation_tag=rotation_tag,
        exposure=exposure,
    )


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
        int(turned) if turned is not None and turned in range(1, 9) else 1,
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

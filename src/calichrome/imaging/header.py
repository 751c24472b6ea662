"""What a file says of itself before a single pixel is decoded.

A 124 kB PNG can unpack to gigabytes and a truncated JPEG decodes without complaint, so size,
completeness and EXIF are read first, by Pillow, which is lazy and strict.
"""

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as PillowImage

__all__ = ["Header", "Unreadable", "read_header"]

_FORMATS = ("PNG", "JPEG", "TIFF")
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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of size; we refuse below
            picture = PillowImage.open(io.BytesIO(content), formats=_FORMATS)
            megapixels = picture.width * picture.height / 1e6
            if megapixels > max_megapixels:
                return Unreadable(
                    f"{picture.width}x{picture.height} is {megapixels:.0f} megapixels, more than "
                    f"--max-megapixels {max_megapixels:g}"
                )
            if not _is_whole(content, picture):
                return Unreadable("the file is cut off or damaged; copy it again")
            exif = picture.getexif()
    except UnidentifiedImageError:
        return Unreadable("is not a PNG, JPEG or TIFF picture")
    except (
        OSError,
        ValueError,
        SyntaxError,
        EOFError,
        PillowImage.DecompressionBombError,
    ) as error:
        return Unreadable(f"its header is damaged ({error})")
    details = exif.get_ifd(ExifTags.IFD.Exif)
    return Header(
        size_wh=(picture.width, picture.height),
        file_format=str(picture.format),
        rotation_tag=int(exif.get(ExifTags.Base.Orientation, 1)),
        exposure={
            name: float(details[tag])
            for tag, name in _EXPOSURE_TAGS.items()
            if _is_number(details.get(tag))
        },
    )


def _is_number(value: object) -> bool:
    try:
        return value is not None and float(value) == float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return False


def _is_whole(content: bytes, picture: PillowImage.Image) -> bool:
    """Whether nothing is missing; decodes only JPEGs that do not end as they should."""
    if picture.format == "PNG":
        copy = PillowImage.open(io.BytesIO(content), formats=("PNG",))
        copy.verify()  # walks all chunks and their checksums
        return b"IEND" in content[-12:] or b"IEND" in content[-4096:]
    if picture.format == "JPEG" and not content.rstrip(b"\0").endswith(b"\xff\xd9"):
        try:
            PillowImage.open(io.BytesIO(content), formats=("JPEG",)).load()
        except OSError:
            return False
    return True

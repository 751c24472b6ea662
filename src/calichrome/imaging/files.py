"""Pictures from files and into files."""

import hashlib
import os
from pathlib import Path

import cv2
import numpy as np

from calichrome.colorimetry.encoding import EncodingName
from calichrome.core.files import writing_file
from calichrome.errors import OutputError
from calichrome.imaging.header import DAMAGED, Unreadable, read_header
from calichrome.imaging.image import Image, Pixels

__all__ = ["MAX_MEGAPIXELS", "PICTURE_SUFFIXES", "read_image", "read_size", "write_picture"]

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
MAX_MEGAPIXELS = 200.0
_HOLDS = {
    ".png": (np.uint8, np.uint16),
    ".tif": (np.uint8, np.uint16, np.float32),
    ".tiff": (np.uint8, np.uint16, np.float32),
}
_UNTAGGED = (".tif", ".tiff")  # OpenCV writes no profile into them
_MAX_BYTES = 4_000_000_000


def read_image(  # noqa: PLR0911 (every way in which a file can be bad is an answer)
    path: Path,
    *,
    encoding: EncodingName | None = None,
    bits: int | None = None,
    max_megapixels: float = MAX_MEGAPIXELS,
) -> Image | Unreadable:
    """Read one picture; a bad file is an answer, not an exception.

    Parameters
    ----------
    path
        PNG, JPEG or TIFF; 8 or 16 bit or float32; grey, RGB or RGBA (alpha is dropped).
    encoding
        None: 8 bit is taken as sRGB, 16 bit and float as linear.
    bits
        Significant bits of the stored integers; None: all of them.
    max_megapixels
        Refuse larger pictures before decoding.

    Notes
    -----
    A rotation tag in EXIF is not applied: it would change the pixel frame of the lens.
    """
    content = _read_bytes(path)
    if isinstance(content, Unreadable):
        return content
    header = read_header(content, max_megapixels)
    if isinstance(header, Unreadable):
        return header
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # what OpenCV would print about bad files, we say in our own words
    try:
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        return Unreadable(f"cannot be decoded ({error.err}); save it again as PNG")
    if decoded is None or (decoded.shape[1], decoded.shape[0]) != header.size_wh:
        return Unreadable(DAMAGED)
    if decoded.dtype not in (np.uint8, np.uint16, np.float32):
        return Unreadable(f"holds {decoded.dtype} pixels; save it with 8 or 16 bit or float32")
    if decoded.dtype == np.float32 and not np.isfinite(decoded).all():
        return Unreadable("holds pixels that are not finite; replace them")
    integer_bits = 8 * decoded.dtype.itemsize
    return Image(
        pixels=_to_rgb(decoded),
        encoding=encoding or ("srgb" if decoded.dtype == np.uint8 else "linear"),
        bits=min(bits or integer_bits, integer_bits),
        sha256=hashlib.sha256(content).hexdigest(),
        exposure=header.exposure,
        rotation_tag=header.rotation_tag,
    )


def read_size(
    path: Path, *, max_megapixels: float = MAX_MEGAPIXELS
) -> tuple[int, int] | Unreadable:
    """Return width and height from the header alone."""
    content = _read_bytes(path)
    header = content if isinstance(content, Unreadable) else read_header(content, max_megapixels)
    return header if isinstance(header, Unreadable) else header.size_wh


def _read_bytes(path: Path) -> bytes | Unreadable:
    try:
        size = path.stat().st_size
        if size > _MAX_BYTES:
            return Unreadable(f"is {size / 1e9:.1f} GB large; no picture is, remove it")
        return path.read_bytes()
    except OSError as error:
        return Unreadable(f"cannot be read ({error.strerror}); check its permissions")


def _to_rgb(decoded: Pixels) -> Pixels:
    if decoded.ndim == 2:
        return decoded
    if decoded.shape[2] < 3:
        return np.ascontiguousarray(decoded[:, :, 0])
    return np.ascontiguousarray(decoded[:, :, 2::-1])


def write_picture(
    path: Path,
    pixels: Pixels,
    *,
    jpeg_quality: int = 95,
    profile: bytes | None = None,
    force: bool = False,
) -> None:
    """Write a picture whole or not at all; the format follows the suffix.

    Parameters
    ----------
    path
        .png (8 or 16 bit), .jpg (8 bit, chroma not subsampled), .tif (8, 16 bit or float32).
    pixels : (H, W, 3) RGB or (H, W) grey
    jpeg_quality
        0..100.
    profile
        ICC profile of the colours, which PNG and JPEG carry; None: nothing is said.
    force
        Replace an existing file.

    Raises
    ------
    OutputError
        If the file exists or cannot be written.
    ValueError
        If the format does not hold such pixels: OpenCV would write others in silence.
    """
    suffix = path.suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        raise OutputError(f"{path} is no picture name; use .png, .jpg or .tif")
    if pixels.dtype not in _HOLDS.get(suffix, (np.uint8,)):
        raise ValueError(f"pixels: {suffix} does not hold {pixels.dtype}")
    ordered = pixels[:, :, ::-1] if pixels.ndim == 3 else pixels
    options: list[int] = []
    if suffix in (".jpg", ".jpeg"):
        options = [
            cv2.IMWRITE_JPEG_QUALITY, jpeg_quality,
            cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
        ]  # fmt: skip
    ordered = np.ascontiguousarray(ordered)
    if profile is None or suffix in _UNTAGGED:
        ok, content = cv2.imencode(suffix, ordered, options)
    else:
        chunk = np.frombuffer(profile, np.uint8)
        kinds = [cv2.IMAGE_METADATA_ICCP]
        ok, content = cv2.imencodeWithMetadata(suffix, ordered, kinds, [chunk], options)
    if not ok:
        raise OutputError(f"{path} cannot be encoded; use .png, .jpg or .tif")
    with writing_file(path, force=force) as temporary, temporary.open("wb") as stream:
        stream.write(content.tobytes())
        stream.flush()
        os.fsync(stream.fileno())

"""Pictures and recordings, in and out."""

from calichrome.imaging.files import (
    MAX_MEGAPIXELS,
    PICTURE_SUFFIXES,
    read_image,
    read_size,
    write_picture,
)
from calichrome.imaging.header import Unreadable
from calichrome.imaging.image import Image, Pixels
from calichrome.imaging.recording import Recording, open_recording, picture_files

__all__ = [
    "MAX_MEGAPIXELS",
    "PICTURE_SUFFIXES",
    "Image",
    "Pixels",
    "Recording",
    "Unreadable",
    "open_recording",
    "picture_files",
    "read_image",
    "read_size",
    "write_picture",
]

"""Pictures and recordings, in and out."""

from calichrome.imaging.files import (
    MAX_MEGAPIXELS,
    PICTURE_SUFFIXES,
    read_image,
    read_size,
    write_picture,
)
from calichrome.imaging.frame_choice import MAX_FRAMES, choose_frames
from calichrome.imaging.header import Unreadable
from calichrome.imaging.image import Image, Pixels
from calichrome.imaging.recording import Recording, open_recording, picture_files

__all__ = [
    "MAX_FRAMES",
    "MAX_MEGAPIXELS",
    "PICTURE_SUFFIXES",
    "Image",
    "Pixels",
    "Recording",
    "Unreadable",
    "choose_frames",
    "open_recording",
    "picture_files",
    "read_image",
    "read_size",
    "write_picture",
]

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
from calichrome.imaging.recording_times import copy_timestamps
from calichrome.imaging.recording_videos import video_files
from calichrome.imaging.video import VIDEO_SUFFIXES, Video, open_video, read_frame
from calichrome.imaging.video_stream import StreamFormat, TimedFrame, stream_format, timed_frames
from calichrome.imaging.video_writer import Preset, VideoSettings, VideoWriter
from calichrome.imaging.yuv import BT709, rgb_of_frame

__all__ = [
    "BT709",
    "MAX_FRAMES",
    "MAX_MEGAPIXELS",
    "PICTURE_SUFFIXES",
    "VIDEO_SUFFIXES",
    "Image",
    "Pixels",
    "Preset",
    "Recording",
    "StreamFormat",
    "TimedFrame",
    "Unreadable",
    "Video",
    "VideoSettings",
    "VideoWriter",
    "choose_frames",
    "copy_timestamps",
    "open_recording",
    "open_video",
    "picture_files",
    "read_frame",
    "read_image",
    "read_size",
    "rgb_of_frame",
    "stream_format",
    "timed_frames",
    "video_files",
    "write_picture",
]

"""Pictures corrected by a calibrated rig."""

from calichrome.apply.corrector import OUTPUT_SPACES, Corrector, Kernel, OutputSpace
from calichrome.apply.frame_format import ChannelOrder, FrameFormat, PixelType
from calichrome.apply.sheets import before_after_sheet, crop_around, picture_grid, rectified_sheet
from calichrome.apply.source_maps import SourceMap, rectifying_map, undistorting_map

__all__ = [
    "OUTPUT_SPACES",
    "ChannelOrder",
    "Corrector",
    "FrameFormat",
    "Kernel",
    "OutputSpace",
    "PixelType",
    "SourceMap",
    "before_after_sheet",
    "crop_around",
    "picture_grid",
    "rectified_sheet",
    "rectifying_map",
    "undistorting_map",
]

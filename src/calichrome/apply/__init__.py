"""Pictures corrected by a calibrated rig."""

from calichrome.apply.corrector import (
    OUTPUT_SPACES,
    Corrector,
    OutputSpace,
    SourceMap,
    rectifying_map,
    undistorting_map,
)
from calichrome.apply.sheets import before_after_sheet, crop_around, picture_grid, rectified_sheet

__all__ = [
    "OUTPUT_SPACES",
    "Corrector",
    "OutputSpace",
    "SourceMap",
    "before_after_sheet",
    "crop_around",
    "picture_grid",
    "rectified_sheet",
    "rectifying_map",
    "undistorting_map",
]

"""A calibration in the formats of other programs, one file per format."""

from calichrome.export.cube import CubeSpace, bake_cube, cube_text
from calichrome.export.opencv import opencv_camera, opencv_pair
from calichrome.export.ros import ros_camera, ros_pair

__all__ = [
    "CubeSpace",
    "bake_cube",
    "cube_text",
    "opencv_camera",
    "opencv_pair",
    "ros_camera",
    "ros_pair",
]

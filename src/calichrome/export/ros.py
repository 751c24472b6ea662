"""ROS camera_info as the packages of image_pipeline and camera_info_manager read it."""

import re

import numpy as np

from calichrome.core.arrays import FloatArray
from calichrome.errors import SolveError
from calichrome.export.opencv_terms import distortion, yaml_numbers
from calichrome.geometry.rectification import Rectification
from calichrome.rig import Camera

__all__ = ["ros_camera", "ros_pair"]

# sensor_msgs/distortion_models.h
_MODELS = {
    "brown-conrady": "plumb_bob",
    "rational": "rational_polynomial",
    "kannala-brandt": "equidistant",
}


def ros_camera(name: str, camera: Camera) -> str:
    """Return the camera_info of one camera by itself: P = [K | 0], so undistorting keeps K.

    Parameters
    ----------
    name
        Its id; characters that ROS does not allow in a camera name become underscores.
    camera
        From a rig.
    """
    projection = np.column_stack([camera.lens.matrix, np.zeros(3)])
    return _camera_info(name, camera, np.eye(3), projection)


def ros_pair(
    names: tuple[str, str], cameras: tuple[Camera, Camera], rectification: Rectification
) -> tuple[str, str]:
    """Return the camera_info of the left and the right camera of a stereo pair.

    Parameters
    ----------
    names, cameras
        The pair in the order of `rectification`.
    rectification
        Of these cameras.

    Raises
    ------
    SolveError
        If stereo_image_proc could not use it: the first camera is not the left one, they stand
        above each other, or differ in size.

    Notes
    -----
    With B the baseline in metres, the right camera has P[0, 3] = -fx' B.

    References
    ----------
    .. [1] ROS, sensor_msgs/CameraInfo.msg, on R and P.
    """
    first, second = names
    if rectification.vertical:
        raise SolveError(
            f"{first} and {second} stand above each other, and ROS matches along rows; export them "
            f"one by one, or use --to opencv"
        )
    if rectification.baseline_m < 0:
        raise SolveError(
            f"{second} is left of {first}, and ROS wants the left camera first; give --pair "
            f"{second},{first}"
        )
    if cameras[0].size_wh != cameras[1].size_wh:
        raise SolveError(
            f"{first} and {second} have pictures of different sizes, and ROS rectifies each at its "
            f"own; export them one by one, or use --to opencv"
        )
    left, right = (
        _camera_info(name, camera, half.rect_from_cam, half.projection)
        for name, camera, half in zip(
            names, cameras, (rectification.a, rectification.b), strict=True
        )
    )
    return left, right


def _camera_info(
    name: str, camera: Camera, rect_from_cam: FloatArray, projection: FloatArray
) -> str:
    coefficients = distortion(camera.lens)
    lines = [
        f"image_width: {camera.size_wh[0]}",
        f"image_height: {camera.size_wh[1]}",
        # quoted, or a camera called 0 would be a number to some readers
        f'camera_name: "{re.sub(r"[^A-Za-z0-9_]", "_", name)}"',
        *_matrix("camera_matrix", camera.lens.matrix),
        f"distortion_model: {_MODELS[camera.lens.MODEL]}",
        *_matrix("distortion_coefficients", np.array([coefficients])),
        *_matrix("rectification_matrix", rect_from_cam),
        *_matrix("projection_matrix", projection),
    ]
    return "\n".join(lines) + "\n"


def _matrix(key: str, values: FloatArray) -> list[str]:
    rows, columns = values.shape
    data = f"  data: {yaml_numbers(values.ravel())}"
    return [f"{key}:", f"  rows: {rows}", f"  cols: {columns}", data]

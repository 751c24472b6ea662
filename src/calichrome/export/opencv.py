"""OpenCV's YAML: what ``cv2.FileStorage`` reads, one camera or a rectified pair."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from calichrome.core.pose import Pose
from calichrome.export.opencv_terms import distortion, yaml_numbers
from calichrome.geometry.rectification import Rectification
from calichrome.rig import Camera

__all__ = ["opencv_camera", "opencv_pair"]

_LENSES = {
    "brown-conrady": "k1 k2 p1 p2 k3 of cv2.projectPoints",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6 of cv2.projectPoints",
    "kannala-brandt": "k1 k2 k3 k4 of cv2.fisheye.projectPoints",
}


def opencv_camera(name: str, camera: Camera) -> str:
    """Return the YAML of one camera.

    Parameters
    ----------
    name
        Its id.
    camera
        From a rig.

    Returns
    -------
    str
        ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` as the
        calibration sample of OpenCV names them, ``lens_model``, and ``R``, ``T`` (metres) of
        x_camera = R x_reference + T.
    """
    return _document(
        f"lens: {_LENSES[camera.lens.MODEL]}; x_camera = R x_reference + T, metres",
        {
            "camera_name": name,
            "image_width": camera.size_wh[0],
            "image_height": camera.size_wh[1],
            "lens_model": camera.lens.MODEL,
            "camera_matrix": camera.lens.matrix,
            "distortion_coefficients": [distortion(camera.lens)],
            **_motion(camera.cam_from_ref),
        },
    )


def opencv_pair(
    names: tuple[str, str], cameras: tuple[Camera, Camera], rectification: Rectification
) -> str:
    """Return the YAML of two cameras and their rectification.

    Parameters
    ----------
    names, cameras
        The pair in the order of `rectification`.
    rectification
        Of these cameras.

    Returns
    -------
    str
        ``M1 D1 M2 D2 R T R1 R2 P1 P2 Q`` as ``cv2.stereoCalibrate`` and ``cv2.stereoRectify`` name
        them (metres, x_2 = R x_1 + T), ``image_size_1``, ``image_size_2`` (width, height) and
        ``image_width``, ``image_height`` of the rectified pictures.
    """
    first, second = cameras
    return _document(
        f"1 is {names[0]}, lens {_LENSES[first.lens.MODEL]}; 2 is {names[1]}, lens "
        f"{_LENSES[second.lens.MODEL]}; x_2 = R x_1 + T, metres",
        {
            "camera_names": list(names),
            "image_width": rectification.size_wh[0],
            "image_height": rectification.size_wh[1],
            "image_size_1": list(first.size_wh),
            "image_size_2": list(second.size_wh),
            "lens_model_1": first.lens.MODEL,
            "lens_model_2": second.lens.MODEL,
            "M1": first.lens.matrix,
            "D1": [distortion(first.lens)],
            "M2": second.lens.matrix,
            "D2": [distortion(second.lens)],
            **_motion(second.cam_from_ref @ first.cam_from_ref.inverse()),
            "R1": rectification.a.rect_from_cam,
            "R2": rectification.b.rect_from_cam,
            "P1": rectification.a.projection,
            "P2": rectification.b.projection,
            "Q": rectification.disparity_to_depth,
        },
    )


def _motion(pose: Pose) -> dict[str, ArrayLike]:
    return {"R": pose.rotation, "T": pose.trans_m[:, None]}


def _document(comment: str, entries: Mapping[str, ArrayLike]) -> str:
    """Write a YAML document; strings, integers and lists of them stay, the rest are matrices."""
    lines = ["%YAML 1.2", "---", f"# {comment}"]
    for key, value in entries.items():
        if isinstance(value, str):
            lines.append(f"{key}: {_quoted(value)}")
        elif isinstance(value, int):
            lines.append(f"{key}: {value}")
        elif isinstance(value, list) and isinstance(value[0], (str, int)):
            items = [_quoted(item) if isinstance(item, str) else str(item) for item in value]
            lines.append(f"{key}: [ {', '.join(items)} ]")
        else:
            matrix = np.asarray(value, dtype=np.float64)
            lines += [
                f"{key}: !!opencv-matrix",
                f"   rows: {matrix.shape[0]}",
                f"   cols: {matrix.shape[1]}",
                "   dt: d",
                f"   data: {yaml_numbers(matrix.ravel())}",
            ]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'

"""camera_info read as image_pipeline reads it, and used as image_geometry does."""

import re
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.export import ros_camera, ros_pair
from calichrome.pipeline.rectified_pair import rectified_pair
from calichrome.rig import Rig

_EXACT_PX = 1e-6
# the resolver of YAML 1.1 (PyYAML, and so ROS 1): without point or sign a number is a string
_FLOAT = re.compile(r"[-+]?[0-9]+\.[0-9]*(?:e[-+][0-9]+)?")
_KEYS = [
    "image_width", "image_height", "camera_name", "camera_matrix", "distortion_model",
    "distortion_coefficients", "rectification_matrix", "projection_matrix",
]  # fmt: skip


def _read(text: str) -> dict[str, Any]:
    """Read the block style that `ros` writes, strictly."""
    read: dict[str, Any] = {}
    matrix: dict[str, Any] = {}
    for line in text.splitlines():
        key, colon, value = line.strip().partition(":")
        value = value.strip()
        assert colon
        if line.startswith("  "):
            numbers = value.strip("[]").split(", ")
            if key == "data":
                assert all(_FLOAT.fullmatch(number) for number in numbers)
                values = np.array([float(number) for number in numbers])
                matrix["values"] = values.reshape(matrix["rows"], matrix["cols"])
            else:
                matrix[key] = int(value)
        elif value:
            read[key] = int(value) if value.isdigit() else value
        else:
            read[key] = matrix = {}
    return {key: item["values"] if isinstance(item, dict) else item for key, item in read.items()}


def _raw(info: dict[str, Any], rays_cam: FloatArray) -> FloatArray:
    """Where image_geometry says that rays of the camera lie in the raw picture."""
    matrix, coefficients = info["camera_matrix"], info["distortion_coefficients"]
    points, zero = rays_cam.reshape(-1, 1, 3), np.zeros(3)
    if info["distortion_model"] == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, matrix, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, matrix, coefficients)
    return np.asarray(pixels).reshape(-1, 2)


@pytest.mark.parametrize(
    ("name", "model", "n_coefficients"),
    [("left", "plumb_bob", 5), ("right", "rational_polynomial", 8), ("wide", "equidistant", 4)],
)
def test_a_camera_projects_alike(
    name: str, model: str, n_coefficients: int, rig: Rig, points_ref: FloatArray
) -> None:
    camera = rig.cameras[name]
    info = _read(ros_camera(name, camera))
    assert list(info) == _KEYS
    assert info["camera_name"] == f'"{name}"'
    assert info["distortion_model"] == model
    assert info["distortion_coefficients"].shape == (1, n_coefficients)
    points_cam = camera.cam_from_ref.apply(points_ref)
    np.testing.assert_allclose(_raw(info, points_cam), camera.project(points_ref), atol=_EXACT_PX)
    np.testing.assert_array_equal(info["rectification_matrix"], np.eye(3))
    expected = np.column_stack([camera.lens.matrix, np.zeros(3)])
    np.testing.assert_array_equal(info["projection_matrix"], expected)


def test_a_pair_sees_the_same_point(rig: Rig, points_ref: FloatArray) -> None:
    """As image_geometry projects: u = (fx' X + cx' Z + Tx) / Z in the left rectified frame."""
    names = ("left", "right")
    cameras = rig.cameras["left"], rig.cameras["right"]
    infos = [_read(text) for text in ros_pair(names, cameras, rectified_pair(rig, names, None))]
    in_rect = cameras[0].cam_from_ref.apply(points_ref) @ infos[0]["rectification_matrix"].T
    rows = []
    for camera, info in zip(cameras, infos, strict=True):
        projection = info["projection_matrix"]
        u = (projection[0, 0] * in_rect[:, 0] + projection[0, 3]) / in_rect[:, 2] + projection[0, 2]
        v = projection[1, 1] * in_rect[:, 1] / in_rect[:, 2] + projection[1, 2]
        rows.append(v)
        shown = np.column_stack([u, v, np.ones(len(u))])
        rays = shown @ np.linalg.inv(projection[:, :3]).T @ info["rectification_matrix"]
        np.testing.assert_allclose(_raw(info, rays), camera.project(points_ref), atol=_EXACT_PX)
    np.testing.assert_array_equal(rows[0], rows[1])
    right = infos[1]["projection_matrix"]
    baseline_m = np.linalg.norm(cameras[1].cam_from_ref.trans_m)
    assert right[0, 3] == pytest.approx(-right[0, 0] * baseline_m, rel=1e-12)
    assert infos[0]["projection_matrix"][0, 3] == 0


@pytest.mark.parametrize(
    ("names", "says"),
    [(("right", "left"), "--pair left,right"), (("left", "above"), "stand above each other")],
)
def test_pairs_that_ros_cannot_use_are_refused(names: tuple[str, str], says: str, rig: Rig) -> None:
    above = replace(rig.cameras["left"], cam_from_ref=Pose(np.eye(3), np.array([0, 0.1, 0])))
    cameras = {**rig.cameras, "above": above}
    rectification = rectified_pair(replace(rig, cameras=cameras), names, None)
    with pytest.raises(SolveError, match=says):
        ros_pair(names, (cameras[names[0]], cameras[names[1]]), rectification)


def test_names_are_those_that_ros_allows(rig: Rig) -> None:
    text = ros_camera("cam 0/é", rig.cameras["left"])
    assert _read(text)["camera_name"] == '"cam_0__"'

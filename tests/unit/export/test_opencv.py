"""What OpenCV reads from our YAML projects as the rig does."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.export import opencv_camera, opencv_pair
from calichrome.pipeline.rectified_pair import rectified_pair
from calichrome.rig import Rig

_EXACT_PX = 1e-6


def _read(text: str, folder: Path) -> dict[str, FloatArray]:
    """All matrices of a file of ours, by OpenCV's own reader."""
    path = folder / "file.yaml"
    path.write_text(text, encoding="utf-8")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    nodes = {key: storage.getNode(key) for key in storage.root().keys()}  # noqa: SIM118
    matrices = {key: np.asarray(node.mat()) for key, node in nodes.items() if node.isMap()}
    numbers = {key: np.array(node.real()) for key, node in nodes.items() if node.isInt()}
    storage.release()
    return matrices | numbers


def _projected(
    points_cam: FloatArray, matrix: FloatArray, coefficients: FloatArray, *, fisheye: bool
) -> FloatArray:
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    zero = np.zeros(3)
    pixels = project(points_cam.reshape(-1, 1, 3), zero, zero, matrix, coefficients)[0]
    return np.asarray(pixels).reshape(-1, 2)


@pytest.mark.parametrize("name", ["left", "right", "wide"])
def test_a_camera_projects_alike(
    name: str, rig: Rig, points_ref: FloatArray, tmp_path: Path
) -> None:
    read = _read(opencv_camera(name, rig.cameras[name]), tmp_path)
    points_cam = points_ref @ read["R"].T + read["T"].T
    pixels = _projected(
        points_cam,
        read["camera_matrix"],
        read["distortion_coefficients"],
        fisheye=name == "wide",
    )
    np.testing.assert_allclose(pixels, rig.cameras[name].project(points_ref), atol=_EXACT_PX)
    size = [int(read["image_width"]), int(read["image_height"])]
    assert size == list(rig.cameras[name].size_wh)


@pytest.mark.parametrize("pair", [("left", "right"), ("wide", "left")])
def test_a_pair_projects_and_rectifies_alike(
    pair: tuple[str, str], rig: Rig, points_ref: FloatArray, tmp_path: Path
) -> None:
    first, second = (rig.cameras[name] for name in pair)
    text = opencv_pair(pair, (first, second), rectified_pair(rig, pair, None))
    read = _read(text, tmp_path)
    points_1 = first.cam_from_ref.apply(points_ref)
    points_2 = points_1 @ read["R"].T + read["T"].T
    shown = []
    for number, camera, points_cam in (("1", first, points_1), ("2", second, points_2)):
        fisheye = camera.lens.MODEL == "kannala-brandt"
        own = read[f"M{number}"], read[f"D{number}"]
        pixels = _projected(points_cam, *own, fisheye=fisheye)
        np.testing.assert_allclose(pixels, camera.project(points_ref), atol=_EXACT_PX)
        turned = points_cam @ read[f"R{number}"].T @ read[f"P{number}"][:, :3].T
        shown.append(turned[:, :2] / turned[:, 2:])
    np.testing.assert_allclose(shown[0][:, 1], shown[1][:, 1], atol=_EXACT_PX)
    # P2 sees the points of the first rectified camera, and Q takes disparities back to them
    in_rect = points_1 @ read["R1"].T
    from_first = np.column_stack([in_rect, np.ones(len(in_rect))]) @ read["P2"].T
    np.testing.assert_allclose(from_first[:, :2] / from_first[:, 2:], shown[1], atol=_EXACT_PX)
    disparity = shown[0][:, :1] - shown[1][:, :1]
    back = np.column_stack([shown[0], disparity, np.ones(len(disparity))]) @ read["Q"].T
    np.testing.assert_allclose(back[:, :3] / back[:, 3:], in_rect, atol=1e-9)

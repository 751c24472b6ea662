"""What a user may say of the camera that corrected pictures have."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.errors import CalichromeError, FileFormatError
from calichrome.geometry.lenses import BrownConrady
from calichrome.imaging import write_picture
from calichrome.pipeline.correct import correct
from calichrome.pipeline.new_view import NewView
from calichrome.rig import Rig


def _spot(picture: Path) -> FloatArray:
    stored = cv2.imread(str(picture))
    assert stored is not None
    weights = stored.max(axis=2).astype(float)
    y, x = np.indices(weights.shape)
    return np.array([np.average(axis, weights=weights) for axis in (x, y)])


@pytest.fixture
def distorted(rig: Rig) -> Rig:
    lens = BrownConrady(fx=120, fy=121, cx=82, cy=57, k1=-0.25, k2=0.06)
    cameras = {
        name: replace(camera, lens=lens, size_wh=(160, 120)) for name, camera in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


@pytest.fixture
def recording(distorted: Rig, tmp_path: Path) -> Path:
    """A point of light at (0.2, -0.15, 1)."""
    ray = np.array([[0.2, -0.15, 1.0]])
    place = np.rint(distorted.cameras["left"].lens.project(ray)[0]).astype(int)
    pixels = np.zeros((120, 160, 3), np.uint8)
    pixels[place[1] - 1 : place[1] + 2, place[0] - 1 : place[0] + 2] = [255, 200, 90]
    write_picture(tmp_path / "in" / "left" / "1.png", pixels)
    return tmp_path / "in"


_FILE = {"size_wh": [120, 100], "fx": 90.0, "fy": 95.0, "cx": 50.0, "cy": 60.0}


@pytest.mark.parametrize(
    "view",
    [
        NewView(undistort=True),
        NewView(valid_area="all"),
        NewView(valid_area="valid", keep_size=True),
        NewView(new_camera="right"),
        NewView(new_camera="FILE"),
    ],
)
def test_cameras_json_says_where_things_are(
    distorted: Rig, recording: Path, tmp_path: Path, view: NewView
) -> None:
    """The point is seen where the written pinhole has it."""
    if view.new_camera == "FILE":
        (tmp_path / "new.json").write_text(json.dumps(_FILE))
        view = replace(view, new_camera=str(tmp_path / "new.json"))
    correct(distorted, recording, tmp_path / "out", space="none", view=view)
    stored = json.loads((tmp_path / "out" / "cameras.json").read_text())
    assert (stored["format"], stored["format_version"]) == ("calichrome.cameras", 1)
    pinhole = stored["cameras"]["left"]
    picture = cv2.imread(str(tmp_path / "out" / "left" / "1.png"))
    assert picture is not None
    assert [picture.shape[1], picture.shape[0]] == pinhole["size_wh"]
    place = _spot(tmp_path / "out" / "left" / "1.png")
    expected = [
        0.2 * pinhole["fx"] + pinhole["cx"],
        -0.15 * pinhole["fy"] + pinhole["cy"],
    ]
    assert place == pytest.approx(expected, abs=0.7)  # drawn to half a pixel


def test_nothing_said_nothing_written(distorted: Rig, recording: Path, tmp_path: Path) -> None:
    correct(distorted, recording, tmp_path / "out")
    assert not (tmp_path / "out" / "cameras.json").exists()


def test_contradictions_are_refused() -> None:
    with pytest.raises(CalichromeError, match="give one"):
        NewView(valid_area="all", new_camera="left")
    with pytest.raises(CalichromeError, match="add --valid-area"):
        NewView(keep_size=True)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{", "Invalid JSON"),
        (json.dumps(_FILE | {"fx": -1}), "fx"),
        (json.dumps(_FILE | {"cx": "left"}), "cx"),
        (json.dumps({"size_wh": [10, 10]}), "fx"),
    ],
)
def test_a_bad_file_is_named(
    distorted: Rig, recording: Path, tmp_path: Path, content: str, reason: str
) -> None:
    path = tmp_path / "new.json"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=rf"new\.json: {reason}"):
        correct(distorted, recording, tmp_path / "out", view=NewView(new_camera=str(path)))
    path.write_text(json.dumps(_FILE | {"size_wh": [100_000, 100_000]}))
    with pytest.raises(CalichromeError, match="would be 100000x100000"):
        correct(distorted, recording, tmp_path / "out", view=NewView(new_camera=str(path)))


def test_an_unknown_camera_is_named(distorted: Rig, recording: Path, tmp_path: Path) -> None:
    with pytest.raises(CalichromeError, match=r"neither a camera of the rig \(left, right\) nor"):
        correct(distorted, recording, tmp_path / "out", view=NewView(new_camera="middle"))

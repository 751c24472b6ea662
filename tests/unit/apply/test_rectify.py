"""Rectified pictures on disk: what is shown, in which order, and what is written beside them."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.cli.main import main
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.pose import Pose
from calichrome.errors import SolveError
from calichrome.geometry.rectified_area import Framing, ValidArea
from calichrome.imaging import write_picture
from calichrome.pipeline.rectify import rectify
from calichrome.rig import Camera, Rig, save_rig
from calichrome.target import chessboard

_RIGHT_FROM_LEFT = Pose.from_rotvec([0.01, 0.05, -0.02], [-0.1, 0.004, 0.002])


def _rig(camera: Camera, right_from_left: Pose) -> Rig:
    plain = replace(camera, colour=None)
    return Rig(
        target=chessboard((9, 6), (0.03, 0.03)),
        reference_camera="left",
        cameras={"left": plain, "right": replace(plain, cam_from_ref=right_from_left)},
        pairs=(),
        frames={},
    )


@pytest.fixture
def rig(camera: Camera) -> Rig:
    return _rig(camera, _RIGHT_FROM_LEFT)


@pytest.fixture
def recording(camera: Camera, tmp_path: Path) -> Path:
    """White pictures with a dark spot where a point at 0.6 m is seen."""
    lens, (width, height) = camera.lens, camera.size_wh
    point_left = np.array([[0.03, -0.04, 0.6]])
    places = {"left": point_left, "right": _RIGHT_FROM_LEFT.apply(point_left)}
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    for name, point in places.items():
        spot = lens.project(point)[0]
        distance = np.hypot(x - spot[0], y - spot[1])
        grey = np.where(distance < 6, 40 + distance**2 * 5, 255).clip(0, 255)
        pixels = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
        write_picture(tmp_path / "in" / name / "1.png", pixels)
    return tmp_path / "in"


def _picture(folder: Path, name: str) -> UInt8Array:
    stored = cv2.imread(str(folder / name / "1.png"), cv2.IMREAD_GRAYSCALE)
    assert stored is not None
    return np.asarray(stored, dtype=np.uint8)


def _spot(picture: UInt8Array) -> FloatArray:
    """Centre of what is darker than half, but not black as nothing is."""
    dark = np.where((picture > 20) & (picture < 200), 220.0 - picture, 0)
    y, x = np.indices(picture.shape)
    return np.array([np.average(x, weights=dark), np.average(y, weights=dark)])


@pytest.mark.parametrize("pair", [("left", "right"), ("right", "left")])
def test_the_file_says_where_the_point_is(
    rig: Rig, recording: Path, tmp_path: Path, pair: tuple[str, str]
) -> None:
    """Disparity of the written pictures and Q of the written file: 0.6 m, in either order."""
    out = tmp_path / "out"
    rectify(rig, pair, recording, out, framing=Framing(area="valid"))
    stored = json.loads((out / "rectification.json").read_text())
    assert stored["cameras"] == list(pair)
    spot_a, spot_b = (_spot(_picture(out, name)) for name in pair)
    assert spot_a[1] == pytest.approx(spot_b[1], abs=0.1)  # px, centres of spots of 8 bits
    disparity = spot_a[0] - spot_b[0]
    assert (disparity > 0) == (pair == ("left", "right"))
    x, y, z, w = np.array(stored["Q"]) @ [*spot_a, disparity, 1]
    in_camera = np.array(stored["R1"]).T @ [x / w, y / w, z / w]
    at_first = {"left": [0.03, -0.04, 0.6]}
    at_first["right"] = list(_RIGHT_FROM_LEFT.apply(np.array(at_first["left"])))
    # 0.1 px of a disparity of 20 px
    np.testing.assert_allclose(in_camera, at_first[pair[0]], atol=0.006)
    assert stored["P1"][0][0] == stored["P2"][0][0]


@pytest.mark.parametrize("area", ["all", "valid"])
def test_black_borders(rig: Rig, recording: Path, tmp_path: Path, area: ValidArea) -> None:
    result = rectify(
        rig, ("left", "right"), recording, tmp_path / "out", framing=Framing(area=area)
    )
    pictures = [_picture(tmp_path / "out", name) for name in ("left", "right")]
    assert all((picture == 0).any() for picture in pictures) == (area == "all")
    halves = result.rectification
    shares = [halves.a.share, halves.b.share]
    assert (min(shares) == 1) == (area == "all")


def test_cameras_that_face_each_other_are_named(
    camera: Camera, recording: Path, tmp_path: Path
) -> None:
    facing = Pose.from_rotvec([0, np.pi, 0], [0, 0, 1])
    with pytest.raises(SolveError, match="left and right: no plane shows both"):
        rectify(_rig(camera, facing), ("left", "right"), recording, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_command(
    rig: Rig, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rig(rig, None, tmp_path / "rig.json")
    words = ["rectify", str(tmp_path / "rig.json"), str(recording)]
    swapped = [*words, "--pair", "right,left", "-o", str(tmp_path / "a")]
    assert main(swapped) == 0
    said = capsys.readouterr().out
    assert "100% and 100% of the pictures" in said
    assert "left is left of right, so disparities are negative" in said
    assert "--pair left,right" in said
    options = ["--valid-area", "valid", "--principal-points", "own", "--json"]
    assert main([*words, "--pair", "left,right", *options, "-o", str(tmp_path / "b")]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert max(answer["shares"]) < 1
    assert answer["P1"][0][2] != answer["P2"][0][2]
    assert "disparities" not in str(answer)

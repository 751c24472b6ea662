"""Whole recordings corrected: which files, and with which numbers."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PilImage

from calichrome.apply import OutputSpace
from calichrome.colorimetry.icc_profile import icc_profile
from calichrome.errors import CalichromeError, OutputError, RecordingError
from calichrome.imaging import Pixels, write_picture
from calichrome.pipeline.correct import correct
from calichrome.pipeline.new_view import NewView
from calichrome.pipeline.rectify import rectify
from calichrome.rig import Rig

_SIZE_WH = (32, 24)


def _filled(value: float, dtype: type[np.generic]) -> Pixels:
    pixels = np.full((_SIZE_WH[1], _SIZE_WH[0], 3), value, dtype=dtype)
    pixels[..., 2] = 0  # a colour
    return pixels


@pytest.mark.parametrize(
    ("name", "dtype", "space", "written"),
    [
        ("1.png", np.uint8, "srgb", "1.png"),
        ("1.jpg", np.uint8, "srgb", "1.jpg"),
        ("1.tif", np.uint8, "srgb", "1.png"),
        ("1.png", np.uint16, "srgb", "1.tif"),
        ("1.png", np.uint8, "linear-srgb", "1.tif"),
        ("1.jpg", np.uint8, "xyz-d65", "1.tif"),
    ],
)
def test_formats_of_the_contract(
    rig: Rig, tmp_path: Path, name: str, dtype: type[np.generic], space: OutputSpace, written: str
) -> None:
    """8 bit gives PNG, JPEG gives JPEG, 16 bit and float give TIFF."""
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / name, _filled(100, dtype))
    done = correct(rig, tmp_path / "in", tmp_path / "out", space=space)
    assert list(done.written) == [
        tmp_path / "out" / camera / written for camera in ("left", "right")
    ]
    assert all(path.is_file() for path in done.written)


@pytest.mark.parametrize("name", ["1.png", "1.jpg"])
@pytest.mark.parametrize("space", ["srgb", "display-p3", "none"])
def test_pictures_name_their_space(rig: Rig, tmp_path: Path, name: str, space: OutputSpace) -> None:
    write_picture(tmp_path / "in" / "left" / name, _filled(100, np.uint8))
    (path,) = correct(rig, tmp_path / "in", tmp_path / "out", space=space).written
    with PilImage.open(path) as picture:
        assert picture.info.get("icc_profile") == icc_profile(space)


def test_bits_of_recording_toml(rig: Rig, tmp_path: Path) -> None:
    """Half of 12 bits is half of full scale, not a thirty-second."""
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / "1.png", _filled(2048, np.uint16))
    (tmp_path / "in" / "recording.toml").write_text('bits = 12\nencoding = "linear"\n')
    done = correct(rig, tmp_path / "in", tmp_path / "out", space="xyz-d65")
    stored = cv2.imread(str(done.written[0]), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    np.testing.assert_allclose(stored[3, 4, ::-1], [2048 / 4095, 2048 / 4095, 0], atol=1e-4)


def test_single_picture_and_flat_folder(rig: Rig, tmp_path: Path) -> None:
    picture = tmp_path / "flat" / "7.png"
    write_picture(picture, _filled(90, np.uint8))
    assert correct(rig, picture, tmp_path / "a", camera="right").written == (
        tmp_path / "a" / "right" / "7.png",
    )
    assert correct(rig, picture.parent, tmp_path / "b", camera="left").written == (
        tmp_path / "b" / "left" / "7.png",
    )
    only = replace(rig, cameras={"left": rig.cameras["left"]})
    assert correct(only, picture, tmp_path / "c").written == (tmp_path / "c" / "left" / "7.png",)


def test_failure_half_way_leaves_nothing(rig: Rig, tmp_path: Path) -> None:
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / "1.png", _filled(90, np.uint8))
    write_picture(tmp_path / "in" / "right" / "1.png", _filled(90, np.uint8)[1:], force=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(CalichromeError, match=r"right.1\.png: the picture is"):
        correct(rig, tmp_path / "in", tmp_path / "out")
    assert sorted(tmp_path.rglob("*")) == before


def test_recording_is_never_replaced(rig: Rig, tmp_path: Path) -> None:
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / "1.png", _filled(90, np.uint8))
    for output in (tmp_path / "in", tmp_path):
        with pytest.raises(OutputError, match="which is read"):
            correct(rig, tmp_path / "in", output, force=True)
    inside = correct(rig, tmp_path / "in", tmp_path / "in" / "corrected")
    assert inside.written[0].is_file()


def test_nothing_speaks_of_pictures_that_are_gone(rig: Rig, tmp_path: Path) -> None:
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / "1.png", _filled(90, np.uint8))
    stamps = tmp_path / "in" / "timestamps.csv"
    stamps.write_text("camera,frame,time_s\nleft,1,0.5\nright,1,0.5\n")
    out = tmp_path / "out"
    correct(rig, tmp_path / "in", out, view=NewView(undistort=True))
    assert (out / "cameras.json").is_file()
    assert (out / "timestamps.csv").read_text() == stamps.read_text()
    (out / "notes.txt").write_text("mine")
    stamps.unlink()
    correct(rig, tmp_path / "in", out, force=True)
    assert {path.name for path in out.iterdir()} == {"left", "right", "notes.txt"}
    stamps.write_text("when,what\n1,2\n")
    with pytest.raises(RecordingError, match="has the columns when, what"):
        correct(rig, tmp_path / "in", tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_what_speaks_of_another_camera_stays(rig: Rig, tmp_path: Path) -> None:
    picture, out = tmp_path / "flat" / "7.png", tmp_path / "out"
    write_picture(picture, _filled(90, np.uint8))
    correct(rig, picture, out, camera="left", view=NewView(undistort=True))
    correct(rig, picture, out, camera="right", force=True)
    assert (out / "cameras.json").is_file()


def test_rectified_float_pictures_are_not_black(rig: Rig, tmp_path: Path) -> None:
    """PNG holds no floats; OpenCV would round them to 0 and 1 in silence."""
    for camera in ("left", "right"):
        write_picture(tmp_path / "in" / camera / "1.tif", _filled(0.5, np.float32))
    rectify(rig, ("left", "right"), tmp_path / "in", tmp_path / "out", space="none")
    stored = cv2.imread(str(tmp_path / "out" / "left" / "1.png"), cv2.IMREAD_UNCHANGED)
    assert stored is not None
    assert stored.dtype == np.uint16
    np.testing.assert_allclose(stored[12, 16, ::-1] / 65535, [0.5, 0.5, 0], atol=1e-4)
    with pytest.raises(RecordingError, match="linear-srgb"):
        rectify(rig, ("left", "right"), tmp_path / "in", tmp_path / "x", space="xyz-d65")


def test_rectified_rows_correspond(rig: Rig, tmp_path: Path) -> None:
    """A point at 1 m, 3 px apart at f = 30 px and 0.1 m: shifted along its row only."""
    for camera, column in (("left", 17), ("right", 14)):
        pixels = np.zeros((_SIZE_WH[1], _SIZE_WH[0], 3), np.uint8)
        pixels[9, column] = [255, 200, 0]
        write_picture(tmp_path / "in" / camera / "1.png", pixels)
    rectify(rig, ("left", "right"), tmp_path / "in", tmp_path / "out", space="none")
    places = []
    for camera in ("left", "right"):
        stored = cv2.imread(str(tmp_path / "out" / camera / "1.png"))
        assert stored is not None
        places.append(np.unravel_index(stored.sum(axis=2).argmax(), stored.shape[:2]))
    (row_a, column_a), (row_b, column_b) = places
    assert row_a == row_b
    assert column_a - column_b == pytest.approx(3, abs=1)

"""Where one command ends and the next begins."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calichrome.cli.main import main
from calichrome.core.pose import Pose
from calichrome.imaging import open_recording
from calichrome.pipeline.calibrate import CalibrationSettings, run
from calichrome.report.text import distance_text


@pytest.fixture(scope="module")
def rig(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rig of the simulated recording; its square size is not measured."""
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    assert main(["calibrate", str(simulated), "-o", str(path)]) == 0
    return path


@pytest.mark.slow
def test_corners_of_a_symmetric_board_come_back(data: Path, tmp_path: Path) -> None:
    """Which way up it was is as open in a corner file as in the pictures."""
    folder, corners = str(data / "boofcv_trinocular_odd"), str(tmp_path / "odd.csv")
    target = ["--target", "chessboard:9x13:30mm"]
    assert main(["detect", folder, *target, "-o", corners]) == 0
    out = tmp_path / "rig.json"
    assert main(["calibrate", folder, "--corners", corners, *target, "-o", str(out)]) == 0
    pairs = json.loads(out.read_text())["pairs"]
    assert len(pairs) == 3
    assert max(pair["rms_px"] for pair in pairs) < 0.2


@pytest.mark.slow
def test_corners_file_knows_no_encoding(simulated: Path, tmp_path: Path) -> None:
    corners, out = tmp_path / "c.csv", tmp_path / "rig.json"
    assert main(["detect", str(simulated), "-o", str(corners)]) == 0
    sizes = ["--size", "cam0=640x480", "--size", "cam1=640x480"]
    target = ["--target", str(simulated / "target.json")]
    assert main(["calibrate", "--corners", str(corners), *sizes, *target, "-o", str(out)]) == 0
    colour = json.loads(out.read_text())["cameras"]["cam0"]["colour"]
    assert colour["encoding"] == {"name": None, "bits": None}


def test_force_leaves_what_it_does_not_write(rig: Path, simulated: Path, tmp_path: Path) -> None:
    out = tmp_path / "precious"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    words = ["correct", str(rig), str(simulated), "-o", str(out)]
    assert main(words) == 1
    assert main([*words, "--force"]) == 0
    assert (out / "thesis.txt").read_text() == "years of work"
    assert len(list(out.rglob("*.png"))) > 0


def test_sheet_inside_the_output_stays(rig: Path, simulated: Path, tmp_path: Path) -> None:
    out = tmp_path / "rectified"
    words = ["rectify", str(rig), str(simulated), "--pair", "cam0,cam1", "-o", str(out)]
    assert main([*words, "--sheet", str(out / "sheet.png")]) == 0
    assert (out / "sheet.png").is_file()
    assert (out / "rectification.json").is_file()


def test_correct_goes_on_past_bad_and_black_pictures(
    rig: Path, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor do the cameras of pictures to be corrected need a common frame."""
    source = tmp_path / "in"
    for camera, frame in (("cam0", "000"), ("cam1", "001")):
        (source / camera).mkdir(parents=True)
        shutil.copy(simulated / camera / f"{frame}.png", source / camera)
    cv2.imwrite(str(source / "cam0" / "black.png"), np.zeros((480, 640, 3), np.uint8))
    (source / "cam1" / "cut.png").write_bytes((simulated / "cam1" / "001.png").read_bytes()[:999])
    assert main(["correct", str(rig), str(source), "-o", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert {Path(name).name for name in said["written"]} == {"000.png", "black.png", "001.png"}
    assert [Path(item["file"]).name for item in said["skipped"]] == ["cut.png"]


@pytest.mark.slow
def test_unverified_scale_is_one_factor_for_all_axes(simulated: Path) -> None:
    """0.5 % of the distance, whichever way the camera lies: axes do not average it away."""
    rigs = [run(simulated, CalibrationSettings(square=size)).rig for size in (None, "30mm")]
    unsure, sure = (item.cameras["cam1"] for item in rigs)
    distance_m = float(np.linalg.norm(unsure.cam_from_ref.trans_m))
    assert unsure.cov_m is not None
    assert sure.cov_m is not None
    direction = unsure.cam_from_ref.trans_m / distance_m
    grown = direction @ (unsure.cov_m - sure.cov_m) @ direction
    assert np.sqrt(grown) == pytest.approx(0.005 * distance_m, rel=1e-6)
    shown_mm = float(distance_text(unsure).split("±")[1])
    assert shown_mm == pytest.approx(5 * distance_m, rel=0.05)
    assert isinstance(unsure.cam_from_ref, Pose)


@pytest.mark.parametrize(
    ("names", "several"),
    [
        (["20240101_120005", "20240101_120106", "20240102_120005"], False),
        (["IMG_0001", "IMG_0002", "IMG_0003"], False),
        (["left01", "left02", "right01", "right02"], True),
        (["frame_01_left", "frame_02_left", "frame_01_right", "frame_02_right"], True),
    ],
)
def test_flat_folders(tmp_path: Path, names: list[str], *, several: bool) -> None:
    for name in names:
        (tmp_path / f"{name}.png").write_bytes(b"")
    if several:
        with pytest.raises(Exception, match="or as cameras"):
            open_recording(tmp_path)
    else:
        assert open_recording(tmp_path).cameras == ("cam0",)

"""Other boards and other sources, from the command line: codes, videos, corner files of mrcal."""

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from calichrome.cli.main import main
from calichrome.imaging import choose_frames, open_recording
from calichrome.observations import read_corners
from calichrome.target import load_target

CALISCOPE = "charuco:4x5:4X4_1000:54mm:40.5mm:inverted"


@pytest.mark.slow
def test_caliscope_yields_corners_of_all_cameras(data: Path, tmp_path: Path) -> None:
    """Videos of a board with black and white exchanged; a tenth of the frames is enough here."""
    folder, corners = data / "caliscope_charuco_4cam", tmp_path / "corners.csv"
    words = ["--target", CALISCOPE, "--max-frames", "12", "--no-cache", "-o", str(corners)]
    assert main(["detect", str(folder), *words]) == 0
    with corners.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    views = {(row["camera"], row["frame"]) for row in rows}
    per_camera = Counter(camera for camera, _ in views)
    # the board is in 46, 35, 44 and 46 of 111 frames; the choice prefers those
    assert set(per_camera) == {"cam_0", "cam_1", "cam_2", "cam_3"}
    assert min(per_camera.values()) >= 6
    shared = Counter(frame for _, frame in views)
    assert max(shared.values()) == 4
    assert {int(row["corner"]) for row in rows} == set(range(12))
    assert all(26 <= int(frame) <= 136 for _, frame in views)  # sync_index


@pytest.mark.slow
def test_caliscope_calibrates(data: Path, tmp_path: Path) -> None:
    """Against the values that caliscope found; its recording is not synchronised to the frame.

    The time stamps of one instant lie up to 43 ms apart while the board moved, and pairs disagree
    by about a pixel: exit code 3 says so. Each lens on its own does not depend on that.
    """
    out = tmp_path / "rig.json"
    words = [str(data / "caliscope_charuco_4cam"), "--target", CALISCOPE, "-o", str(out)]
    assert main(["calibrate", *words, "--method", "pairwise"]) == 3
    rig = json.loads(out.read_text(encoding="utf-8"))
    known_fx = {"cam_0": 903.6, "cam_1": 760.3, "cam_2": 650.8, "cam_3": 639.9}  # config.toml
    for camera, fx in known_fx.items():
        found = rig["cameras"][camera]
        assert found["rms_px"] < 0.3  # caliscope reports 0.33 to 0.54
        assert found["lens"]["fx"] == pytest.approx(fx, rel=0.03)
    assert rig["target"]["codes"]["inverted"] is True
    assert "unsynchronised" in {item["code"] for item in rig["findings"]}


@pytest.mark.slow
def test_videos_of_unknown_cameras_are_not_corrected(
    data: Path, tmp_path: Path, simulated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.json"
    assert main(["calibrate", str(simulated), "-o", str(rig)]) == 0
    capsys.readouterr()
    words = [str(rig), str(data / "caliscope_charuco_4cam"), "-o", str(tmp_path / "out")]
    assert main(["correct", *words]) == 1
    assert "camera cam_0 is not in the rig (cam0, cam1)" in capsys.readouterr().err


def test_max_frames_wants_a_number_of_frames(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = data / "caliscope_charuco_4cam"
    words = ["--target", CALISCOPE, "--max-frames", "0", "-o", str(tmp_path / "c.csv")]
    assert main(["detect", str(folder), *words]) == 1
    assert "--max-frames 0: give 1 or more" in capsys.readouterr().err


@pytest.mark.slow
def test_chosen_frames_show_the_board(data: Path) -> None:
    """The board is held up from the 65th frame on; before, there is only the room."""
    recording = open_recording(data / "caliscope_charuco_4cam")
    chosen = choose_frames(recording, 20)
    frames = [int(frame) - 26 for frame in chosen.files["cam_0"]]
    assert len(frames) == 20
    assert sum(frame >= 64 for frame in frames) >= 18


def test_corners_of_mrcal_give_the_same_rig(simulated: Path, tmp_path: Path) -> None:
    corners = tmp_path / "corners.csv"
    assert main(["detect", str(simulated), "-o", str(corners)]) == 0
    target = load_target(simulated / "target.json")
    sizes = {"cam0": (640, 480), "cam1": (640, 480)}
    lines = ["# filename x y level"]
    for camera, views in read_corners(corners, sizes, target.n_corners).views.items():
        for frame, view in views.items():
            places = dict(zip(view.corner_ids.tolist(), view.corners_px.tolist(), strict=True))
            for corner in range(target.n_corners):
                x, y = places.get(corner, ("-", "-"))
                lines.append(f"{camera}/{frame}.png {x} {y} {'-' if x == '-' else 0}")
    table = tmp_path / "corners.vnl"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    plain = tmp_path / "plain.csv"  # the same without covariances, which mrcal does not know
    with corners.open(encoding="utf-8") as stream:
        rows = [line.split(",")[:5] for line in stream.read().splitlines()]
    plain.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    lenses = []
    for source in (plain, table):
        out = tmp_path / f"{source.stem}-rig.json"
        words = ["calibrate", str(simulated), "--corners", str(source), "-o", str(out)]
        assert main(words) in (0, 3)
        rig = json.loads(out.read_text(encoding="utf-8"))
        lenses.append([rig["cameras"][name]["lens"]["fx"] for name in sizes])
    np.testing.assert_allclose(lenses[0], lenses[1], rtol=1e-6)

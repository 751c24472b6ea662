"""Real recordings, and rendered ones with their truth, through the command line."""

import csv
import json
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.geometry.real_rows import Pair, row_differences_px
from benchmarks.geometry.real_sets import RECORDINGS, RealSet, Recorded
from scipy.spatial.transform import Rotation

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.geometry.halves import compare_halves
from calichrome.geometry.rig_solution import RigSolution
from calichrome.geometry.rig_solve import RigSettings, solve_rig
from calichrome.observations import Dataset

Cli = Callable[..., Any]
Calibrate = Callable[..., dict[str, Any]]

_LEFT_RIGHT = ["--pattern", "{camera:left|right}{frame}"]


@pytest.fixture(scope="session")
def render_truth(data: Path) -> dict[str, Any]:
    truth: dict[str, Any] = json.loads((data / "render" / "truth.json").read_text())
    return truth


@pytest.mark.parametrize(("method", "rms_px"), [("joint", 0.215), ("pairwise", 0.20)])
def test_opencv_stereo(cli: Cli, data: Path, tmp_path: Path, method: str, rms_px: float) -> None:
    """The published result of this recording (OpenCV's samples, after J.-Y. Bouguet)."""
    words = ["--target", "chessboard:9x6:30mm", "--method", method, "--json"]
    words += [*_LEFT_RIGHT, "--reference-camera", "left", "-o", str(tmp_path / "rig.json")]
    outcome = cli("calibrate", data / "opencv_stereo", *words)
    assert (outcome.code, outcome.err) == (0, "")
    rig = outcome.json
    assert rig == json.loads((tmp_path / "rig.json").read_text())
    assert rig["trustworthy"]
    assert [pair["shared_views"] for pair in rig["pairs"]] == [13]
    left, right = rig["cameras"]["left"], rig["cameras"]["right"]
    assert left["lens"]["fx"] == pytest.approx(533.09, abs=1)
    assert left["lens"]["fy"] == pytest.approx(533.22, abs=1)
    assert left["rms_px"] <= rms_px
    found_mm = np.array(right["cam_from_ref"]["translation_m"]) * 1e3
    # published -99.80, 1.12, 0.05 mm with its own uncertainty of 0.14, 0.11, 0.50 mm
    np.testing.assert_array_less(np.abs(found_mm - [-99.80, 1.12, 0.05]), [0.14, 0.11, 0.50])
    assert right["cam_from_ref"]["sigma_m"][0] > 0.4e-3  # 0.5 % of 99.8 mm: scale unverified


def _recorded(item: RealSet, data: Path, cache: Path) -> Recorded:
    recorded = item.read(data, cache)
    assert recorded is not None
    return recorded


def _solve(recorded: Recorded, dataset: Dataset, start: RigSolution | None = None) -> RigSolution:
    settings = RigSettings(reference=recorded.reference, start=start)
    return solve_rig(dataset, recorded.target, settings)


@pytest.mark.parametrize(
    ("name", "limit_px"), [("opencv_stereo", 0.18), ("boofcv_bumblebee2_chess", 0.06)]
)
def test_rows_of_unseen_frames_agree(name: str, limit_px: float, data: Path, cache: Path) -> None:
    """OpenCV's joint fit leaves 0.178 and 0.057 px; benchmarks.geometry.real runs it as well."""
    recorded = _recorded(RECORDINGS[name], data, cache)
    whole = _solve(recorded, recorded.dataset)  # where to begin: the minimum does not depend on it

    def calibrate(dataset: Dataset) -> Pair:
        solved = _solve(recorded, dataset, whole)
        return solved.lenses["left"], solved.lenses["right"], solved.cams_from_ref["right"]

    rows_px = row_differences_px(recorded, "left", "right", calibrate)
    corners = recorded.target.n_corners * len(recorded.dataset.frames)
    assert np.isfinite(rows_px).sum() == corners
    assert np.sqrt(np.mean(rows_px**2)) <= limit_px


def test_halves_of_the_trinocular_frames_agree(data: Path, cache: Path) -> None:
    recorded = _recorded(RECORDINGS["boofcv_trinocular_odd"], data, cache)
    whole = _solve(recorded, recorded.dataset)
    halves = compare_halves(recorded.dataset, partial(_solve, recorded, start=whole))
    assert halves is not None
    for camera in ("left", "right"):
        sigmas = halves.position_sigmas(camera)
        assert sigmas is not None
        np.testing.assert_array_less(np.abs(sigmas), 3)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["joint", "pairwise"])
def test_caliscope_against_its_own_rig(cli: Cli, data: Path, tmp_path: Path, method: str) -> None:
    """Four cameras around a moving board, not recorded at one instant: exit code 3 says so.

    The lenses of `camera_array.toml` are from other recordings, so the principal points differ by
    some 20 px of 760, and with them the directions of both cameras of a pair by 2 degrees.
    """
    folder = data / "caliscope_charuco_4cam"
    target = "charuco:4x5:4X4_1000:54mm:40.5mm:inverted"
    words = ["--target", target, "--method", method, "--reference-camera", "cam_0", "--json"]
    outcome = cli("calibrate", folder, *words, "-o", tmp_path / "rig.json")
    assert outcome.code == 3
    codes = {item["code"] for item in outcome.json["findings"]}
    assert codes & {"unsynchronised", "camera_moved"}
    known = tomllib.loads((folder / "camera_array.toml").read_text())["cameras"]
    places = {
        f"cam_{key}": Pose(np.array(item["rotation"]), np.array(item["translation"]))
        for key, item in known.items()
    }
    for key, item in known.items():
        found = outcome.json["cameras"][f"cam_{key}"]
        assert found["lens"]["fx"] == pytest.approx(item["matrix"][0][0], rel=0.03)
        if method == "pairwise":  # each lens by itself; the joint error holds the contradictions
            assert found["rms_px"] < item["error"]
        expected = places[f"cam_{key}"] @ places["cam_0"].inverse()
        place = found["cam_from_ref"]
        turn = Rotation.from_matrix(np.array(place["rotation"]) @ expected.rotation.T)
        assert np.degrees(turn.magnitude()) < 5
        apart = _position(Pose(np.array(place["rotation"]), np.array(place["translation_m"])))
        distance_m = np.linalg.norm(_position(expected))
        assert np.linalg.norm(apart - _position(expected)) <= 0.05 * distance_m + 1e-9


def _position(cam_from_ref: Pose) -> FloatArray:
    return np.asarray(cam_from_ref.inverse().trans_m)


def test_bumblebee(cli: Cli, data: Path, tmp_path: Path) -> None:
    words = [*_LEFT_RIGHT, "--target", "chessboard:4x6:30mm", "--json"]
    outcome = cli(
        "calibrate", data / "boofcv_bumblebee2_chess", *words, "-o", tmp_path / "rig.json"
    )
    assert (outcome.code, outcome.err) == (0, "")
    assert [pair["shared_views"] for pair in outcome.json["pairs"]] == [11]
    assert all(camera["rms_px"] <= 0.10 for camera in outcome.json["cameras"].values())


def test_trinocular(cli: Cli, data: Path, tmp_path: Path) -> None:
    """Marks inside the white squares, and corner counts that are both odd."""
    words = ["--pattern", "{camera}/{camera}{frame}", "--target", "chessboard:9x13:30mm"]
    folder = data / "boofcv_trinocular_odd"
    outcome = cli("calibrate", folder, *words, "--json", "-o", tmp_path / "rig.json")
    assert (outcome.code, outcome.err) == (0, "")
    rig = outcome.json
    assert set(rig["cameras"]) == {"left", "middle", "right"}
    # a joint fit of OpenCV's classic corners with cornerSubPix: .119 .112 .117
    assert all(camera["held_out_rms_px"] <= 0.120 for camera in rig["cameras"].values())
    everything = {path.stem.removeprefix("left") for path in (folder / "left").iterdir()}
    for name in rig["cameras"]:
        seen = {frame for frame, placed in rig["frames"].items() if name in placed["cameras"]}
        assert everything - seen <= {"25", "27"}


def test_render_geometry(render_rig: dict[str, Any], render_truth: dict[str, Any]) -> None:
    for name, camera in render_rig["cameras"].items():
        true = render_truth["cameras"][name]
        assert camera["lens"]["fx"] == pytest.approx(true["fx"], rel=0.002)
        assert camera["lens"]["fy"] == pytest.approx(true["fy"], rel=0.002)
        assert camera["n_views"] == 12
        assert camera["held_out_rms_px"] is not None
    cam0_from_world, cam1_from_world = (
        np.array(render_truth["cameras"][name]["cam_from_world"]) for name in ("cam0", "cam1")
    )
    true_m = np.linalg.norm((cam1_from_world @ np.linalg.inv(cam0_from_world))[:3, 3])
    found_m = np.linalg.norm(render_rig["cameras"]["cam1"]["cam_from_ref"]["translation_m"])
    assert found_m == pytest.approx(true_m, rel=0.003)


def test_render_colour(render_rig: dict[str, Any]) -> None:
    for camera in render_rig["cameras"].values():
        errors = camera["colour"]["delta_e_2000"]
        assert 0 < errors["fit_mean"] <= 1.1
        assert errors["fit_mean"] < errors["held_out_mean"] < errors["held_out_p95"]
    between = render_rig["inter_camera_delta_e_2000"]
    # a 3x3 of each camera leaves metamerism; both are within 1.1 of one target
    assert 0 < between["mean"] < 1.1
    assert between["mean"] < between["p95"] < 2.2
    codes = {item["code"] for item in render_rig["findings"]}
    assert not codes & {"exposure_changes", "encoding_doubtful", "unsynchronised"}


def _detected(path: Path, n_corners: int) -> dict[tuple[str, str], FloatArray]:
    views: dict[tuple[str, str], FloatArray] = defaultdict(lambda: np.full((n_corners, 2), np.nan))
    with path.open(newline="") as stream:
        for row in csv.DictReader(stream):
            key = row["camera"], row["frame"]
            views[key][int(row["corner"])] = float(row["x"]), float(row["y"])
    return views


@pytest.mark.parametrize(("name", "n_views"), [("recording", 24), ("recording_linear16", 2)])
def test_render_corners(
    cli: Cli,
    data: Path,
    render_truth: dict[str, Any],
    tmp_path: Path,
    name: str,
    n_views: int,
) -> None:
    """Right ids, and a tenth of a pixel, in encoded 8-bit pictures and in linear 16-bit ones."""
    outcome = cli("detect", data / "render" / name, "-o", tmp_path / "c.csv", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.json["rejected"] == []
    views = _detected(tmp_path / "c.csv", 40)
    assert len(views) == n_views
    true = {
        (image["camera"], f"{image['pose']:03d}"): np.array(image["corners_px"], dtype=np.float64)
        for image in render_truth["images"]
    }
    for key, corners in views.items():
        error_px = np.linalg.norm(corners - true[key].reshape(-1, 2), axis=1)
        assert np.sqrt((error_px**2).mean()) < 0.1
        assert error_px.max() < 1  # no single corner went astray, and none is absent


_WATCHED = """
import os, sys
opened = []
sys.addaudithook(
    lambda event, what: opened.append(os.fspath(what[0]))
    if event == "open" and isinstance(what[0], (str, bytes, os.PathLike)) else None
)
from calichrome.cli.main import main

code = main(sys.argv[1:])
names = {os.path.basename(os.fsdecode(path)) for path in opened}
assert "target.json" in names and "000.png" in names, "the hook sees nothing"
print(code, "truth.json" in names)
"""


@pytest.mark.parametrize("command", ["calibrate", "detect"])
def test_nothing_reads_the_truth(simulated: Path, tmp_path: Path, command: str) -> None:
    """A truth.json lies beside the pictures; no command that solves may open it."""
    assert (simulated / "truth.json").is_file()
    words = [command, str(simulated), "--cameras", "cam0", "-o", str(tmp_path / "out.json")]
    run = [sys.executable, "-c", _WATCHED, *words]
    done = subprocess.run(run, capture_output=True, text=True, check=False)  # noqa: S603
    assert done.stderr == ""
    assert done.stdout.splitlines()[-1] == "0 False"

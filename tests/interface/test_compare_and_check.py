"""The commands compare and check, and what two halves of a recording say."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calichrome.core.findings import SEVERITIES
from calichrome.core.pose import Pose
from calichrome.geometry.comparison import LensDifference
from calichrome.geometry.halves import Halves
from calichrome.pipeline.judge_geometry import _judge_halves
from calichrome.pipeline.solve_geometry import SolvedGeometry
from calichrome.rig import Rig, load_evidence, load_rig, save_rig

Cli = Callable[..., Any]
Small = Callable[..., Path]
Refused = Callable[..., str]


@pytest.fixture
def still(simulated: Path, tmp_path: Path) -> Path:
    """Two of the frames that the rig was calibrated with, under other names."""
    folder = tmp_path / "still"
    for camera in ("cam0", "cam1"):
        (folder / camera).mkdir(parents=True)
        for index, path in enumerate(sorted((simulated / camera).iterdir())[3:5]):
            shutil.copy(path, folder / camera / f"new{index}.png")
    return folder


def _changed(simulated_rig: Path, path: Path, **changes: object) -> Path:
    """Write the rig as if cam1 had been calibrated otherwise, with the same evidence."""
    rig = load_rig(simulated_rig)
    cameras = {**rig.cameras, "cam1": replace(rig.cameras["cam1"], **changes)}  # type: ignore[arg-type]
    save_rig(replace(rig, cameras=cameras), load_evidence(simulated_rig.with_suffix(".npz")), path)
    return path


def _moved(rig: Rig) -> Pose:
    """Elsewhere by 5 mm, turned by 0.3 degrees."""
    change = Pose.from_rotvec([0, np.radians(0.3), 0], [0.003, 0.004, 0])
    return change @ rig.cameras["cam1"].cam_from_ref


def _codes(found: dict[str, Any]) -> set[str]:
    assert all(item["severity"] == SEVERITIES[item["code"]] for item in found["findings"])
    return {item["code"] for item in found["findings"]}


# --- check ----------------------------------------------------------------------------------------


def test_camera_drift_does_not_fire(cli: Cli, simulated_rig: Path, still: Path) -> None:
    outcome = cli("check", simulated_rig, still)
    assert (outcome.code, outcome.err) == (0, "")
    assert "Unchanged" in outcome.out
    assert [line.split()[0] for line in outcome.out.splitlines()[1:3]] == ["cam0", "cam1"]


def test_camera_drift_fires(cli: Cli, simulated_rig: Path, still: Path, tmp_path: Path) -> None:
    rig = _changed(
        simulated_rig, tmp_path / "rig.json", cam_from_ref=_moved(load_rig(simulated_rig))
    )
    outcome = cli("check", rig, still, "--json")
    assert (outcome.code, outcome.err) == (3, "")
    assert "camera_drift" in _codes(outcome.json)
    place = outcome.json["cameras"]["cam1"]["place"]
    # the rig's own error is in it, too: 5 sigma
    assert place["moved_m"] == pytest.approx(0.005, abs=5 * place["moved_sigma_m"])
    assert place["chance"] < 1e-6


def test_lens_drift_does_not_fire(cli: Cli, simulated_rig: Path, still: Path) -> None:
    found = cli("check", simulated_rig, still, "--json").json
    assert _codes(found) == set()
    assert found["unchanged"]
    assert found["with_covariance"]


def test_lens_drift_fires(cli: Cli, simulated_rig: Path, still: Path, tmp_path: Path) -> None:
    lens = load_rig(simulated_rig).cameras["cam1"].lens
    zoomed = replace(lens, fx=lens.fx / 1.02, fy=lens.fy / 1.02)
    rig = _changed(simulated_rig, tmp_path / "rig.json", lens=zoomed)
    outcome = cli("check", rig, still, "--json")
    assert outcome.code == 3
    assert "lens_drift" in _codes(outcome.json)
    found = outcome.json["cameras"]["cam1"]["lens"]
    assert found["focal_share"] == pytest.approx(0.02, abs=5 * found["sigma"][0])
    assert not outcome.json["cameras"]["cam0"]["lens_changed"]


def test_check_says_what_it_could_not_look_at(
    cli: Cli, simulated_rig: Path, still: Path, tmp_path: Path
) -> None:
    shutil.rmtree(still / "cam1")
    (still / "other").mkdir()
    shutil.copy(still / "cam0" / "new0.png", still / "other")
    shutil.copy(simulated_rig, tmp_path / "rig.json")  # without its evidence
    outcome = cli("check", tmp_path / "rig.json", still)
    assert outcome.code == 0
    assert "no view of the board: cam1" in outcome.out
    assert "Not in the rig: other" in outcome.out
    assert "rig.npz is not beside the rig" in outcome.out


def test_one_picture_a_camera_needs_no_common_name(
    cli: Cli, simulated_rig: Path, still: Path
) -> None:
    (still / "cam0" / "new1.png").unlink()
    (still / "cam1" / "new1.png").unlink()
    (still / "cam1" / "new0.png").rename(still / "cam1" / "another.png")
    found = cli("check", simulated_rig, still, "--json").json
    assert found["frames"] == 1
    assert found["cameras"]["cam1"]["place"] is not None


def test_half_size_pictures_are_refused(refused: Refused, simulated_rig: Path, still: Path) -> None:
    for path in still.rglob("*.png"):
        picture = cv2.imread(str(path))
        assert picture is not None
        assert cv2.imwrite(str(path), picture[::2, ::2])
    refused("check", simulated_rig, still, says=["cam0", "320x240", "640x480"])


def test_pictures_of_other_cameras_are_refused(
    refused: Refused, simulated_rig: Path, still: Path
) -> None:
    for camera in ("cam0", "cam1"):
        (still / camera).rename(still / camera.replace("cam", "eye"))
    refused("check", simulated_rig, still, says=["eye0", "cam0"])


# --- compare --------------------------------------------------------------------------------------


def test_a_rig_is_compatible_with_itself(cli: Cli, simulated_rig: Path) -> None:
    outcome = cli("compare", simulated_rig, simulated_rig)
    assert (outcome.code, outcome.err) == (0, "")
    assert "Compatible" in outcome.out
    assert "24 pictures are in both" in outcome.out


def test_a_moved_camera_makes_rigs_differ(cli: Cli, simulated_rig: Path, tmp_path: Path) -> None:
    rig = _changed(
        simulated_rig, tmp_path / "rig.json", cam_from_ref=_moved(load_rig(simulated_rig))
    )
    outcome = cli("compare", simulated_rig, rig, "--json", "--distance", "0.8m")
    assert outcome.code == 0
    found = outcome.json
    assert not found["compatible"]
    other = next(name for name in ("cam0", "cam1") if name != found["reference_camera"])
    assert found["differing"] == [other]
    assert found["cameras"][other]["place"]["moved_m"] == pytest.approx(0.005, rel=1e-6)
    assert found["cameras"][other]["distances_m"] == [0.8]
    assert found["cameras"][other]["far"]["rms_px"] < 1e-6  # the lenses are the same


def test_compare_lists_cameras_of_one_rig(cli: Cli, simulated_rig: Path, tmp_path: Path) -> None:
    rig = load_rig(simulated_rig)
    kept = rig.reference_camera
    alone = replace(rig, cameras={kept: rig.cameras[kept]}, pairs=())
    save_rig(alone, None, tmp_path / "rig.json")
    outcome = cli("compare", simulated_rig, tmp_path / "rig.json")
    assert outcome.code == 0
    assert "Only in the first rig: cam" in outcome.out
    assert "No verdict" in outcome.out


def test_compare_refuses_other_sizes(refused: Refused, simulated_rig: Path, tmp_path: Path) -> None:
    rig = _changed(simulated_rig, tmp_path / "rig.json", size_wh=(1280, 960))
    refused("compare", simulated_rig, rig, says=["cam1", "640x480", "1280x960"])


def test_rig_triangulates_its_own_projections(simulated_rig: Path) -> None:
    rig = load_rig(simulated_rig)
    evidence = load_evidence(simulated_rig.with_suffix(".npz"))
    frame = next(iter(rig.frames.values()))
    points = frame.ref_from_board.apply(rig.target.corners_board[:10])
    pixels = {name: camera.project(points) for name, camera in rig.cameras.items()}
    exact = rig.triangulate(pixels)
    np.testing.assert_allclose(exact.points_ref, points, atol=1e-8)
    doubtful = rig.triangulate(pixels, covariance=evidence.joint)
    assert (np.linalg.det(doubtful.cov_m2) > np.linalg.det(exact.cov_m2)).all()


# --- halves ---------------------------------------------------------------------------------------


def test_halves_ratio_is_in_the_rig(simulated_rig: Path) -> None:
    """Simulated pictures have true covariances; 3 effective degrees: 0.1 % pass 2.3."""
    for camera in load_rig(simulated_rig).cameras.values():
        assert camera.halves_ratio is not None
        assert 0 < camera.halves_ratio < 2.3


def _halved(factor: float) -> SolvedGeometry:
    """A camera whose halves differ by `factor` times what is predicted, in three directions."""
    roots = np.eye(6)[:, :3].reshape(3, 2, 3)
    difference = LensDifference(
        pixels=np.zeros((3, 2)),
        difference_px=np.tile([factor, 0.0], (3, 1)),
        b_from_a=Pose.identity(),
        roots=roots,
    )
    halves = Halves(solutions=(None, None), lenses={"a": difference})  # type: ignore[arg-type]
    return SolvedGeometry(
        solution=None,  # type: ignore[arg-type]
        held_out={},
        rig_settings=None,
        halves=halves,
    )


def test_halves_disagree_fires() -> None:
    (found,) = _judge_halves(_halved(3.0))
    assert found.code == "halves_disagree"
    assert found.data["ratio"] == pytest.approx(3)
    assert "too small by about 3.0" in found.text


def test_halves_disagree_does_not_fire() -> None:
    assert not list(_judge_halves(_halved(1.4)))

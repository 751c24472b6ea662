"""``export``: which files are written where, and what is said of them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

Cli = Callable[..., Any]
Refused = Callable[..., str]


@pytest.mark.parametrize(
    ("kind", "suffix"), [("opencv", ".yaml"), ("ros", ".yaml"), ("cube", ".cube")]
)
def test_a_folder_holds_a_file_of_each_camera(
    kind: str, suffix: str, cli: Cli, simulated_rig: Path, tmp_path: Path
) -> None:
    words = ["export", simulated_rig, "--to", kind, "--size", "9", "-o", tmp_path / "out"]
    outcome = cli(*words, "--json")
    assert outcome.code == 0, outcome
    expected = [tmp_path / "out" / f"{name}{suffix}" for name in ("cam0", "cam1")]
    assert [Path(item) for item in outcome.json["written"]] == expected
    assert all(path.is_file() for path in expected)
    assert cli(*words).code == 1
    assert cli(*words, "--force").code == 0


def test_one_file_may_be_named(cli: Cli, simulated_rig: Path, tmp_path: Path) -> None:
    rig = json.loads(simulated_rig.read_text("utf-8"))
    path = tmp_path / "one.yaml"
    words = ["export", simulated_rig, "--to", "opencv", "-o", path]
    assert cli(*words, "--cameras", "cam1").code == 0
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    storage.release()
    assert matrix[0, 0] == rig["cameras"]["cam1"]["lens"]["fx"]


def test_a_pair_is_one_file_of_opencv_and_two_of_ros(
    cli: Cli, simulated_rig: Path, tmp_path: Path
) -> None:
    words = ["export", simulated_rig, "--pair", "cam0,cam1"]
    assert cli(*words, "--to", "opencv", "-o", tmp_path / "stereo.yml").code == 0
    assert "Q: !!opencv-matrix" in (tmp_path / "stereo.yml").read_text("utf-8")
    assert cli(*words, "--to", "opencv", "-o", tmp_path / "cv").code == 0
    assert (tmp_path / "cv" / "cam0-cam1.yaml").is_file()
    assert cli(*words, "--to", "ros", "-o", tmp_path / "ros").code == 0
    assert {path.name for path in (tmp_path / "ros").iterdir()} == {"cam0.yaml", "cam1.yaml"}


def test_what_cannot_be_exported_is_refused(
    refused: Refused, simulated_rig: Path, tmp_path: Path
) -> None:
    start = ["export", simulated_rig, "-o", tmp_path / "out"]
    refused(*start, "--to", "ros", "--pair", "cam0", says=["--pair wants two"])
    both = ["--pair", "cam0,cam1", "--cameras", "cam0"]
    refused(*start, "--to", "ros", *both, says=["leave out --cameras"])
    refused(*start, "--to", "ros", "--pair", "cam0,top", says=["no camera top"])
    refused(*start, "--to", "cube", "--pair", "cam0,cam1", says=["opencv and ros"])
    refused(*start, "--to", "opencv", "--cameras", "top", says=["no camera top", "cam0, cam1"])
    refused(*start, "--to", "ros", "--pair", "cam1,cam0", says=["--pair cam0,cam1"])
    refused(*start, "--to", "cube", "--size", "500", says=["2 to 129"])
    refused(*start, "--to", "cube", "--input", "linear", says=["camera cam0", "--input srgb"])
    many = tmp_path / "many.yaml"
    refused("export", simulated_rig, "--to", "ros", "-o", many, says=["cam0, cam1", "--cameras"])


def test_coarse_table_fires(cli: Cli, simulated_rig: Path, tmp_path: Path) -> None:
    """cam1 is a stacked sensor, whose raw channels hardly differ: a table cannot hold its model."""
    words = ["export", simulated_rig, "--to", "cube", "--cameras", "cam1", "--size", "33"]
    outcome = cli(*words, "-o", tmp_path / "cam1.cube", "--json")
    assert outcome.code == 0
    (found,) = outcome.json["findings"]
    assert (found["code"], found["severity"], found["camera"]) == (
        "coarse_table", "warning", "cam1",
    )  # fmt: skip
    assert "--size 65" in found["text"]


def test_coarse_table_does_not_fire(cli: Cli, simulated_rig: Path, tmp_path: Path) -> None:
    words = ["export", simulated_rig, "--to", "cube", "--cameras", "cam0"]
    outcome = cli(*words, "-o", tmp_path / "cam0.cube", "--json")
    assert outcome.code == 0
    assert outcome.json["findings"] == []

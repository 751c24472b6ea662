"""``triangulate``: from a table of pixels to a table of places."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.rig import load_rig

Cli = Callable[..., Any]
Refused = Callable[..., str]

_POINTS_REF = np.array([[0.0, 0.0, 0.9], [0.05, -0.04, 1.0], [-0.06, 0.05, 1.1]])


@pytest.fixture
def points(simulated_rig: Path, tmp_path: Path) -> Path:
    """Where the cameras of the rig see three points."""
    rig = load_rig(simulated_rig)
    lines = ["camera,frame,point,x,y"]
    for name, camera in rig.cameras.items():
        pixels = camera.project(_POINTS_REF)
        lines += [f"{name},07,p{index},{x!r},{y!r}" for index, (x, y) in enumerate(pixels.tolist())]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _numbers(row: dict[str, str], *keys: str) -> FloatArray:
    return np.array([float(row[key]) for key in keys])


def test_places_come_back_as_a_table(
    simulated_rig: Path, points: Path, cli: Cli, tmp_path: Path
) -> None:
    out = tmp_path / "places.csv"
    outcome = cli("triangulate", simulated_rig, points, "-o", out)
    assert outcome.code == 0, outcome
    assert "3 of 3 points located" in outcome.out
    with out.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["frame"], row["point"]) for row in rows] == [("07", f"p{i}") for i in range(3)]
    found = np.array([_numbers(row, "x", "y", "z") for row in rows])
    np.testing.assert_allclose(found, _POINTS_REF, atol=1e-7)
    for row in rows:
        assert row["cameras"] == "cam0;cam1"
        xx, xy, xz, yy, yz, zz = _numbers(row, "sxx", "sxy", "sxz", "syy", "syz", "szz")
        assert (np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) > 0).all()
        # the size of the board was not measured: 0.5 % of a metre
        assert 4e-3 < np.sqrt(zz) < 8e-3
        assert float(row["residual_px"]) < 1e-3


def test_without_a_file_the_table_goes_to_stdout(
    simulated_rig: Path, points: Path, cli: Cli
) -> None:
    outcome = cli("triangulate", simulated_rig, points)
    rows = list(csv.DictReader(outcome.out.splitlines()))
    assert len(rows) == 3
    assert "3 of 3 points located" in outcome.err
    assert "positions without sigma have" in outcome.err
    said = cli("triangulate", simulated_rig, points, "--json").json
    assert said["with_covariance"]
    assert not said["sigma_found"]  # of three points nobody can tell
    assert [item["point"] for item in said["points"]] == ["p0", "p1", "p2"]
    assert said["points"][0]["cameras"] == ["cam0", "cam1"]
    assert said["points"][0]["z"] == pytest.approx(0.9, abs=1e-7)


def test_bad_tables_are_refused(simulated_rig: Path, points: Path, refused: Refused) -> None:
    text = points.read_text(encoding="utf-8")
    points.write_text(text.replace("cam1,07,p2", "cam9,07,p2"), encoding="utf-8")
    refused("triangulate", simulated_rig, points, says=["line 7", "cam9", "cam0, cam1"])
    points.write_text(text.replace("cam1,07", "cam1,08"), encoding="utf-8")
    refused("triangulate", simulated_rig, points, says=["none of 6 points", "fewer than two"])
    points.write_text("camera,frame,point,x,y\n", encoding="utf-8")
    refused("triangulate", simulated_rig, points, says=["no camera has points"])
    refused("triangulate", simulated_rig, points.parent / "none.csv", says=["none.csv"])

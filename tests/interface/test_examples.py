"""The examples run as they are, and say what they promise."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

# What each prints; groups are figures.
PROMISES = {
    "correct_a_folder": r"16 pictures corrected",
    "live_correction": r"640x480, \w+ kernel: \d+ fps, [\d.]+ ms",
    "stereo_depth": r"\d{5,} points; those on the board are ([\d.]+) mm off",
    "boardless_proof": r"before: ([\d.]+) dE2000.*after: ([\d.]+) dE2000.*opencv_aloe",
    "workspace_observation": r"4 objects in 25 frames.*may be nearer than 0.4 m",
}


def _run(name: str, data: Path) -> re.Match[str]:
    done = subprocess.run(  # noqa: S603 (our own examples)
        [sys.executable, EXAMPLES / f"{name}.py"],
        env={**os.environ, "CALICHROME_DATA": str(data)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = re.search(PROMISES[name], done.stdout, flags=re.DOTALL)
    assert found, done.stdout
    return found


def test_every_example_is_run() -> None:
    # `simulated` is what they share
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*PROMISES, "simulated"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["correct_a_folder", "live_correction", "workspace_observation"])
def test_example_runs(name: str, data: Path) -> None:
    _run(name, data)


@pytest.mark.slow
def test_depth_is_metric(data: Path) -> None:
    # A quarter of a pixel of disparity, SGBM's usual error, is 4 mm at the distance of the board.
    assert float(_run("stereo_depth", data)[1]) < 4


@pytest.mark.slow
def test_cameras_agree_about_a_scene_without_board(data: Path) -> None:
    before, after = map(float, _run("boardless_proof", data).groups())
    # Two sensors under two lamps; what is left is noise and what hides behind edges.
    assert after < before / 4

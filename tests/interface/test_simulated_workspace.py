"""``calichrome simulate --scene workspace``."""

import json
from pathlib import Path

import pytest

from calichrome.cli.main import main
from calichrome.synthetic import read_truth
from calichrome.synthetic.workspace import read_workspace_truth


def test_too_many_balls_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    words = ["simulate", "--scene", "workspace", "--balls", "99", "-o", str(output)]
    assert main(words) == 1
    assert "1 to 16 balls" in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.slow
def test_workspace_and_its_calibration_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    numbers = ["--cameras", "2", "--balls", "3", "--frames", "2", "--size", "640x480"]
    words = ["simulate", "--scene", "workspace", *numbers, "--json", "-o", str(output)]
    assert main(words) == 0
    shown = json.loads(capsys.readouterr().out)
    board, space = (Path(shown[name]) for name in ("calibration", "workspace"))
    # What the cameras are is the same in both truths.
    of_board, of_space = (
        read_truth(board / "truth.json"),
        read_workspace_truth(space / "truth.json"),
    )
    assert len(of_space.balls) == 3
    for name, camera in of_space.cameras.items():
        assert camera.lens.as_dict() == of_board.cameras[name].lens.as_dict()
        assert len(of_board.whole_views(name)) >= 6
    names = {path.stem for path in (space / "cam1").iterdir()}
    assert {"0000", "0001", "background0000"} < names

"""The command line as its user meets it: an exit code, stdout, stderr, and what lies on disk."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest

from calichrome.cli.main import main


@dataclass(frozen=True)
class Outcome:
    """What one command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:  # noqa: ANN401 (whatever the command printed)
        return json.loads(self.out)


class Cli(Protocol):
    def __call__(self, *words: str | Path) -> Outcome: ...


class Refused(Protocol):
    def __call__(self, *words: str | Path, says: Sequence[str]) -> str: ...


Small = Callable[..., Path]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Run one command in this process."""

    def run(*words: str | Path) -> Outcome:
        capsys.readouterr()
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run


def state(folder: Path) -> dict[str, bytes]:
    """Everything below a folder, hidden and temporary files included, with its bytes."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else b"(folder)"
        for path in folder.rglob("*")
    }


@pytest.fixture
def refused(cli: Cli, tmp_path: Path) -> Refused:
    """Run a command that cannot be done: one sentence, and everything on disk as before."""

    def run(*words: str | Path, says: Sequence[str]) -> str:
        before = state(tmp_path)
        outcome = cli(*words)
        assert outcome.code == 1, outcome
        lines = outcome.err.splitlines()
        assert len(lines) == 1, outcome.err
        assert lines[0].startswith("calichrome: ")
        for part in says:
            assert part in lines[0]
        assert "Traceback" not in outcome.err
        assert len(lines[0]) < 700
        assert state(tmp_path) == before
        return lines[0]

    return run


@pytest.fixture
def small(simulated: Path, tmp_path: Path) -> Small:
    """Copy the first frames of the simulated recording."""

    def copy(n_frames: int = 4, *, toml: bool = True, name: str = "recording") -> Path:
        folder = tmp_path / name
        for camera in ("cam0", "cam1"):
            (folder / camera).mkdir(parents=True)
            for path in sorted((simulated / camera).iterdir())[:n_frames]:
                shutil.copy(path, folder / camera / path.name)
        shutil.copy(simulated / "target.json", folder)
        if toml:
            shutil.copy(simulated / "recording.toml", folder)
        return folder

    return copy


@pytest.fixture(scope="session")
def simulated_rig(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig.json of the simulated recording; do not change it."""
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    assert main(["calibrate", str(simulated), "-o", str(path)]) == 0
    return path


@pytest.fixture(scope="session")
def render_rig(data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The rig of the rendered pair, read back from rig.json."""
    path = tmp_path_factory.mktemp("render") / "rig.json"
    words = ["calibrate", str(data / "render" / "recording"), "-o", str(path)]
    assert main([*words, "--reference-camera", "cam0"]) == 0
    rig: dict[str, Any] = json.loads(path.read_text())
    return rig

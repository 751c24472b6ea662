"""A detection that was interrupted goes on where it was, and ends as if it had not been."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from calichrome.cli.main import main

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

_STOPPED_AFTER = 5
_SCRIPT = f"""
import os, signal, sys
from calichrome.cli.main import main
from calichrome.pipeline.detection_cache import DetectionCache

# a shell without a terminal starts its background jobs with this signal ignored
signal.signal(signal.SIGINT, signal.default_int_handler)
put, n_put = DetectionCache.put, 0

def put_and_stop(self, context, seen):
    global n_put
    put(self, context, seen)
    n_put += 1
    if n_put == {_STOPPED_AFTER}:
        eval(sys.argv[1])

DetectionCache.put = put_and_stop
sys.exit(main(sys.argv[2:]))
"""
_KILL = "os.kill(os.getpid(), signal.SIGKILL)"
_INTERRUPT = "os.killpg(os.getpgid(0), signal.SIGINT)"  # Ctrl-C reaches all processes of a terminal


def _stopped(how: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command that is stopped in the middle; this returns when its workers are gone, too."""
    return subprocess.run(  # noqa: S603
        [sys.executable, "-c", _SCRIPT, how, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        start_new_session=True,
        check=False,
    )


def _detected(capsys: pytest.CaptureFixture[str], *words: str | Path) -> int:
    """Detect, and return how many pictures came from the cache."""
    capsys.readouterr()
    assert main(["detect", "--json", *map(str, words)]) == 0
    return int(json.loads(capsys.readouterr().out)["n_cached"])


def _written(folder: Path, name: str) -> list[bytes]:
    files = [folder / f"{name}{suffix}" for suffix in (".csv", ".markers.csv", ".rejected.csv")]
    return [path.read_bytes() for path in files]


@pytest.fixture(scope="module")
def uninterrupted(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """What a run in one process without a cache writes."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    words = [str(simulated), "-o", str(folder / "c.csv"), "--no-cache", "--workers", "1"]
    assert main(["detect", *words]) == 0
    return _written(folder, "c")


@pytest.mark.parametrize("workers", ["1", "2"])
def test_killed_detection_goes_on(
    workers: str,
    simulated: Path,
    uninterrupted: list[bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words: list[str | Path] = [simulated, "-o", tmp_path / "c.csv", "--cache", tmp_path / "cache"]
    killed = _stopped(_KILL, "detect", *words, "--workers", workers)
    assert killed.returncode == -signal.SIGKILL
    assert not list(tmp_path.glob("*.csv"))
    assert _detected(capsys, *words, "--workers", workers) == _STOPPED_AFTER
    assert _written(tmp_path, "c") == uninterrupted
    assert _detected(capsys, *words, "--force") == 24
    assert _written(tmp_path, "c") == uninterrupted


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_says_one_sentence(
    workers: str, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words: list[str | Path] = [simulated, "-o", tmp_path / "c.csv", "--cache", tmp_path / "cache"]
    stopped = _stopped(_INTERRUPT, "detect", *words, "--workers", workers)
    assert (stopped.returncode, stopped.stdout) == (1, "")
    assert stopped.stderr.splitlines() == [
        "calichrome: interrupted; what was being written is left out"
    ]
    assert _detected(capsys, *words) == _STOPPED_AFTER

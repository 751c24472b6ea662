"""Simulated workspaces and the rigs calibrated in them, kept in a folder of the benchmark."""

import hashlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import calichrome
from calichrome.synthetic.workspace import (
    WorkspaceTruth,
    read_workspace_truth,
    workspace_scene,
    write_workspace,
)

__all__ = ["Case", "make_case", "run_command"]

_PACKAGE = Path(calichrome.__file__).parent
_SQUARE = "80mm"  # the simulated print is exact, so its size may count as measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One workspace on disk."""

    seed: int
    recording: Path
    rig: Path
    truth: WorkspaceTruth


def make_case(seed: int, n_frames: int, cache: Path) -> Case:
    """Render and calibrate, unless both are in the cache.

    They are made again when the code that makes them changes: `synthetic` for the pictures, and
    `detection`, `geometry` and `colour` for the rig.
    """
    folder = cache / f"workspace-{seed}-{n_frames}-{_digest('synthetic')}"
    if not folder.is_dir():
        _say(f"seed {seed}: rendering {folder}")
        write_workspace(workspace_scene(seed, n_frames=n_frames), folder)
    rig = folder / f"rig-{_digest('detection', 'geometry', 'colour')}.json"
    if not rig.is_file():
        _say(f"seed {seed}: calibrating")
        run_command(
            "calibrate", str(folder / "calibration"), "--square", _SQUARE,
            "--reference-camera", "cam0", "-o", str(rig),
        )  # fmt: skip
    recording = folder / "workspace"
    return Case(
        seed=seed,
        recording=recording,
        rig=rig,
        truth=read_workspace_truth(recording / "truth.json"),
    )


def run_command(*words: str) -> str:
    """Run a command of calichrome in a process of its own; return what it prints.

    Raises
    ------
    RuntimeError
        If it could not do its work; exit code 3, a critical finding, is passed over.
    """
    command = [sys.executable, "-m", "calichrome.cli.main", *words]
    done = subprocess.run(  # noqa: S603 (our own command)
        command, capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()[-1000:]}")
    return done.stdout


def _digest(*rooms: str) -> str:
    total = hashlib.sha256()
    for room in rooms:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            total.update(path.read_bytes())
    return total.hexdigest()[:10]


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)

"""Run the commands of README.md in an empty folder, in their order; stop at the first failure.

A command is a line that begins with ``$ `` in a ``console`` block. ``$CALICHROME_DATA`` is the
folder of test data; ``make`` runs elsewhere and is passed over.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def commands(text: str) -> list[str]:
    """Return the commands of all console blocks."""
    blocks = re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL)
    joined = "\n".join(blocks).replace("\\\n", " ")
    lines = [line[2:] for line in joined.splitlines() if line.startswith("$ ")]
    return [line for line in lines if not line.startswith(("make", "git", "cd"))]


def main() -> int:
    """Run them all."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    found = commands((ROOT / "README.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for command in found:
            print(f"$ {command}", flush=True)
            done = subprocess.run(  # noqa: S602 (our own README)
                command,
                shell=True,
                cwd=folder,
                env={**os.environ, "PATH": path},
                check=False,
                capture_output=True,
                text=True,
            )
            if done.returncode != 0:
                print(done.stdout + done.stderr)
                print(f"README: this command ended with exit code {done.returncode}")
                return 1
    print(f"README: {len(found)} commands ran")
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main())

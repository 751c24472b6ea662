"""The C kernels under AddressSanitizer and UndefinedBehaviorSanitizer."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

_GCC = shutil.which("gcc") or ""
_ROOT = Path(__file__).parents[3]
_SOURCE = _ROOT / "src" / "calichrome" / "kernels" / "native.c"


@pytest.mark.slow
@pytest.mark.skipif(not _GCC, reason="needs GCC and its sanitizers")
def test_kernels_are_clean(tmp_path: Path) -> None:
    """All that two files test: odd sizes, strides, regions, empty maps, maps that leave."""
    library = tmp_path / "native.so"
    build = [
        _GCC, "-g", "-O1", "-shared", "-fPIC", "-Wno-psabi",
        "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
        f"-I{sysconfig.get_path('include')}", str(_SOURCE), "-o", str(library),
    ]  # fmt: skip
    subprocess.run(build, check=True)  # noqa: S603 (our own words)
    runtimes = [
        subprocess.run(  # noqa: S603
            [_GCC, f"-print-file-name={name}"], check=True, capture_output=True, text=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    environment = {
        **os.environ,
        "LD_PRELOAD": ":".join(runtimes),
        "ASAN_OPTIONS": "detect_leaks=0",  # the interpreter itself keeps memory to its end
        "SANITIZED_KERNELS": str(library),
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    }
    unit = _ROOT / "tests" / "unit"
    tests = unit / "apply" / "test_kernels.py", unit / "kernels" / "test_yuv.py"
    run = subprocess.run(  # noqa: S603
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "sanitized", "-m", "not slow",
         "-p", "no:cacheprovider", "-p", "no:faulthandler", "-s", *map(str, tests)],
        env=environment, cwd=_ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-6000:]

"""Work in other processes: all of it is done, or it is said which was not.

The jobs are expressions, the work is to evaluate them: it needs no module that processes share.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from calichrome.pipeline.workers import JobLostError, n_cores, spread

_DIE = "__import__('os')._exit(9)"


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_is_done_once(workers: int) -> None:
    jobs = [f"{number} ** 2" for number in range(12)]
    done = list(spread(eval, jobs, workers=workers))
    assert sorted(done) == sorted((f"{number} ** 2", number**2) for number in range(12))


def test_nothing_to_do_starts_nothing() -> None:
    assert list(spread(eval, [], workers=4)) == []


def test_workers_are_other_processes_of_one_thread() -> None:
    before, main = dict(os.environ), sys.modules["__main__"]
    jobs = ["__import__('os').getpid()", "__import__('cv2').getNumThreads()"]
    jobs += [f"__import__('os').environ['{name}_NUM_THREADS']" for name in ("OPENBLAS", "OMP")]
    done = dict(spread(eval, jobs, workers=2))
    assert done[jobs[0]] != os.getpid()
    assert done[jobs[1]] == 1
    assert done[jobs[2]] == done[jobs[3]] == "1"
    assert dict(os.environ) == before
    assert sys.modules["__main__"] is main


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_of_the_work_come_back(workers: int) -> None:
    with pytest.raises(ZeroDivisionError):
        list(spread(eval, ["1", "1 / 0", "2"], workers=workers))


@pytest.mark.parametrize("place", [0, 3, 7])
def test_the_job_a_process_died_of_is_named(place: int, caplog: pytest.LogCaptureFixture) -> None:
    jobs = [str(number) for number in range(8)]
    jobs[place] = _DIE
    done: dict[str, object] = {}
    with pytest.raises(JobLostError) as raised:
        done.update(spread(eval, jobs, workers=2))
    assert raised.value.job == _DIE
    assert set(map(str, range(place))) <= set(done)
    assert "going on with 1" in caplog.text


def test_a_death_that_does_not_repeat_costs_nothing(tmp_path: Path) -> None:
    """As when memory suffices for fewer pictures at a time."""
    mark = tmp_path / "died"
    once = f"__import__('os')._exit(9) if not {str(mark)!r} in [str(p) for p in __import__("
    once += f"'pathlib').Path({str(tmp_path)!r}).iterdir()] and not __import__('pathlib').Path("
    once += f"{str(mark)!r}).touch() else 'alive'"
    jobs = ["0", "1", once, "3", "4", "5"]
    assert dict(spread(eval, jobs, workers=2)) == {
        **{str(number): number for number in (0, 1, 3, 4, 5)},
        once: "alive",
    }


@pytest.mark.parametrize("workers", [1, 2])
def test_work_that_memory_does_not_suffice_for_is_named(workers: int) -> None:
    hungry = "bytes(2 ** 62)"
    with pytest.raises(JobLostError) as raised:
        list(spread(eval, ["0", hungry, "2", "3"], workers=workers))
    assert raised.value.job == hungry


def _script(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    """Run a script; this returns only when no process holds its output any more."""
    path = folder / "script.py"
    path.write_text(text)
    words = [sys.executable, str(path)]
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)  # noqa: S603


def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    """Whoever calls `calibrate` in a plain script need not know of processes."""
    done = _script(
        tmp_path,
        "from calichrome.pipeline.workers import spread\n"
        "print(sorted(spread(eval, ['1', '2', '3'], workers=2)))\n",
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "[('1', 1), ('2', 2), ('3', 3)]\n"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    done = _script(
        tmp_path,
        "import os, signal\n"
        "from calichrome.pipeline.workers import spread\n"
        "for _ in spread(eval, ['1', \"__import__('time').sleep(3600)\", '2'], workers=2):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n",
    )
    assert done.returncode == -signal.SIGKILL


def test_leaving_early_does_not_wait(tmp_path: Path) -> None:
    done = _script(
        tmp_path,
        "from calichrome.pipeline.workers import spread\n"
        "for _ in spread(eval, ['1', \"__import__('time').sleep(3600)\", '2'], workers=2):\n"
        "    raise SystemExit(5)\n",
    )
    assert (done.returncode, done.stderr) == (5, "")


def test_cores() -> None:
    assert 1 <= n_cores() <= (os.cpu_count() or 1)

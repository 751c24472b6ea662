"""Work spread over processes that leave nothing behind."""

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any, ClassVar, Generic, TypeVar

__all__ = ["JobLostError", "n_cores", "spread"]

_LOG = logging.getLogger(__name__)
_Job = TypeVar("_Job", bound=Hashable)
_Result = TypeVar("_Result")

_AHEAD = 2
"""Jobs per process that are handed out: one being done, one waiting, so that none is idle."""
_MOST = 61
"""Windows waits for no more processes than this (documentation of ProcessPoolExecutor)."""
_ONE_THREAD = dict.fromkeys(
    (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    ),
    "1",
)
"""Read by these libraries when they are loaded: the processes share the cores, threads of theirs
would only wait for each other."""


class JobLostError(Exception, Generic[_Job]):
    """A process ended in the middle of a job, which was the only one being done."""

    def __init__(self, job: _Job) -> None:
        self.job = job
        super().__init__(f"lost {job}")


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def spread(
    work: Callable[[_Job], _Result], jobs: Sequence[_Job], *, workers: int
) -> Generator[tuple[_Job, _Result]]:
    """Do `jobs` in up to `workers` processes; yield each with its result as it is done.

    Parameters
    ----------
    work
        Importable, and small enough to be sent to every process once.
    jobs
        All different; sent one by one.
    workers
        1: all is done in this process.

    Raises
    ------
    JobLostError
        If a process dies of a job, or memory does not suffice for it alone. Where several jobs
        were under way, they are tried again in half as many processes, and so on down to one.
    """
    left = dict.fromkeys(jobs)
    workers = min(workers, len(jobs), _MOST)
    if workers <= 1:
        yield from _one_by_one(work, jobs)
        return
    while left:
        try:
            with _pool(work, workers) as pool:
                ahead = 1 if workers == 1 else _AHEAD * workers
                for job, result in _in_any_order(pool, tuple(left), ahead):
                    del left[job]
                    yield job, result
        except (BrokenProcessPool, MemoryError) as error:
            if workers == 1:
                raise JobLostError(next(iter(left))) from error
            workers //= 2
            _LOG.warning(
                "a process ended before its work was done (most often: out of memory); going on "
                "with %d",
                workers,
            )


def _one_by_one(
    work: Callable[[_Job], _Result], jobs: Sequence[_Job]
) -> Iterator[tuple[_Job, _Result]]:
    for job in jobs:
        try:
            result = work(job)
        except MemoryError as error:
            raise JobLostError(job) from error
        yield job, result


def _in_any_order(
    pool: ProcessPoolExecutor, jobs: Sequence[_Job], ahead: int
) -> Iterator[tuple[_Job, Any]]:
    """Hand out no more than `ahead` jobs at a time, in their order."""
    pending: dict[Future[Any], _Job] = {}
    waiting = iter(jobs)
    while True:
        for job in waiting:
            pending[pool.submit(_do, job)] = job
            if len(pending) == ahead:
                break
        if not pending:
            return
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        for future in done:
            yield pending.pop(future), future.result()


@contextmanager
def _pool(work: Callable[[_Job], object], workers: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool whose processes end when this block is left by an exception, or killed.

    Without the line to their parent, processes of a killed parent would wait for work for ever.
    """
    context = _Context()
    lifeline, held = context.Pipe(duplex=False)
    with lifeline, held:
        pool = ProcessPoolExecutor(
            workers, mp_context=context, initializer=_begin, initargs=(lifeline, work)
        )
        try:
            yield pool
        except BaseException:
            held.close()
            raise
        finally:
            pool.shutdown()


class _Worker(SpawnProcess):
    """A process that starts with nothing of its parent's but what it is sent."""

    def start(self) -> None:
        with _bare_start():
            super().start()


class _Context(SpawnContext):
    Process: ClassVar[type[SpawnProcess]] = _Worker


@contextmanager
def _bare_start() -> Iterator[None]:
    """Hand down single-threaded libraries, no Ctrl-C, and an empty ``__main__``.

    A spawned process runs its parent's main script again. Such a script need not guard against
    that if it only uses this package: it would start itself over and over.
    """
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    main = sys.modules["__main__"]
    os.environ.update(_ONE_THREAD)
    sys.modules["__main__"] = ModuleType("__main__")
    blocked = _block_interrupts()
    try:
        yield
    finally:
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        sys.modules["__main__"] = main
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _block_interrupts() -> set[signal.Signals | int] | None:
    """Hold Ctrl-C back; a new process inherits that, and its parent tells it when to end."""
    if sys.platform == "win32":
        return None
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))


_work: Callable[[Any], Any] | None = None  # of this process, if it is a worker


def _begin(lifeline: "Connection[Any, Any]", work: Callable[[Any], Any]) -> None:
    global _work  # noqa: PLW0603 (the one way in which a pool hands anything to its jobs)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
    _work = work


def _end_with_parent(lifeline: "Connection[Any, Any]") -> None:
    lifeline.poll(None)  # nothing is ever sent: the other end was closed
    os._exit(1)


def _do(job: Any) -> Any:  # noqa: ANN401 (as the work of this process has it)
    assert _work is not None  # noqa: S101 (the pool has called _begin)
    return _work(job)

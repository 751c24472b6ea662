"""Detections that are kept, so that no picture is searched twice.

A detection depends on the bytes of the picture, the target, the detector and what is stated of the
camera's encoding; under a sum over these it is kept in one SQLite file in the user's cache folder.
Nothing here can stop a detection: a file that is damaged is set aside, one that cannot be used is
done without, and both are said in the log.
"""

import dataclasses
import hashlib
import json
import logging
import os
import sqlite3
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Self, TypeVar

from platformdirs import user_cache_path

from calichrome.detection.version import DETECTOR_VERSION
from calichrome.errors import OutputError
from calichrome.imaging import Unreadable
from calichrome.imaging.recording_file import CameraEntry
from calichrome.observations import BoardView, DiscSamples, NotFound
from calichrome.pipeline.packing import PackingError, layout, pack, unpack
from calichrome.target import Target

__all__ = ["CACHE_VARIABLE", "DetectionCache", "Seen", "cache_folder", "context_of"]

CACHE_VARIABLE = "CALICHROME_CACHE"
"""Environment variable with the folder of caches, instead of the user's cache folder."""

_SCHEMA_VERSION = 1  # in the name of the file: releases with other tables do not meet
_NAME = f"detections-{_SCHEMA_VERSION}.sqlite"
_MAX_BYTES = 256_000_000
"""The oldest detections go beyond this. One of 72 corners with 24 discs takes 11 kB."""
_BUSY_S = 10.0
"""So long one process waits for another, which holds the file for milliseconds at a time."""
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
"""SQLITE_ERROR: it is a database, but its tables are not ours."""

_LOG = logging.getLogger(__name__)
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """What one picture file holds; the sum is "" if it could not be read."""

    found: BoardView | NotFound | Unreadable
    size_wh: tuple[int, int] | None = None
    sha256: str = ""
    exposure: Mapping[str, float] | None = None
    rotation_tag: int = 1


_TYPES: Mapping[str, type] = MappingProxyType(
    {kind.__name__: kind for kind in (Seen, BoardView, DiscSamples, NotFound)}
)


def cache_folder(chosen: Path | None) -> Path:
    """Return the folder of caches: the chosen one, that of the environment, or the user's.

    Raises
    ------
    OutputError
        If `chosen` cannot be written.
    """
    if chosen is None:
        stated = os.environ.get(CACHE_VARIABLE)
        return Path(stated) if stated else user_cache_path("calichrome", appauthor=False)
    try:
        chosen.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _not_writable(chosen, error.strerror or str(error)) from error
    if not os.access(chosen, os.W_OK):
        raise _not_writable(chosen, "permission denied")
    return chosen


def _not_writable(folder: Path, reason: str) -> OutputError:
    return OutputError(
        f"{folder} cannot hold the cache ({reason}); choose another --cache, or give --no-cache"
    )


def context_of(target: Target, entry: CameraEntry) -> str:
    """Return a sum over all that a detection depends on beside the bytes of the picture.

    Parameters
    ----------
    target
        What is looked for.
    entry
        What is stated of the camera; its encoding and bits matter.
    """
    parts = {
        "detector": DETECTOR_VERSION,
        "fields": layout(_TYPES),
        "target": dataclasses.asdict(target),
        "encoding": entry.encoding,
        "bits": entry.bits,
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


class DetectionCache:
    """Detections by context and picture; a context manager that closes the file.

    Parameters
    ----------
    folder
        Where the file lies; None: nothing is kept.
    max_bytes
        Size of the file beyond which the oldest go.
    """

    def __init__(self, folder: Path | None, *, max_bytes: int = _MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._path = None if folder is None else folder / _NAME
        self._file: sqlite3.Connection | None = None
        self._is_second = False
        if self._path is not None:
            self._open(self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()

    def knows(self, context: str) -> bool:
        """Whether anything is kept for a context: if not, no picture needs to be summed."""
        query = "SELECT EXISTS (SELECT 1 FROM seen WHERE context = ?)"
        return self._ask(
            lambda file: bool(file.execute(query, (context,)).fetchone()[0]), otherwise=False
        )

    def get(self, context: str, sha256: str) -> Seen | None:
        """Return what was seen in the picture with this sum, if that is kept."""
        query = "SELECT content FROM seen WHERE context = ? AND picture = ?"
        row = self._ask(
            lambda file: file.execute(query, (context, sha256)).fetchone(), otherwise=None
        )
        if row is None:
            return None
        try:
            seen = unpack(row[0], _TYPES)
        except PackingError as error:
            _LOG.debug("a kept detection is left out: %s", error)
            return None
        return seen if isinstance(seen, Seen) and seen.sha256 == sha256 else None

    def put(self, context: str, seen: Seen) -> None:
        """Keep what was seen, at once; of files that cannot be read, nothing."""
        if not seen.sha256 or isinstance(seen.found, Unreadable):
            return
        row = (context, seen.sha256, pack(seen, _TYPES))
        insert = "INSERT OR REPLACE INTO seen (context, picture, content) VALUES (?, ?, ?)"

        def write(file: sqlite3.Connection) -> None:
            file.execute(insert, row)
            self._drop_oldest(file)

        self._ask(write, otherwise=None)

    def _drop_oldest(self, file: sqlite3.Connection) -> None:
        """Delete tenths of the rows until the rest fits; later rows take the room."""
        while self._used_bytes(file) > self._max_bytes:
            first, last = file.execute("SELECT min(id), max(id) FROM seen").fetchone()
            if first is None:
                return
            file.execute("DELETE FROM seen WHERE id <= ?", (first + (last - first) // 10,))

    @staticmethod
    def _used_bytes(file: sqlite3.Connection) -> int:
        sizes = [
            int(file.execute(f"PRAGMA {name}").fetchone()[0])
            for name in ("page_count", "freelist_count", "page_size")
        ]
        return (sizes[0] - sizes[1]) * sizes[2]

    def _ask(self, action: Callable[[sqlite3.Connection], _T], *, otherwise: _T) -> _T:
        if self._file is None:
            return otherwise
        try:
            return action(self._file)
        except sqlite3.DatabaseError as error:
            self._recover(error)
            return otherwise

    def _open(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
            _prepare(self._file)
        except (OSError, sqlite3.DatabaseError) as error:
            self._recover(error)

    def _recover(self, error: OSError | sqlite3.DatabaseError) -> None:
        """Begin a new file if this one is damaged, else go on without."""
        self._close()
        path, self._path = self._path, None
        assert path is not None  # noqa: S101 (a file was open, or was to be opened)
        damaged = getattr(error, "sqlite_errorcode", None) in _DAMAGED
        if not damaged or self._is_second:
            _LOG.warning("%s cannot be used (%s); going on without a cache", path, error)
            return
        aside = path.with_name(f"{path.name}.damaged")
        try:
            path.replace(aside)
            for suffix in ("-wal", "-shm"):
                path.with_name(path.name + suffix).unlink(missing_ok=True)
        except OSError as trouble:
            _LOG.warning("%s is damaged (%s); going on without a cache", path, trouble)
            return
        _LOG.warning("%s is damaged (%s); it is now %s, and a new one begun", path, error, aside)
        self._path, self._is_second = path, True
        self._open(path)

    def _close(self) -> None:
        if self._file is not None:
            with suppress(sqlite3.Error):
                self._file.close()
            self._file = None


def _prepare(file: sqlite3.Connection) -> None:
    """Make the table, in a log that readers and a writer share and that a killed process leaves."""
    until = time.monotonic() + _BUSY_S
    while True:
        try:
            file.execute("PRAGMA journal_mode = WAL")
            break
        except sqlite3.OperationalError as error:  # changing the mode does not wait for others
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > until:
                raise
            time.sleep(0.05)
    file.execute("PRAGMA synchronous = NORMAL")
    file.execute(
        "CREATE TABLE IF NOT EXISTS seen (id INTEGER PRIMARY KEY, context TEXT NOT NULL, "
        "picture TEXT NOT NULL, content BLOB NOT NULL, UNIQUE (context, picture))"
    )

"""Outputs that are either whole or absent."""

import os
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from calichrome.errors import OutputError

__all__ = ["check_folder", "check_output", "refuse_existing", "writing_file", "writing_folder"]


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise `OutputError` when `path` is there and may not be replaced."""
    if path.exists() and not force:
        raise OutputError(f"{path} exists; choose another -o or allow replacing with --force")


@contextmanager
def writing_file(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it on success, remove it on failure.

    Raises
    ------
    OutputError
        If `path` exists (without `force`), is a folder, or its folder cannot be written.
    """
    refuse_existing(path, force=force)
    if path.is_dir():
        raise OutputError(f"{path} is a folder; -o wants the name of a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
    except OSError as error:
        raise _cannot_write(path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp made it private
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def writing_folder(
    path: Path, *, force: bool = False, inputs: Iterable[Path] = (), stale: Collection[str] = ()
) -> Iterator[Path]:
    """Yield a temporary folder beside `path`; put it in place on success.

    An existing folder is written into only with `force`; files that are not written again stay.

    Parameters
    ----------
    path
        The folder.
    force
        Replace an existing one.
    inputs
        What the output is made from: a folder that is or holds one of them is never replaced.
    stale
        Names of files that an earlier run may have left there and that would speak of what is there
        no longer; they go.

    Raises
    ------
    OutputError
        As `writing_file`.
    """
    check_folder(path, force=force, inputs=inputs)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        if path.exists():
            _move_into(temporary, path, stale)
        else:
            temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_into(new: Path, existing: Path, stale: Collection[str]) -> None:
    """Put every file in its place; what else the existing folder holds is not ours to remove."""
    for name in stale:
        (existing / name).unlink(missing_ok=True)
    for item in sorted(new.rglob("*")):
        place = existing / item.relative_to(new)
        if item.is_dir():
            place.mkdir(exist_ok=True)
        else:
            item.replace(place)


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"{path} cannot be written ({reason}); choose another -o")


def check_output(path: Path, *, force: bool) -> None:
    """Raise `OutputError` now if the file `path` could not be written later, after long work."""
    if path.is_dir():
        raise OutputError(f"{path} is a folder; -o wants the name of a file")
    refuse_existing(path, force=force)
    _check_writable(path)


def check_folder(path: Path, *, force: bool, inputs: Iterable[Path] = ()) -> None:
    """Raise `OutputError` now if the folder `path` could not be written or replaced later."""
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path} is a file; -o wants the name of a folder")
    empty = path.is_dir() and not any(path.iterdir())
    refuse_existing(path, force=force or empty)
    for item in inputs:
        if path.resolve() in (item.resolve(), *item.resolve().parents):
            raise OutputError(f"{path} holds {item}, which is read; choose another -o")
    _check_writable(path)


def _check_writable(path: Path) -> None:
    parent = path.parent
    while not parent.exists():
        parent = parent.parent
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise _cannot_write(path, error) from error

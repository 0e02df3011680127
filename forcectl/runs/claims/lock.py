"""A lock on a folder for one process, which it names; the lock ends with the process, even if that is killed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from forcectl.errors import BadInputError, RunFailedError

LOCK = "lock"
_WAITS = (0.01, 0.05)  # [s] between attempts: `holder` takes the lock for a moment to read it
_SOMEBODY = "another process"


class StorageError(RunFailedError):
    """A directory of results cannot be written any more: the disk is full, or the directory is gone."""


class InUseError(BadInputError):
    """A directory of results is in use by another process."""


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Context that turns a file-system error into one line.

    Raises:
        StorageError: something could not be written.
    """
    try:
        yield
    except OSError as error:
        raise StorageError(f"{str(folder)!r} cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def locked(folder: Path, name: Path | None = None, make: bool = False) -> Iterator[None]:
    """Context in which a folder is locked for this process.

    Args:
        folder: to lock.
        name: directory that messages name; None: the folder.
        make: create the folder if there is none, and remove it at the end if it is empty.

    Raises:
        InUseError: another process has locked it.
        StorageError: it cannot be written.
    """
    with writing(name or folder), contextlib.ExitStack() as stack:
        while True:
            file = stack.enter_context(_open(folder, make))
            if not _lock(file):
                file.seek(0)
                who = file.read().strip() or _SOMEBODY
                raise InUseError(
                    f"results directory {str(name or folder)!r} is in use by {who}: wait for it, stop it, or name "
                    "another directory"
                )
            if _is_at(file, folder / LOCK):
                break
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}")
        file.flush()
        held = stack.pop_all()
    with held:
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                (folder / LOCK).unlink(missing_ok=True)
                if make:
                    folder.rmdir()


def holder(folder: Path) -> str | None:
    """The process that has locked a folder, in words; None if it is free."""
    try:
        with (folder / LOCK).open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return (folder / LOCK).read_text(encoding="utf-8").strip() or _SOMEBODY
    except OSError:
        pass
    return None


def _open(folder: Path, make: bool) -> IO[str]:
    """The opened lock file of the folder; a process that releases the lock removes file and folder."""
    while True:
        if make:
            folder.mkdir(parents=True, exist_ok=True)
        try:
            return (folder / LOCK).open("a+", encoding="utf-8")
        except FileNotFoundError:
            if not make:
                raise


def _lock(file: IO[str]) -> bool:
    for wait in (*_WAITS, None):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if wait is not None:
                time.sleep(wait)
    return False


def _is_at(file: IO[str], path: Path) -> bool:
    """Whether an open file is still the one at a path."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False

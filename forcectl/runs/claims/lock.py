"""A folder that one process has to itself, and says which; it is free again when that process ends, however it ends."""

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
_WAITS = (0.01, 0.05)  # [s] between attempts: one who only looks holds a lock for a moment, see `holder`
_SOMEBODY = "another process"


class StorageError(RunFailedError):
    """A directory of results that cannot be written any more: full, or not there."""


class InUseError(BadInputError):
    """A directory of results that another process has."""


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Errors of the file system become one line.

    Raises:
        StorageError: something could not be written.
    """
    try:
        yield
    except OSError as error:
        raise StorageError(f"{str(folder)!r} cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def locked(folder: Path, name: Path | None = None, make: bool = False) -> Iterator[None]:
    """Keep a folder to this process.

    Args:
        folder: that is locked.
        name: that messages are about; None: of the folder.
        make: make the folder where there is none, and remove it in the end where it is empty.

    Raises:
        InUseError: another process has it.
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
    """Which process has a folder to itself, in words; None for none."""
    try:
        with (folder / LOCK).open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return (folder / LOCK).read_text(encoding="utf-8").strip() or _SOMEBODY
    except OSError:
        pass
    return None


def _open(folder: Path, make: bool) -> IO[str]:
    """The file of the lock, which is that of the folder: one who releases it removes it."""
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
    """Whether an open file has not been removed meanwhile."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False

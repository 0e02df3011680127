"""One process at a time writes a directory of results, which gets its name only when it is complete.

Until then the folder `.NAME.partial` stands beside the future directory `NAME`::

    lock       held by the writing process, which it names, as long as that lives
    results/   what `NAME` will be
    earlier/   what `NAME` was, while it is replaced

The lock ends with its process, even if that is killed. The next process that claims `NAME`, or `forcectl list DIR
--clean`, then cleans up: the results become `NAME.interrupted` if a variant of a run had finished, and are removed
otherwise.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from forcectl.errors import BadInputError, invalid
from forcectl.interrupts import Interrupts, before_leaving
from forcectl.runs.claims.kept import VARIANTS, salvage
from forcectl.runs.claims.lock import InUseError, StorageError, locked
from forcectl.runs.directory import FAILED, INTERRUPTED, MARKS, is_complete

PARTIAL, RESULTS, _EARLIER = ".partial", "results", "earlier"


@dataclass(frozen=True)
class Numbered:
    """The directory `folder/<stem>-<n>`, with the smallest n that is free when it is claimed."""

    folder: Path
    stem: str


Place = str | Path | Numbered


class Claim:
    """A directory of results that is reserved for this process, see `claimed`.

    Args:
        directory: where the results will be.
        force: replace an earlier run there.

    Attributes:
        directory: where the results will be.
        results: the folder that they are written to until then.
        settled: where finished variants of an ended process are kept; None where there were none.
        failed: where results are kept that could not be written to their end; None: none.

    Raises:
        BadInputError: see `claimed`.
    """

    def __init__(self, directory: Path, force: bool = False):
        check_free(directory, force)
        self.directory = directory.resolve() if os.path.islink(directory) else directory
        self.failed: Path | None = None
        self._force, self._partial, self._held = force, partial_of(self.directory), contextlib.ExitStack()
        self.results, self._earlier = self._partial / RESULTS, self._partial / _EARLIER
        with Interrupts(held=True):
            try:
                self._take()
            except BaseException:
                self._held.close()
                raise

    def _take(self) -> None:
        for parent in reversed(self.directory.parents):
            if not os.path.exists(parent):
                self._held.callback(_remove_empty, parent)
        try:
            self._held.enter_context(locked(self._partial, self.directory, make=True))
            check_free(self.directory, self._force)  # another process may have written it meanwhile
            self.settled = self._settle()
            self.results.mkdir()
        except (OSError, StorageError) as error:
            why = getattr(error.__cause__ or error, "strerror", None) or error
            raise BadInputError(f"output {str(self.directory)!r} cannot be written: {why}") from None
        self._held.callback(_restore, self._earlier, self.directory)
        self._held.callback(self.clear)

    def _settle(self) -> Path | None:
        """Clean up after an ended process; returns where its finished variants are kept, or None."""
        _restore(self._earlier, self.directory)
        kept = salvage(self.results, _named(self.directory, INTERRUPTED))
        self.clear()
        return kept

    def write(self, fill: Callable[[Path], None], ending: str = "") -> Path:
        """Let `fill` write the results, then rename them to the directory.

        What `fill` has written before an error is kept as `<name>.failed`, the attribute `failed`.

        Args:
            fill: called with the folder to write into.
            ending: suffix of the name, for a run that failed or was interrupted; an earlier one there is replaced.

        Returns:
            the directory. Where another process has made one of this name meanwhile, both are kept, this one as
            `<name>-1`.

        Raises:
            StorageError: see `storing`.
        """
        with self.storing(), Interrupts(held=True) as interrupts:
            self.results.mkdir(exist_ok=True)
            try:
                with interrupts.let_through():
                    fill(self.results)
                interrupts.check()
            except Exception as error:
                interrupts.check()  # raised while a compiled module is imported, it arrives as another error
                if not isinstance(error, OSError) and any(self.results.iterdir()):
                    self.failed = self._publish(FAILED)
                raise
            return self._publish(ending)

    @contextlib.contextmanager
    def storing(self) -> Iterator[None]:
        """Context that turns a file-system error into one line, which says what is kept.

        Raises:
            StorageError: something could not be written.
        """
        try:
            yield
        except OSError as error:
            why = f"{str(self.directory)!r} cannot be written: {error.strerror or error}"
            try:
                kept = self._keep()
            except OSError:
                kept = "nothing was kept"
            raise StorageError(f"{why}; {kept}") from error

    def _keep(self) -> str:
        """Keep a complete run, or the finished variants of one; returns a text that says so."""
        if is_complete(self.results):
            return f"log and metrics are kept in {self._publish(FAILED)}"
        kept = self.interrupt()
        return f"the variants that had finished are kept in {kept}" if kept else "nothing was kept"

    def interrupt(self) -> Path | None:
        """Keep the variants of a run that have finished, as `<name>.interrupted`; returns where, None for none."""
        with Interrupts(held=True):
            return salvage(self.results, _named(self.directory, INTERRUPTED))

    def clear(self) -> None:
        """Remove results that have not been renamed yet."""
        shutil.rmtree(self.results, ignore_errors=True)

    def release(self) -> None:
        """Release the directory to other processes; unfinished results are removed."""
        with Interrupts(held=True):
            self._held.close()

    def _publish(self, ending: str) -> Path:
        # If this is stopped anywhere, no directory with a final name is incomplete.
        shutil.rmtree(self.results / VARIANTS, ignore_errors=True)
        if not ending and not self._force:
            return _place(self.directory, self.results)
        target = _named(self.directory, ending)
        if os.path.exists(target):  # an earlier failure in the same directory is out of date
            target.rename(self._earlier)
        self.results.rename(target)
        shutil.rmtree(self._earlier, ignore_errors=True)
        return target


@contextlib.contextmanager
def claimed(place: Place, force: bool = False) -> Iterator[Claim]:
    """Context in which a directory of results is reserved for this process.

    Args:
        place: the directory; a `Numbered` one becomes the first that is free.
        force: it may exist, and is replaced when it is written.

    Raises:
        BadInputError: it cannot be written to, it exists and `force` is not given, or another process writes it
            (`InUseError`, which names the process).
    """
    if not isinstance(place, Place):
        raise invalid("out", place, "the path of a directory")
    claim = None
    with contextlib.ExitStack() as stack:
        try:
            with Interrupts(held=True):
                claim = _numbered(place) if isinstance(place, Numbered) else Claim(Path(place).expanduser(), force)
                stack.enter_context(before_leaving(claim.release))
            yield claim
        finally:
            if claim is not None:
                claim.release()


def _numbered(place: Numbered) -> Claim:
    folder, first = place.folder.expanduser(), 1
    while True:
        directory = free_name(folder, place.stem, first)
        try:
            claim = Claim(directory)
        except InUseError:
            first = int(directory.name.rpartition("-")[2]) + 1
            continue
        except BadInputError:
            if os.path.exists(directory):  # another process has written it meanwhile
                continue
            raise
        if free_name(folder, place.stem, first) == directory:
            return claim
        claim.release()  # finished variants of an ended process were found there, and took the name


def write_whole(directory: Path, fill: Callable[[Path], None], force: bool = False) -> Path:
    """Claim a directory and let `fill` write it, see `Claim.write`; returns it."""
    with claimed(directory, force) as claim:
        return claim.write(fill)


def partial_of(directory: Path) -> Path:
    """The folder in which `directory` is written until it is complete."""
    return directory.with_name(f".{directory.name}{PARTIAL}")


def of_partial(folder: Path) -> Path:
    """The directory that `folder` becomes; the inverse of `partial_of`."""
    return folder.with_name(folder.name.removeprefix(".").removesuffix(PARTIAL))


def check_free(directory: Path, force: bool) -> None:
    """Refuse a directory that exists, or is inside the directory of a run, before any work is done.

    Args:
        directory: where the run is to be written.
        force: replace an earlier run there. Nothing but a run or an empty folder is ever replaced.

    Raises:
        BadInputError: the directory cannot be used; the message says what to do.
    """
    for parent in directory.absolute().parents:
        if is_complete(parent):
            where = f"output {str(directory)!r} is in the directory of a run, {str(parent)!r}"
            raise BadInputError(f"{where}, and would be gone when that is replaced: name another one")
    if not os.path.exists(directory):
        return
    if not force:
        raise BadInputError(
            f"output {str(directory)!r} exists: name another one, or add --force (force=True) to replace the run in it"
        )
    if not os.path.isdir(directory) or (
        any(directory.iterdir()) and not any((directory / name).is_file() for name in MARKS)
    ):
        raise BadInputError(
            f"output {str(directory)!r} is not the directory of a run: it is not changed, name another one"
        )


def free_name(folder: Path, stem: str, first: int = 1) -> Path:
    """`folder/<stem>-<n>` with the smallest n from `first` that no run, complete, failed or interrupted, has."""
    n = first
    while any(os.path.exists(folder / f"{stem}-{n}{ending}") for ending in ("", FAILED, INTERRUPTED)):
        n += 1
    return folder / f"{stem}-{n}"


def _restore(earlier: Path, directory: Path) -> None:
    """Undo a replacement that was interrupted."""
    if os.path.exists(earlier) and not os.path.exists(directory):
        earlier.rename(directory)
    shutil.rmtree(earlier, ignore_errors=True)


def _named(directory: Path, ending: str) -> Path:
    return directory.with_name(directory.name.removesuffix(ending) + ending)


def _place(directory: Path, new: Path) -> Path:
    target = directory
    while True:
        try:
            return new.rename(target)
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
                raise
            target = free_name(directory.parent, directory.name)


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()

"""The directory of a sweep: all information on it, in files that are either complete or absent::

    sweep.yaml       the sweep, with the content of its scenario
    sweep.json       hash of the plan, versions, shard, number of trials, inode of the directory
    plan.parquet     every planned trial: number, point, arm, seed, keys
    rows/            a file for each finished trial, written under another name and renamed when complete
    running/         a file (mark) for each running trial: host, process, since when
    logs/            kept logs
    signals/         recorded signals, for envelopes
    trials.parquet   the table of results; costs.parquet: computing and elapsed times
    report.html      figures and tables

A trial is *done* or *failed* when it has a row, *running* when it has a mark whose process lives, *lost* when that
process has ended, else *pending*. This follows from the directory alone, even if its programs were killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import time
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError
from forcectl.runs.claims.lock import writing

FORMAT = 2
IDENTITY = "sweep.json"
SWEEP = "sweep.yaml"
BEAT = 2.0  # [s] between two updates of a mark, its signs of life
SILENT = 60.0  # [s] without such an update, after which the owner of a mark on another machine counts as dead
_PER_FOLDER = 1000
_HALF = re.compile(r"\.\d+-.+|\..+\.(\d+|partial)")  # names of unfinished files
_STARTED = 19  # index of the start time among the fields of /proc/PID/stat after the name

Row = dict[str, Any]


@dataclass(frozen=True)
class Owner:
    """A process: its machine, number and start time, which distinguishes it from a later one of the same number."""

    host: str
    pid: int
    started: str

    @staticmethod
    def here() -> Owner:
        """This process."""
        return Owner(socket.gethostname(), os.getpid(), _start_of(os.getpid()))

    def lives(self, beat: float) -> bool:
        """Whether the process is alive.

        Args:
            beat: time of its last sign of life [s since 1970], used if it is on another machine.
        """
        if self.host != socket.gethostname():
            return time.time() - beat < SILENT
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass
        return _start_of(self.pid) == self.started


def _start_of(pid: int) -> str:
    """Start time of a process, in clock ticks since boot; "" where it is unknown, or for a zombie."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[_STARTED]


class Results:
    """The directory of a sweep.

    Args:
        folder: of the sweep.
        digest: hash of the plan.
    """

    def __init__(self, folder: Path, digest: str):
        self.folder = folder
        self.digest = digest

    # --- rows ---------------------------------------------------------------------------------------------------

    def row_path(self, trial: int) -> Path:
        """Path of the row of a trial."""
        return self._numbered("rows", trial, ".json")

    def write_row(self, row: Row) -> bool:
        """Write a row to disk; returns False where the trial already has one, which stays.

        Raises:
            StorageError: it cannot be written.
        """
        target = self.row_path(row["trial"])
        text = json.dumps({**row, "plan": self.digest}, allow_nan=False, ensure_ascii=False)
        with self._aside(target) as aside:
            with aside.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            return _linked(aside, target)

    def row(self, trial: int) -> Row | None:
        """The row of a trial; None where there is none."""
        try:
            return self._read_row(self.row_path(trial))
        except FileNotFoundError:
            return None

    def rows(self) -> Iterator[Row]:
        """All rows, in no order."""
        for path in self._files("rows"):
            yield self._read_row(path)

    def _read_row(self, path: Path) -> Row:
        text = path.read_text(encoding="utf-8")
        try:
            row: Row = json.loads(text)
            plan = row.pop("plan")
        except (ValueError, KeyError, AttributeError):
            raise BadInputError(f"{str(path)!r} is not a row of a sweep: remove it, and its trial runs again") from None
        if plan != self.digest:
            raise BadInputError(f"{str(path)!r} is a row of another sweep: remove it, and its trial runs again")
        return row

    def set_aside(self, trial: int) -> None:
        """Rename the row of a failed trial, so that the trial runs again."""
        path = self.row_path(trial)
        with writing(self.folder):
            number = sum(1 for _ in path.parent.glob(f"{path.stem}.retried-*"))
            path.rename(path.with_name(f"{path.stem}.retried-{number + 1}"))

    # --- marks --------------------------------------------------------------------------------------------------

    def claim(self, trial: int) -> bool:
        """Mark a trial as running in this process; returns False where another living process runs it."""
        mark = self._mark(trial)
        text = json.dumps({**vars(Owner.here()), "since": time.time()})
        with self._aside(mark) as aside:
            aside.write_text(text, encoding="utf-8")
            if not self.owned(trial):
                mark.unlink(missing_ok=True)
            return _linked(aside, mark)

    def lose(self, trial: int, reason: str) -> None:
        """Mark a trial as lost, with the reason: its processes died more often than by chance."""
        mark = self._mark(trial)
        text = json.dumps({"host": socket.gethostname(), "pid": 0, "started": "none", "reason": reason})
        self.write(mark, lambda path: path.write_text(text, encoding="utf-8"))

    def release(self, trial: int) -> None:
        """Remove the mark of a trial."""
        with contextlib.suppress(OSError):
            self._mark(trial).unlink(missing_ok=True)

    def beat(self, trial: int) -> None:
        """Update the time of the mark of a trial, as a sign of life."""
        with contextlib.suppress(OSError):
            os.utime(self._mark(trial))

    def begun(self, trial: int) -> bool:
        """Whether a process has marked a trial, alive or not."""
        return self._mark(trial).is_file()

    def owned(self, trial: int) -> bool:
        """Whether a living process has marked a trial."""
        owner = _owner(self._mark(trial))
        return owner is not None and owner[0].lives(owner[1])

    def marks(self) -> dict[int, bool]:
        """Every marked trial, and whether its process lives."""
        return {int(path.stem): self.owned(int(path.stem)) for path in self._files("running")}

    def tidy(self, lost: Container[int] = ()) -> None:
        """Remove what ended processes have left: marks and, where no process is running, half-written files.

        Args:
            lost: trials whose marks stay.
        """
        marks = self.marks()
        for number, lives in marks.items():
            if not lives and number not in lost:
                self.release(number)
        if any(marks.values()):
            return
        for pattern in (".*", "worst/.*", "figures/.*", "*/*/.*"):
            for path in filter(lambda path: _HALF.fullmatch(path.name), self.folder.glob(pattern)):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    with contextlib.suppress(OSError):
                        path.unlink()

    # --- further files --------------------------------------------------------------------------------------------

    def log_path(self, trial: int) -> Path:
        """Path of the kept log of a trial."""
        return self._numbered("logs", trial, ".nc")

    def signals_path(self, trial: int) -> Path:
        """Path of the recorded signals of a trial."""
        return self._numbered("signals", trial, ".npz")

    def write(self, path: Path, fill: Callable[[Path], object]) -> None:
        """Let `fill` write a temporary file, then rename it to `path`.

        Raises:
            StorageError: it cannot be written.
        """
        with self._aside(path) as aside:
            fill(aside)
            aside.replace(path)

    @contextlib.contextmanager
    def _aside(self, path: Path) -> Iterator[Path]:
        """Context with the path of a temporary file, to be renamed when complete; removed at the end.

        Raises:
            StorageError: something could not be written.
        """
        aside = path.with_name(f".{os.getpid()}-{path.name}")
        with writing(self.folder):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                yield aside
            finally:
                aside.unlink(missing_ok=True)

    def _mark(self, trial: int) -> Path:
        return self._numbered("running", trial, ".json")

    def _numbered(self, room: str, trial: int, ending: str) -> Path:
        return self.folder / room / f"{trial // _PER_FOLDER:04d}" / f"{trial:07d}{ending}"

    def _files(self, room: str) -> Iterator[Path]:
        with contextlib.suppress(FileNotFoundError):
            for folder in sorted(os.scandir(self.folder / room), key=lambda entry: entry.name):
                for entry in os.scandir(folder.path):
                    if entry.name.endswith(".json") and not entry.name.startswith("."):
                        yield Path(entry.path)


def _linked(aside: Path, target: Path) -> bool:
    """Give a file its name by a hard link; returns False where the name exists, which a renaming would replace."""
    try:
        os.link(aside, target)
    except FileExistsError:
        return False
    return True


def _owner(path: Path) -> tuple[Owner, float] | None:
    try:
        beat, content = path.stat().st_mtime, json.loads(path.read_text(encoding="utf-8"))
        return Owner(content["host"], content["pid"], content["started"]), beat
    except (OSError, ValueError, KeyError, TypeError):
        return None


def identity_of(folder: Path) -> dict[str, Any]:
    """The content of `sweep.json` in a results directory.

    Raises:
        BadInputError: it is none, or of another version of this program.
    """
    try:
        found: dict[str, Any] = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
        made = found["format"]
    except OSError:
        kind = "is not the results directory of a sweep" if os.path.isdir(folder) else "does not exist"
        raise BadInputError(f"{str(folder)!r} {kind}: must hold {IDENTITY}") from None
    except (ValueError, KeyError, TypeError):
        raise BadInputError(f"{str(folder / IDENTITY)!r} is damaged: start the sweep again elsewhere") from None
    if made != FORMAT:
        raise BadInputError(
            f"results directory {str(folder)!r} has format {made}: must be {FORMAT}, of this version of forcectl"
        )
    return found


def is_copy(folder: Path, identity: Mapping[str, Any]) -> bool:
    """Whether a results directory is a copy of the one that was begun."""
    return bool(identity["inode"] != folder.stat().st_ino)

"""The directory of a sweep: everything that is known of it, in files that are complete or not there::

    sweep.yaml       the sweep, with the content of its scenario
    sweep.json       hash of the plan, versions, shard, number of trials, where the directory is
    plan.parquet     every planned trial: number, point, arm, seed, keys
    rows/            a file for each finished trial, written aside and given its name when complete
    running/         a file for each trial at work: host, process, since when
    logs/            kept logs
    signals/         recorded signals, for envelopes
    trials.parquet   the table of results; costs.parquet: what they took
    report.html      figures and tables

A trial is *done* or *failed* when it has a row, *running* when it has a mark whose process lives, *lost* when that
process is gone, else *pending*. The directory says so by itself, whatever became of the programs that wrote it.
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
BEAT = 2.0  # [s] between two signs of life of a mark
SILENT = 60.0  # [s] after which the owner of a mark on another machine is taken for dead
_PER_FOLDER = 1000
_HALF = re.compile(r"\.\d+-.+|\..+\.(\d+|partial)")  # names of what is being written
_STARTED = 19  # which of the fields of /proc/PID/stat, after the name, is the time of its start

Row = dict[str, Any]


@dataclass(frozen=True)
class Owner:
    """A process: its machine, number and start, which tells it from a later one of the same number."""

    host: str
    pid: int
    started: str

    @staticmethod
    def here() -> Owner:
        """This process."""
        return Owner(socket.gethostname(), os.getpid(), _start_of(os.getpid()))

    def lives(self, beat: float) -> bool:
        """Whether the process is at work.

        Args:
            beat: time of its last sign of life [s since 1970], which counts where it is on another machine.
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
    """When a process began, in ticks since the machine did; "" where the system does not say, or for a zombie."""
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
        """Where the row of a trial stands."""
        return self._numbered("rows", trial, ".json")

    def write_row(self, row: Row) -> bool:
        """Make a row durable; returns False where the trial has one, which stays.

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
        """Keep the row of a failed trial beside, so that the trial runs again."""
        path = self.row_path(trial)
        with writing(self.folder):
            number = sum(1 for _ in path.parent.glob(f"{path.stem}.retried-*"))
            path.rename(path.with_name(f"{path.stem}.retried-{number + 1}"))

    # --- marks --------------------------------------------------------------------------------------------------

    def claim(self, trial: int) -> bool:
        """Mark a trial as at work in this process; False where another living process has it."""
        mark = self._mark(trial)
        text = json.dumps({**vars(Owner.here()), "since": time.time()})
        with self._aside(mark) as aside:
            aside.write_text(text, encoding="utf-8")
            if not self.owned(trial):
                mark.unlink(missing_ok=True)
            return _linked(aside, mark)

    def lose(self, trial: int, reason: str) -> None:
        """Note why a trial has no row, and whose processes died, more often than is by chance."""
        mark = self._mark(trial)
        text = json.dumps({"host": socket.gethostname(), "pid": 0, "started": "none", "reason": reason})
        self.write(mark, lambda path: path.write_text(text, encoding="utf-8"))

    def release(self, trial: int) -> None:
        """Take the mark of a trial away."""
        with contextlib.suppress(OSError):
            self._mark(trial).unlink(missing_ok=True)

    def beat(self, trial: int) -> None:
        """Give a sign of life."""
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
        """Remove what processes that are gone have left: marks and, where none is at work, half-written files.

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
        """Where the kept log of a trial stands."""
        return self._numbered("logs", trial, ".nc")

    def signals_path(self, trial: int) -> Path:
        """Where the recorded signals of a trial stand."""
        return self._numbered("signals", trial, ".npz")

    def write(self, path: Path, fill: Callable[[Path], object]) -> None:
        """Let `fill` write a file aside, then give it its name.

        Raises:
            StorageError: it cannot be written.
        """
        with self._aside(path) as aside:
            fill(aside)
            aside.replace(path)

    @contextlib.contextmanager
    def _aside(self, path: Path) -> Iterator[Path]:
        """Where a file is written before it gets its name; gone in the end.

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
    """Give a file its name; unlike a renaming this never replaces what another process wrote, and is False there."""
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
    """What a results directory says of itself.

    Raises:
        BadInputError: it is none, or of another version of this program.
    """
    try:
        found: dict[str, Any] = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
        made = found["format"]
    except OSError:
        kind = "is not the results directory of a sweep" if folder.is_dir() else "does not exist"
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

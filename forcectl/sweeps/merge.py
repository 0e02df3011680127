"""Merging shards, and the progress of a sweep from its results directory, also while it is written."""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError
from forcectl.runs.claims.lock import locked
from forcectl.sweeps.agenda import Agenda
from forcectl.sweeps.results import Results, Row, identity_of
from forcectl.sweeps.run_sweep import SweepResult, begin, stored, write_report, write_tables
from forcectl.sweeps.study import study_of

_RECENT = 200  # latest finished trials, from which the remaining time is estimated


@dataclass(frozen=True)
class SweepStatus:
    """Progress of a sweep, from its results directory.

    Attributes:
        name: of the sweep.
        planned: trials of this shard; with `repeat`, those known so far to be needed.
        counts: trials by state.
        remaining_s: estimated time to the end [s]; None where it cannot be estimated.
    """

    name: str
    planned: int
    counts: dict[str, int]
    remaining_s: float | None


def status(folder: str | Path) -> SweepStatus:
    """Progress of a sweep, while it runs or after.

    Args:
        folder: of its results.

    Raises:
        BadInputError: it is no results directory.
    """
    folder = Path(folder).expanduser()
    identity = identity_of(folder)
    results = Results(folder, identity["digest"])
    rows = list(results.rows())
    finished = {row["trial"] for row in rows}
    marks = {number: lives for number, lives in results.marks().items() if number not in finished}
    counts = {state: sum(row["state"] == state for row in rows) for state in ("done", "failed")}
    counts |= {"running": sum(marks.values()), "lost": len(marks) - sum(marks.values())}
    index, shards = identity["shard"]
    planned = identity["trials"] // identity["points"] * len(range(index, identity["points"], shards))
    if identity["writable"] and (file := stored(folder)).config.repeat is not None:
        planned = Agenda(study_of(file), (index, shards), rows).total
    counts["pending"] = max(0, planned - sum(counts.values()))
    return SweepStatus(identity["name"], planned, counts, _remaining(rows, counts["pending"] + counts["running"]))


def _remaining(rows: Sequence[Row], left: int) -> float | None:
    times = sorted(row["cost"]["finished"] for row in rows)[-_RECENT:]
    if len(times) < 3 or not left or time.time() - times[-1] > 600:
        return None
    return left * statistics.fmean(after - before for before, after in pairwise(times))


def merge(
    folders: Sequence[str | Path], out: str | Path, sweep: Any = None, allow_imports: Sequence[str] = ()
) -> SweepResult:
    """Merge the results of shards; rows that `out` has already stay, so that merging can be repeated.

    Args:
        folders: results directories of one sweep.
        out: directory of the merged sweep; created if it does not exist.
        sweep: the sweep, if it holds objects from Python and cannot be read from the directories.
        allow_imports: names of modules that the scenario may name, see `load_scenario`.

    Raises:
        BadInputError: a directory is of another sweep, or two of them contradict each other.
        StorageError: `out` cannot be written.
    """
    parts, target = [Path(folder).expanduser() for folder in folders], Path(out).expanduser()
    if not parts:
        raise BadInputError("merge needs at least one results directory")
    study = study_of(stored(parts[0], sweep), allow_imports)
    digest = study.digest()
    for part in parts:
        if part.resolve() == target.resolve():
            raise BadInputError(f"--out {str(out)!r} is one of the directories: must be another one")
    for folder in [*parts, *([target] if target.exists() else [])]:
        if identity_of(folder)["digest"] != digest:
            raise BadInputError(f"results directory {str(folder)!r} is of another sweep than {str(parts[0])!r}")
    if not target.exists():
        begin(study, target, (0, 1))
    elif identity_of(target)["shard"] != [0, 1]:
        raise BadInputError(f"--out {str(out)!r} is a shard: must be a new directory, or an earlier whole")
    with locked(target):
        results = Results(target, digest)
        rows = {row["trial"]: row for row in results.rows()}
        for part in parts:
            source = Results(part, digest)
            for row in source.rows():
                if _better(row, rows.get(row["trial"]), part):
                    _bring(source, results, row, replace=row["trial"] in rows)
                    rows[row["trial"]] = row
        table = write_tables(study, results, Agenda(study, (0, 1), rows.values()), rows)
        write_report(study, results, table, rows)
        return SweepResult(table, target)


def _better(row: Row, other: Row | None, part: Path) -> bool:
    """Whether a row of a trial replaces another one.

    Raises:
        BadInputError: both are done, and differ in more than their cost.
    """
    if other is None:
        return True
    if row["state"] != other["state"]:
        return bool(row["state"] == "done")
    if row["state"] == "done" and {**row, "cost": None} != {**other, "cost": None}:
        raise BadInputError(
            f"trial {row['trial']} in {str(part)!r} differs from that of another directory: must be the same; run it "
            "again where it was run with other code"
        )
    return False


def _bring(source: Results, target: Results, row: Row, replace: bool) -> None:
    trial = row["trial"]
    for before, after in (
        (source.log_path(trial), target.log_path(trial)),
        (source.signals_path(trial), target.signals_path(trial)),
    ):
        if before.is_file():
            target.write(after, partial(shutil.copyfile, before))
    if replace:
        target.set_aside(trial)
    target.write_row(row)

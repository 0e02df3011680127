"""Running a sweep: plan, engine, table, report; and resuming one that was stopped."""

from __future__ import annotations

import contextlib
import html
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forcectl.errors import BadInputError, RunFailedError
from forcectl.framework.expression import Expression
from forcectl.runs.claims.claim import write_whole
from forcectl.runs.claims.lock import StorageError, locked, writing
from forcectl.runs.directory import git_state, write_json
from forcectl.runs.workers import check_can_be_sent
from forcectl.scenario.scenario import as_file
from forcectl.sweeps.agenda import Agenda
from forcectl.sweeps.at_work import SweepProgress, SweepRun, engine_of
from forcectl.sweeps.results import (
    FORMAT,
    IDENTITY,
    SWEEP,
    Results,
    Row,
    identity_of,
    is_copy,
)
from forcectl.sweeps.study import Study, at_lines, study_of, versions
from forcectl.sweeps.sweep_config import SweepConfig, SweepFile, read_sweep
from forcectl.sweeps.table import (
    COSTS,
    PLAN,
    TRIALS,
    costs_table,
    plan_table,
    trials_table,
    without_effect,
    write_table,
)

if TYPE_CHECKING:
    import pandas as pd

ENGINES = ("processes", "sequential")


@dataclass(frozen=True, repr=False)
class SweepResult:
    """A finished sweep.

    Attributes:
        table: a row for each trial, see `forcectl.sweeps.table`.
        directory: of the results; None where none was given.
        notes: remarks on the plan and the directory.
    """

    table: pd.DataFrame
    directory: Path | None
    notes: list[str] = field(default_factory=list)

    def count(self, state: str) -> int:
        """How many trials are in a state: "done", "failed", "lost" or "pending"."""
        return int((self.table["state"] == state).sum())

    def __repr__(self) -> str:
        states = [f"{n} {state}" for state, n in self.table["state"].value_counts().items()]
        place = [f"in {self.directory}"] if self.directory else []
        return f"<sweep of {len(self.table)} trials: {', '.join([*states, *place])}>"

    def _repr_html_(self) -> str:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return f"<p>{html.escape(repr(self))}</p>{self.table.to_html(max_rows=20)}<ul>{notes}</ul>"


def sweep(
    sweep: str | Path | Mapping[str, Any] | SweepConfig,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    retry_failed: bool = False,
    fail_fast: bool = False,
    shard: tuple[int, int] | None = None,
    engine: str = "processes",
    workers: int | None = None,
    scheduler: str | None = None,
    trial_timeout: float | None = None,
    report: bool = True,
    allow_imports: Sequence[str] = (),
    progress: Callable[[SweepProgress], None] | None = None,
) -> SweepResult:
    """Run variations of a scenario.

    Args:
        sweep: path of a sweep file or name of a shipped one, its content as a mapping, or a `SweepConfig`; with
            `resume` also the directory of a sweep.
        out: directory of the results; None keeps the table only.
        resume: continue the sweep in `out`.
        retry_failed: run failed trials again; needs `resume`.
        fail_fast: stop at the first trial that fails.
        shard: number from 1, and how many shards there are: (2, 4) runs a quarter of the points.
        engine: "processes", or "sequential" for one after the other in this process.
        workers: processes; None: one per processor.
        scheduler: address of a Dask scheduler, which runs the trials instead.
        trial_timeout: longest elapsed time of a trial [s]; None: no limit.
        report: write the page with the figures, too, where there is a directory.
        allow_imports: names of modules that the scenario may name, see `load_scenario`.
        progress: called now and then.

    Raises:
        BadInputError: the sweep or the directory cannot be used.
        StorageError: the directory cannot be written any more; finished trials are kept.
        RunFailedError: `fail_fast` and a trial failed.
    """
    if engine not in ENGINES:
        raise BadInputError(f"engine = {engine!r}: must be one of {', '.join(ENGINES)}")
    if scheduler is not None and engine != "processes":
        raise BadInputError(f"engine = {engine!r}: must be left out with a scheduler")
    if workers is not None and (scheduler is not None or engine != "processes"):
        others = "a scheduler" if scheduler is not None else f"engine = {engine!r}"
        raise BadInputError(f"workers = {workers!r}: must be left out with {others}")
    if trial_timeout is not None and not trial_timeout > 0:
        raise BadInputError(f"trial_timeout = {trial_timeout!r}: must be positive")
    if retry_failed and not resume:
        raise BadInputError("retry failed: goes with resume, of a sweep that was run")
    file, folder = _given(sweep, out, resume)
    part = None if shard is None else _shard(*shard)
    sent = engine == "processes" and scheduler is None
    with contextlib.ExitStack() as stack:
        if folder is None:
            if resume:
                raise BadInputError("resume needs the directory of the results")
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="forcectl-sweep-"))) / file.name
        if os.path.exists(folder):
            _refuse_begun(folder, resume)
            stack.enter_context(locked(folder))
            study = _study(file, allow_imports, sent)
            part = _same(study, folder, part)
        else:
            if resume:
                raise BadInputError(f"results directory {str(folder)!r} does not exist: run the sweep without resume")
            study, part = _study(file, allow_imports, sent), part or (0, 1)
            begin(study, folder, part)
            stack.enter_context(locked(folder))
        results = Results(folder, study.digest())
        notes = _notes(study, folder)
        results.tidy()
        rows = {row["trial"]: row for row in results.rows()}
        if retry_failed:
            for number in [number for number, row in rows.items() if row["state"] == "failed"]:
                results.set_aside(number)
                del rows[number]
        agenda = Agenda(study, part, rows.values())
        with at_lines(file):
            run = SweepRun(study, results, agenda, rows, fail_fast, trial_timeout, progress)
        run.tell()  # from here on the sweep can be resumed
        if agenda.done < agenda.total:
            started = engine_of(study, results, trial_timeout, engine, workers, scheduler)
            try:
                with at_lines(file):
                    run.all(started)
            except (RunFailedError, KeyboardInterrupt, BadInputError):
                with contextlib.suppress(StorageError):  # the error that stopped the sweep is raised
                    write_tables(study, results, agenda, rows)
                raise
        table = write_tables(study, results, agenda, rows)
        together = sum(row["cost"].get("batch", 1) > 1 for row in rows.values())
        if together:
            notes.append(f"{together} of {len(rows)} trials ran side by side in batches")
        for key in without_effect(study, table):
            place = f"keys.{key}" if key != "seed" else "seeds" if study.config.repeat is None else "repeat"
            notes.append(f"{place} has no effect: all metrics are equal in trials that differ in nothing else")
        for name in Expression(study.config.success).names if study.config.success else ():
            if name not in table or not table[name].notna().any():
                notes.append(f"success uses {name}, of which no trial has a value: no trial is a success")
        worst = study.config.worst
        if worst is not None and (worst.metric not in table or not table[worst.metric].notna().any()):
            notes.append(f"no trial has a value of {worst.metric}, so none is the worst")
        kept = out is not None or resume
        if kept and report:
            write_report(study, results, table, rows, run.tell)
        return SweepResult(table, folder if kept else None, notes)


def _given(sweep: Any, out: str | Path | None, resume: bool) -> tuple[SweepFile, Path | None]:
    folder = None if out is None else Path(os.path.expanduser(out))
    if isinstance(sweep, str | Path) and os.path.isfile(Path(os.path.expanduser(sweep)) / IDENTITY):
        if not resume:
            raise BadInputError(
                f"{str(sweep)!r} is the directory of a sweep: add --resume (resume=True) to go on with it"
            )
        if folder is not None and folder.resolve() != Path(os.path.expanduser(sweep)).resolve():
            raise BadInputError(f"--out {str(out)!r}: must be left out when the directory to go on with is named")
        folder = Path(os.path.expanduser(sweep))
        return stored(folder), folder
    return read_sweep(sweep), folder


def stored(folder: Path, sweep: Any = None) -> SweepFile:
    """The sweep that a results directory is of.

    Args:
        folder: the directory.
        sweep: as it was given from Python; needed if it holds objects from Python.

    Raises:
        BadInputError: it is none, or its sweep holds objects from Python and is not given.
    """
    identity = identity_of(folder)
    if sweep is not None:
        return replace(read_sweep(sweep), name=identity["name"])
    if not identity["writable"]:
        raise BadInputError(f"the sweep in {str(folder)!r} holds objects from Python: go on with it from Python")
    config = read_sweep(folder / SWEEP).config
    config.scenario = replace(as_file(config.scenario), name=identity["scenario"], folder=Path.cwd())
    return SweepFile(identity["name"], config, SWEEP, {})


def _study(file: SweepFile, allow_imports: Sequence[str], sent: bool) -> Study:
    """The plan of a sweep; `sent`: refused if worker processes cannot read it."""
    study = study_of(file, allow_imports)
    if sent:
        check_can_be_sent(study, "or take engine='sequential'")
    return study


def _shard(number: int, count: int) -> tuple[int, int]:
    if not 1 <= number <= count:
        raise BadInputError(f"shard = {number}/{count}: must be I/N with I from 1 to N")
    return number - 1, count


def begin(study: Study, folder: Path, part: tuple[int, int]) -> None:
    """Write the whole plan, before anything runs."""

    def fill(aside: Path) -> None:
        (aside / SWEEP).write_text(study.text, encoding="utf-8")
        write_table(Results(aside, study.digest()), PLAN, plan_table(study, range(study.size)))
        write_json(aside / IDENTITY, _identity(study, aside, part))

    try:
        with writing(folder):
            made = write_whole(folder, fill)
    except BadInputError:
        if os.path.exists(folder):
            _refuse_begun(folder, resume=False)
        raise
    if made != folder:  # another program has begun a sweep there meanwhile
        shutil.rmtree(made)
        _refuse_begun(folder, resume=False)


def _identity(study: Study, folder: Path, part: tuple[int, int]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": study.name,
        "scenario": study.file.name,
        "digest": study.digest(),
        "versions": versions(),
        "git": git_state(),
        "trials": study.size,
        "points": len(study.points),
        "left_out": study.left_out,
        "shard": list(part),
        "writable": study.writable,
        "begun": time.time(),
        "inode": folder.stat().st_ino,  # differs in a copy of the directory
    }


def _refuse_begun(folder: Path, resume: bool) -> None:
    if resume:
        identity_of(folder)
    elif os.path.isfile(folder / IDENTITY):
        raise BadInputError(
            f"results directory {str(folder)!r} exists: add --resume (resume=True) to go on, or name another one"
        )
    else:
        raise BadInputError(f"output {str(folder)!r} exists: name another directory")


def _same(study: Study, folder: Path, part: tuple[int, int] | None) -> tuple[int, int]:
    """Refuse a directory that is not of this sweep; returns its shard."""
    identity = identity_of(folder)
    if (theirs := identity["versions"]) != (mine := versions()):
        differing = [
            f"{name} {theirs.get(name)} (here {mine[name]})" for name in mine if theirs.get(name) != mine[name]
        ]
        raise BadInputError(f"results directory {str(folder)!r} was begun with other versions: {', '.join(differing)}")
    if identity["digest"] != study.digest():
        raise BadInputError(
            f"results directory {str(folder)!r} is of another sweep: its plan differs; see {SWEEP} there, or name "
            "another directory"
        )
    own = (identity["shard"][0], identity["shard"][1])
    if part is not None and part != own:
        raise BadInputError(f"results directory {str(folder)!r} is of shard {own[0] + 1}/{own[1]}")
    return own


def _notes(study: Study, folder: Path) -> list[str]:
    notes = []
    if study.left_out:
        notes.append(f"{study.left_out} points were left out: they do not meet the constraints")
    elif study.config.constraints:
        notes.append("constraints has no effect: every point meets them")
    identity = identity_of(folder)
    if is_copy(folder, identity):
        notes.append(f"{folder} is a copy: trials that still run in the original are ignored")
        shutil.rmtree(folder / "running", ignore_errors=True)
        with writing(folder):
            write_json(folder / IDENTITY, identity | {"inode": folder.stat().st_ino})
    return notes


def write_report(
    study: Study,
    results: Results,
    table: pd.DataFrame,
    rows: Mapping[int, Row],
    tell: Callable[[], None] = lambda: None,
) -> None:
    """Run the worst trials again, and write the page.

    Args:
        study: the sweep.
        results: its directory.
        table: of results.
        rows: of finished trials, by number.
        tell: called between steps of the work.

    Raises:
        StorageError: the directory cannot be written.
    """
    # Matplotlib takes half a second to import, and a sweep without a directory needs none of it.
    from forcectl.sweeps.report.page import write_report as write_page
    from forcectl.sweeps.report.worst import keep_worst

    complete = set(table["state"]) <= {"done", "failed"}
    if complete:
        keep_worst(study, results, table, tell)
    tell()
    write_page(study, results, table, costs_table(rows), complete)


def write_tables(study: Study, results: Results, agenda: Agenda, rows: Mapping[int, Row]) -> pd.DataFrame:
    """Write the table of results and that of costs; returns the first."""
    table = trials_table(study, agenda.asked, rows, results.marks())
    write_table(results, TRIALS, table)
    write_table(results, COSTS, costs_table(rows))
    return table

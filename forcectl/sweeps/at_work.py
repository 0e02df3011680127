"""A running sweep: trials are handed to an engine, and the outcome of each is read from the results directory."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from forcectl.analysis.tables.metric_tables import unknown_metric
from forcectl.errors import RunFailedError
from forcectl.runs.claims.lock import StorageError
from forcectl.runs.workers import EndedTask, Workers
from forcectl.sweeps.agenda import Agenda
from forcectl.sweeps.batches import Task
from forcectl.sweeps.engines import Engine, Sequential, reported
from forcectl.sweeps.results import Results, Row
from forcectl.sweeps.study import Study, unknown_metrics
from forcectl.sweeps.trial import cost, row_of, timeout_reason

DEATHS = 3  # deaths of the process of a trial, after which the trial is lost
_LOOK = 1.0  # [s] between two checks of trials that other processes run


@dataclass(frozen=True)
class SweepProgress:
    """Progress of a sweep: number of trials finished, known so far to be needed, failed, and lost."""

    done: int
    total: int
    failed: int
    lost: int


def engine_of(
    study: Study,
    results: Results,
    timeout: float | None,
    engine: str,
    workers: int | None,
    scheduler: str | None,
) -> Engine:
    """The engine that runs the trials: Dask if a scheduler is named, else this process or worker processes.

    Args:
        study: the sweep.
        results: its directory.
        timeout: of a trial [s]; None: none.
        engine: "processes" or "sequential".
        workers: processes; None: one per processor.
        scheduler: address of a Dask scheduler; None: none.

    Raises:
        BadInputError: the scheduler cannot be used.
    """
    if scheduler is not None:
        from forcectl.sweeps.dask_engine import DaskEngine

        return DaskEngine(study, results, timeout, scheduler)
    if engine == "sequential":
        return Sequential(study, results, timeout)
    return Workers(reported, (study, results, timeout), workers or os.cpu_count() or 1, timeout)


class SweepRun:
    """A running sweep.

    Args:
        study: the sweep.
        results: its directory.
        agenda: the trials to run.
        rows: of finished trials, by number; those of new ones are added.
        fail_fast: stop at the first failed trial.
        timeout: of a trial [s]; None: none.
        progress: called now and then.
    """

    def __init__(
        self,
        study: Study,
        results: Results,
        agenda: Agenda,
        rows: dict[int, Row],
        fail_fast: bool,
        timeout: float | None,
        progress: Callable[[SweepProgress], None] | None,
    ):
        self._study, self._results, self._agenda, self._rows = study, results, agenda, rows
        self._fail_fast, self._timeout, self._progress = fail_fast, timeout, progress
        self._deaths: dict[int, int] = {}
        self._lost: set[int] = set()
        self._failed = sum(row["state"] == "failed" for row in rows.values())
        self._unseen = unknown_metrics(study.config)
        self._seen: dict[str, set[str]] = {}  # metrics of the first trial by arm, while some are unseen
        for row in rows.values():
            self._see(row)

    def all(self, engine: Engine) -> None:
        """Run all trials of the agenda."""
        elsewhere = self._others()
        with self._closing(engine):
            while True:
                while engine.free > 0 and (task := self._next(elsewhere)) is not None:
                    engine.submit(task)
                self.tell()
                if engine.busy:
                    for ended in engine.wait():
                        self._end(ended)
                elif elsewhere:
                    time.sleep(_LOOK)
                else:
                    return
                self._look(elsewhere)

    @contextlib.contextmanager
    def _closing(self, engine: Engine) -> Iterator[None]:
        """Context that closes the engine in any case; its unfinished trials are pending again."""
        try:
            yield
        finally:
            engine.close()
            self._results.tidy(self._lost)

    def _others(self) -> set[int]:
        """Trials without a row that a living process still runs, such as one that an earlier program has started."""
        marks = self._results.marks()
        return {number for number, lives in marks.items() if lives and number not in self._rows}

    def _next(self, elsewhere: set[int]) -> Task | None:
        while (task := self._agenda.take()) is not None:
            if here := tuple(number for number in task.trials if number not in elsewhere):
                return task._replace(trials=here)
        return None

    def _look(self, elsewhere: set[int]) -> None:
        """Check the trials that other processes run: take their rows, or run them here if the process has died."""
        for number in list(elsewhere):
            row = self._results.row(number)
            if row is not None:
                elsewhere.discard(number)
                self._take(row)
            elif not self._results.owned(number):
                elsewhere.discard(number)
                self._agenda.put_back(number)

    def _end(self, ended: EndedTask) -> None:
        """Read the rows of the trials of an ended task; those without a row are run again, each by itself."""
        if ended.result:
            raise StorageError(ended.result)
        for number in ended.task.trials:
            self._end_trial(number, ended)

    def _end_trial(self, number: int, ended: EndedTask) -> None:
        row, together = self._results.row(number), len(ended.task.trials) > 1
        if row is None and ended.overdue and together:
            self._agenda.put_back(number)
            return
        if row is None and ended.overdue:
            row = row_of(self._study, self._study.trial(number), None, timeout_reason(self._timeout))
            row["cost"] = cost(self._timeout or 0.0, 0.0)
            self._results.write_row(row)
            self._results.release(number)
            row = self._results.row(number)
        if row is not None:
            self._take(row)
            return
        if not ended.cancelled or self._results.begun(number):
            self._deaths[number] = self._deaths.get(number, 0) + 1
        if not self._results.owned(number):
            self._results.release(number)  # so that one death is not counted twice
        if self._deaths.get(number, 0) < DEATHS:
            self._agenda.put_back(number)
            return
        self._lost.add(number)
        self._results.lose(number, f"{ended.death or 'it ended without a row'}, {DEATHS} times")

    def _take(self, row: Row) -> None:
        self._rows[row["trial"]] = row
        self._agenda.finish(row)
        self._see(row)
        if row["state"] == "failed":
            self._failed += 1
            if self._fail_fast:
                raise RunFailedError(f"trial {row['trial']} failed: {row['reason']}")

    def _see(self, row: Row) -> None:
        """Raise BadInputError for a requested metric that the first trial of no arm has."""
        if not self._unseen or row["state"] != "done":
            return
        self._seen.setdefault(self._study.trial(row["trial"]).arm, {*row["metrics"]})
        known = {name for names in self._seen.values() for name in names}
        self._unseen = {key: name for key, name in self._unseen.items() if name not in known}
        if self._unseen and len(self._seen) == len(self._study.arms):
            key, name = self._unseen.popitem()
            raise unknown_metric(name, known).at(key)

    def tell(self) -> None:
        """Report the progress."""
        if self._progress is not None:
            self._progress(SweepProgress(self._agenda.done, self._agenda.total, self._failed, len(self._lost)))

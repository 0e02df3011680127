"""One trial: simulate it and write its row."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from forcectl.diagrams.loop import check_range
from forcectl.errors import BadInputError, one_line
from forcectl.framework.expression import Expression
from forcectl.runs.logs import write_netcdf
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.runs.simulate_batch import simulate_batch
from forcectl.scenario.scenario import build, origins, resolve
from forcectl.sweeps.batches import Task
from forcectl.sweeps.results import BEAT, Results, Row
from forcectl.sweeps.study import Study, Trial

ENVELOPE_POINTS = 401  # samples of a recorded signal


class _TimeoutError(Exception):
    """A trial has exceeded its timeout."""


def run_task(study: Study, results: Results, task: Task, timeout: float | None = None) -> None:
    """Simulate trials and write their rows, except those that another process runs or that have a row.

    Args:
        study: the sweep.
        results: its directory.
        task: the trials.
        timeout: longest elapsed time of a trial [s], checked from time to time; None: none.

    Raises:
        StorageError: the directory cannot be written.
    """
    claimed: list[int] = []
    try:
        for number in task.trials:
            if not results.row_path(number).exists() and results.claim(number):
                claimed.append(number)
        trials = [study.trial(number) for number in claimed]
        with _signs_of_life(results, claimed):
            if task.batch:
                _run_batch(study, results, trials, timeout)
            else:
                for trial in trials:
                    _run_alone(study, results, trial, timeout)
    finally:
        for number in claimed:
            results.release(number)


def _run_batch(study: Study, results: Results, trials: Sequence[Trial], timeout: float | None) -> None:
    """Simulate trials as one batch; a trial that cannot be simulated, or stops the others, runs alone."""
    clock, valid = _Clock(timeout), []
    for trial in trials:
        try:
            scenario = study.scenario(trial)
            check_range(scenario.parts)
        except BadInputError:
            _run_alone(study, results, trial, timeout)
        else:
            valid.append((trial, scenario))
    if not valid:
        return
    try:
        outcomes = simulate_batch([scenario for _, scenario in valid], study.variant, clock.watch)
    except (Exception, SystemExit):
        left = [trial for trial, _ in valid]
        if len(left) == 1:
            _run_alone(study, results, left[0], timeout)
        else:
            for half in (left[: len(left) // 2], left[len(left) // 2 :]):
                _run_batch(study, results, half, timeout)
        return
    share = clock.cost(len(valid))
    for (trial, scenario), outcome in zip(valid, outcomes, strict=True):
        row = row_of(study, trial, outcome, outcome.failure or "")
        _keep(study, results, trial.number, outcome, scenario.duration)
        results.write_row(row | {"cost": share})


class _Clock:
    """Elapsed and computing time since it was made, with a timeout [s]; None: no timeout."""

    def __init__(self, timeout: float | None):
        self._timeout, self._wall, self._cpu = timeout, time.perf_counter(), time.thread_time()

    def watch(self, _: str, __: float) -> None:
        """Raise `_TimeoutError` after the timeout; called during a simulation."""
        if self._timeout is not None and time.perf_counter() - self._wall > self._timeout:
            raise _TimeoutError

    def cost(self, batch: int) -> dict[str, Any]:
        """The cost of a trial, as its share in that of a batch."""
        return cost((time.perf_counter() - self._wall) / batch, (time.thread_time() - self._cpu) / batch, batch)


def _run_alone(study: Study, results: Results, trial: Trial, timeout: float | None) -> None:
    clock = _Clock(timeout)
    outcome, duration, reason = None, 0.0, ""
    try:
        changes = study.overrides(trial)
        scenario = resolve(study.file, study.variant, changes)
        duration = scenario.duration
        loop = build(scenario, origins(study.file, study.variant, changes))
        outcome = simulate(scenario, loop, study.variant, progress=clock.watch)
        if outcome.interrupted:
            raise KeyboardInterrupt
        reason = outcome.failure or ""
    except _TimeoutError:
        reason = timeout_reason(timeout)
    except MemoryError:
        reason = "out of memory"
    except BadInputError as error:
        reason = str(error)
    except (Exception, SystemExit) as error:  # user code may raise anything: the row names the error
        reason = one_line(error)
    row = row_of(study, trial, outcome, reason)
    if outcome is not None:
        _keep(study, results, trial.number, outcome, duration)
    results.write_row(row | {"cost": clock.cost(1)})


def timeout_reason(timeout: float | None) -> str:
    """The reason in the row of a trial that took too long."""
    return f"took longer than the {timeout:g} s of --trial-timeout"


def cost(wall: float, cpu: float, batch: int = 1) -> dict[str, Any]:
    """Cost of a trial: elapsed and computing time [s], size of its batch, host, and when it was finished."""
    return {"wall_s": wall, "cpu_s": cpu, "batch": batch, "host": socket.gethostname(), "finished": time.time()}


def row_of(study: Study, trial: Trial, outcome: VariantOutcome | None, reason: str) -> Row:
    """The row of a trial, without its cost.

    Args:
        study: the sweep.
        trial: that was simulated.
        outcome: None where there is not even a log.
        reason: why it failed; "" where it did not.
    """
    metrics = {} if outcome is None else outcome.metrics
    finite = {name: value if value is None or math.isfinite(value) else None for name, value in metrics.items()}
    reached = 0.0 if outcome is None or not outcome.log.sizes["time"] else float(outcome.log["time"].values[-1])
    config = study.config
    success = None
    if config.success:
        success = not reason and bool(Expression(config.success, "success")(finite))
    found = [name for name, text in config.findings.items() if Expression(text, f"findings.{name}")(finite)]
    return {
        "trial": trial.number,
        "state": "failed" if reason else "done",
        "success": success,
        "findings": found,
        "run_findings": [] if outcome is None else [one.as_row() for one in outcome.findings],
        "reason": reason,
        "time_s": reached,
        "metrics": finite,
    }


def _keep(study: Study, results: Results, number: int, outcome: VariantOutcome, duration: float) -> None:
    """Write the log and recorded signals of a trial, if they are to be kept."""
    keep = study.config.keep
    if (keep == "all" or (keep == "failed" and outcome.failure)) and outcome.log.sizes["time"]:
        results.write(results.log_path(number), lambda path: write_netcdf(outcome.log, path))
    if study.config.envelope:
        signals = recorded(outcome.log, study.config.envelope, duration)

        def save(path: Path) -> None:
            with path.open("wb") as file:
                np.savez_compressed(file, **signals)

        results.write(results.signals_path(number), save)


def recorded(log: xr.Dataset, names: list[str], duration: float) -> Mapping[str, Any]:
    """Signals of a log at `ENVELOPE_POINTS` times over the duration of a trial; NaN after the end of the log.

    Args:
        log: over time.
        names: of signals; of a vector every component.
        duration: of the trial [s].
    """
    times = np.linspace(0.0, duration, ENVELOPE_POINTS)
    found: dict[str, Any] = {"time": times}
    for name in names:
        values = log[name].values.reshape(log.sizes["time"], -1)
        found[name] = np.array([np.interp(times, log["time"].values, column, right=np.nan) for column in values.T])
    return found


@contextlib.contextmanager
def _signs_of_life(results: Results, numbers: Sequence[int]) -> Iterator[None]:
    """Context that updates the marks of trials every `BEAT` seconds, as a sign of life."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(BEAT):
            for number in numbers:
                results.beat(number)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

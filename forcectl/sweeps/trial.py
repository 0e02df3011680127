"""One trial: simulate it and write its row."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from forcectl.errors import BadInputError, one_line
from forcectl.runs.logs import write_netcdf
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.scenario.scenario import build, origins, resolve
from forcectl.sweeps.expression import Expression
from forcectl.sweeps.results import BEAT, Results, Row
from forcectl.sweeps.study import Study, Trial

NOT_REPEATABLE = ("realtime_factor",)  # metrics that say how fast the computer was
ENVELOPE_POINTS = 401  # of a recorded signal


class _TimeoutError(Exception):
    """A trial has taken longer than it may."""


def run_trial(study: Study, results: Results, number: int, timeout: float | None = None) -> None:
    """Simulate a trial and write its row; nothing where another process has it, or it has a row.

    Args:
        study: the sweep.
        results: its directory.
        number: of the trial.
        timeout: largest computing time [s], looked at now and then; None: any.

    Raises:
        StorageError: the directory cannot be written.
    """
    if results.row_path(number).exists() or not results.claim(number):
        return
    try:
        with _signs_of_life(results, number):
            results.write_row(_simulated(study, results, study.trial(number), timeout))
    finally:
        results.release(number)


def _simulated(study: Study, results: Results, trial: Trial, timeout: float | None) -> Row:
    wall, cpu = time.perf_counter(), time.thread_time()

    def watch(_: str, __: float) -> None:
        if timeout is not None and time.perf_counter() - wall > timeout:
            raise _TimeoutError

    outcome, duration, reason = None, 0.0, ""
    try:
        changes = study.overrides(trial)
        scenario = resolve(study.file, study.variant, changes)
        duration = scenario.duration
        loop = build(scenario, origins(study.file, study.variant, changes))
        outcome = simulate(scenario, loop, study.variant, progress=watch)
        reason = outcome.failure or ""
    except _TimeoutError:
        reason = timeout_reason(timeout)
    except MemoryError:
        reason = "out of memory"
    except BadInputError as error:
        reason = str(error)
    except (Exception, SystemExit) as error:  # whatever a part of the user's does: a row, with its name
        reason = one_line(error)
    row = row_of(study, trial, outcome, reason)
    if outcome is not None:
        _keep(study, results, trial.number, outcome, duration)
    return row | {"cost": cost(time.perf_counter() - wall, time.thread_time() - cpu)}


def timeout_reason(timeout: float | None) -> str:
    """What is said of a trial that took too long."""
    return f"took longer than the {timeout:g} s of --trial-timeout"


def cost(wall: float, cpu: float) -> dict[str, Any]:
    """What a trial took: elapsed and computing time [s], where, and when it was done."""
    return {"wall_s": wall, "cpu_s": cpu, "host": socket.gethostname(), "finished": time.time()}


def row_of(study: Study, trial: Trial, outcome: VariantOutcome | None, reason: str) -> Row:
    """The row of a trial, but for its cost.

    Args:
        study: the sweep.
        trial: that was simulated.
        outcome: None where there is not even a log.
        reason: why it failed; "" where it did not.
    """
    metrics = {} if outcome is None else outcome.metrics
    finite = {
        name: value if value is None or math.isfinite(value) else None
        for name, value in metrics.items()
        if name not in NOT_REPEATABLE
    }
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
        "reason": reason,
        "time_s": reached,
        "metrics": finite,
    }


def _keep(study: Study, results: Results, number: int, outcome: VariantOutcome, duration: float) -> None:
    """Write what is kept of a trial beside its row."""
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
    """Signals of a log at `ENVELOPE_POINTS` times over the duration of a trial; after its end they are not a number.

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
def _signs_of_life(results: Results, number: int) -> Iterator[None]:
    """While a trial is simulated, say now and then that it is."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(BEAT):
            results.beat(number)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

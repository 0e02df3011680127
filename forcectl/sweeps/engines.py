"""Engines that run trials: in this process, or by `reported` in `Workers`. On Dask: `dask_engine`.

An engine runs tasks and reports which have ended; the result of a task says why the results directory cannot be
written. The outcome of a trial is always read from that directory: one that ended without a row is run again.
"""

from __future__ import annotations

from typing import Protocol

from forcectl.runs.claims.lock import StorageError
from forcectl.runs.workers import EndedTask
from forcectl.sweeps.batches import Task
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import Study
from forcectl.sweeps.trial import run_task


class Engine(Protocol):
    """Interface of an engine that runs trials."""

    @property
    def free(self) -> int:
        """Number of tasks that can be submitted now."""

    @property
    def busy(self) -> int:
        """Number of tasks that have not ended."""

    def submit(self, task: Task) -> None:
        """Take a task."""

    def wait(self) -> list[EndedTask]:
        """The tasks that have ended since the last call; waits for a moment where there are none."""

    def close(self) -> None:
        """Stop at once; running trials are lost."""


class Sequential:
    """Trials one after the other in this process, for debugging.

    Args:
        study: the sweep.
        results: its directory.
        timeout: of a trial [s]; None: none.
    """

    def __init__(self, study: Study, results: Results, timeout: float | None):
        self._study, self._results, self._timeout = study, results, timeout
        self._waiting: list[Task] = []

    @property
    def free(self) -> int:
        """Number of tasks that can be submitted now."""
        return 1 - len(self._waiting)

    @property
    def busy(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._waiting)

    def submit(self, task: Task) -> None:
        """Take a task."""
        self._waiting.append(task)

    def wait(self) -> list[EndedTask]:
        """Run the submitted task."""
        task = self._waiting.pop()
        run_task(self._study, self._results, task, self._timeout)
        return [EndedTask(task)]

    def close(self) -> None:
        """Nothing is left to end."""


def reported(study: Study, results: Results, timeout: float | None, task: Task) -> str:
    """Run trials in a worker process; returns why their rows could not be written, "" if they were."""
    try:
        run_task(study, results, task, timeout)
    except StorageError as error:
        return str(error)
    return ""

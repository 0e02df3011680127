"""Where trials are run: in this process, or in processes of one's own. On Dask: `dask_engine`.

An engine is asked to run trials and says which have ended. What became of them is never taken from it, but read from
the results directory: a trial that ended without a row is run again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from forcectl.runs.claims.lock import StorageError
from forcectl.runs.workers import Workers
from forcectl.sweeps.batches import Task
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import Study
from forcectl.sweeps.trial import run_task


@dataclass(frozen=True)
class Ended:
    """A task has ended, in whatever way.

    Attributes:
        task: what it was.
        fault: of the process that ran it; "" for none.
        overdue: the process was ended because it took too long.
        cancelled: by the engine, whether the task had begun or not.
        storage: the results directory cannot be written.
    """

    task: Task
    fault: str = ""
    overdue: bool = False
    cancelled: bool = False
    storage: bool = False


class Engine(Protocol):
    """What runs trials."""

    @property
    def free(self) -> int:
        """How many tasks it takes now."""

    @property
    def busy(self) -> int:
        """How many tasks it has."""

    def submit(self, task: Task) -> None:
        """Take a task."""

    def wait(self) -> list[Ended]:
        """The tasks that have ended since the last call; waits for a moment where there are none."""

    def close(self) -> None:
        """End everything now; trials at work are lost."""


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
        """How many tasks it takes now."""
        return 1 - len(self._waiting)

    @property
    def busy(self) -> int:
        """How many tasks it has."""
        return len(self._waiting)

    def submit(self, task: Task) -> None:
        """Take a task."""
        self._waiting.append(task)

    def wait(self) -> list[Ended]:
        """Run what was taken."""
        task = self._waiting.pop()
        run_task(self._study, self._results, task, self._timeout)
        return [Ended(task)]

    def close(self) -> None:
        """Nothing is left to end."""


class Processes:
    """Trials in processes of one's own; one that dies is replaced.

    Args:
        study: the sweep.
        results: its directory.
        timeout: of a trial [s]; None: none.
        count: of processes.
    """

    def __init__(self, study: Study, results: Results, timeout: float | None, count: int):
        self._workers = Workers(_run, (study, results, timeout), count, timeout)

    @property
    def free(self) -> int:
        """How many tasks it takes now."""
        return self._workers.free

    @property
    def busy(self) -> int:
        """How many tasks it has."""
        return self._workers.busy

    def submit(self, task: Task) -> None:
        """Give a task to a process that has none."""
        self._workers.submit(task)

    def wait(self) -> list[Ended]:
        """What has ended: tasks, and processes with them."""
        found = self._workers.wait()
        return [Ended(e.task, e.result or e.death, overdue=e.overdue, storage=bool(e.result)) for e in found]

    def close(self) -> None:
        """End all processes at once; what they were at is lost then, and the directory says so."""
        self._workers.close()


def _run(study: Study, results: Results, timeout: float | None, task: Task) -> str:
    """Run trials in a process of its own; returns why their rows could not be written, "" where they were."""
    try:
        run_task(study, results, task, timeout)
    except StorageError as error:
        return str(error)
    return ""

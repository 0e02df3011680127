"""Where trials are run: in this process, or in processes of one's own. On Dask: `dask_engine`.

An engine is asked to run trials and says which have ended. What became of them is never taken from it, but read from
the results directory: a trial that ended without a row is run again.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from forcectl.sweeps.batches import Task
from forcectl.sweeps.results import Results, StorageError
from forcectl.sweeps.study import Study
from forcectl.sweeps.trial import run_task

MOST_MEMORY = 1.5e9  # [B] of a process, after which it is replaced: Drake 1.51 keeps every system written in Python
GRACE = 5.0  # [s] after the end of its time that a trial is given to end by itself


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


_BEGUN = "begun"  # what a process says when it has been given a task


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    task: Task | None = None
    deadline: float = float("inf")


class Processes:
    """Trials in processes of one's own; one that dies is replaced.

    Args:
        study: the sweep.
        results: its directory.
        timeout: of a trial [s]; None: none.
        count: of processes.
    """

    def __init__(self, study: Study, results: Results, timeout: float | None, count: int):
        self._arguments = (study, results, timeout)
        self._timeout, self._count = timeout, count
        self._workers: list[_Worker] = []

    @property
    def free(self) -> int:
        """How many tasks it takes now."""
        return self._count - self.busy

    @property
    def busy(self) -> int:
        """How many tasks it has."""
        return sum(worker.task is not None for worker in self._workers)

    def submit(self, task: Task) -> None:
        """Give a task to a process that has none."""
        worker = next((worker for worker in self._workers if worker.task is None), None) or self._start()
        worker.task = task
        with contextlib.suppress(OSError):  # it is dead: `wait` finds out
            worker.pipe.send(task)

    def wait(self) -> list[Ended]:
        """What has ended: tasks, and processes with them."""
        wait([pipe for worker in self._workers for pipe in (worker.pipe, worker.process.sentinel)], timeout=0.5)
        ended = []
        for worker in list(self._workers):
            found = self._look_at(worker)
            if found is not None:
                ended.append(found)
        return ended

    def _look_at(self, worker: _Worker) -> Ended | None:
        task, found = worker.task, None
        try:
            if worker.pipe.poll():
                told = worker.pipe.recv()
                if told == _BEGUN:
                    if self._timeout is not None:
                        worker.deadline = time.monotonic() + self._timeout + GRACE
                    return None
                fault, memory = told
                worker.task, worker.deadline = None, float("inf")
                if memory > MOST_MEMORY:
                    self._end(worker)
                return None if task is None else Ended(task, fault, storage=bool(fault))
        except (EOFError, OSError):
            pass
        if not worker.process.is_alive():
            code = worker.process.exitcode
            found = f"its process was ended by signal {-code}" if code < 0 else f"its process ended with code {code}"
            self._end(worker)
            return None if task is None else Ended(task, found)
        if time.monotonic() > worker.deadline:
            self._end(worker)
            return None if task is None else Ended(task, overdue=True)
        return None

    def close(self) -> None:
        """End all processes at once."""
        for worker in list(self._workers):
            self._end(worker)

    def _start(self) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there,), daemon=True)
        with _interrupts_ignored(), _one_thread():
            process.start()
        there.close()
        self._workers.append(worker := _Worker(process, here))
        with contextlib.suppress(OSError):
            here.send(self._arguments)  # not with the start: a large study waits here until the process has imported
        return worker

    def _end(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.process.kill()
        worker.process.join()
        worker.process.close()
        worker.pipe.close()


def _work(pipe: Connection) -> None:
    """What a process does: tasks, until nobody asks for any."""
    threading.Thread(target=_die_with_parent, daemon=True).start()
    scale = 1 if sys.platform == "darwin" else 1024
    try:
        study, results, timeout = pipe.recv()
    except (EOFError, OSError):
        return
    while True:
        try:
            task = pipe.recv()
            pipe.send(_BEGUN)
        except (EOFError, OSError):
            return
        fault = ""
        try:
            run_task(study, results, task, timeout)
        except StorageError as error:
            fault = str(error)
        pipe.send((fault, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale))


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # what it was at is lost, and the directory says so


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Processes started within leave Ctrl-C to the one that started them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started within use one thread each: many with many threads are slower."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    added = [name for name in names if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]

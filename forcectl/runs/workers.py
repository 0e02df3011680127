"""Worker processes: they leave Ctrl-C to the process that starts them, use one thread each, and end with it."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import pickle
import resource
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from types import FunctionType
from typing import Any

from forcectl.errors import BadInputError, one_line
from forcectl.interrupts import interrupts_deferred

MOST_MEMORY = 1.5e9  # [B] of a process, after which it is replaced: Drake 1.51 keeps every system written in Python
GRACE = 5.0  # [s] after its timeout in which a task may end by itself
_BEGUN = "begun"  # message of a process that has received a task


@dataclass(frozen=True)
class EndedTask:
    """A task that has ended, whether with a result or not.

    Attributes:
        task: the task.
        result: of the job; None where its process has died before.
        death: how the process has died; "" otherwise.
        overdue: the process was ended because it took too long.
        cancelled: the task was cancelled; it may have begun or not.
    """

    task: Any
    result: Any = None
    death: str = ""
    overdue: bool = False
    cancelled: bool = False


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    task: Any = None
    deadline: float = float("inf")


class Workers:
    """Processes that run tasks; one that dies, takes too long or uses too much memory is replaced.

    Args:
        job: what they run: a function of a module, of `arguments` and the task; it must not raise.
        arguments: the same for every task.
        count: of processes.
        timeout: of a task [s]; None: none.
    """

    def __init__(self, job: Callable[..., Any], arguments: tuple[Any, ...], count: int, timeout: float | None = None):
        self._job, self._arguments = job, arguments
        self._count, self._timeout = count, timeout
        self._workers: list[_Worker] = []

    @property
    def free(self) -> int:
        """Number of tasks that can be submitted now."""
        return self._count - self.busy

    @property
    def busy(self) -> int:
        """Number of tasks that are running."""
        return sum(worker.task is not None for worker in self._workers)

    def submit(self, task: Any) -> None:
        """Send a task to an idle process."""
        worker = next((worker for worker in self._workers if worker.task is None), None) or self._start()
        worker.task = task
        with contextlib.suppress(OSError):  # it is dead: `wait` finds out
            worker.pipe.send(task)

    def wait(self) -> list[EndedTask]:
        """The tasks that have ended since the last call; waits up to 0.5 s if there are none."""
        wait([pipe for worker in self._workers for pipe in (worker.pipe, worker.process.sentinel)], timeout=0.5)
        return [ended for worker in list(self._workers) if (ended := self._look_at(worker)) is not None]

    def _look_at(self, worker: _Worker) -> EndedTask | None:
        task = worker.task
        try:
            if worker.pipe.poll():
                message = worker.pipe.recv()
                if message == _BEGUN:
                    if self._timeout is not None:
                        worker.deadline = time.monotonic() + self._timeout + GRACE
                    return None
                result, memory = message
                worker.task, worker.deadline = None, float("inf")
                if memory > MOST_MEMORY:
                    self._end(worker)
                return None if task is None else EndedTask(task, result)
        except (EOFError, OSError):
            pass
        if not worker.process.is_alive():
            code = worker.process.exitcode
            death = f"its process was ended by signal {-code}" if code < 0 else f"its process ended with code {code}"
            self._end(worker)
            return None if task is None else EndedTask(task, death=death)
        if time.monotonic() > worker.deadline:
            self._end(worker)
            return None if task is None else EndedTask(task, overdue=True)
        return None

    def close(self) -> None:
        """End all processes at once."""
        for worker in list(self._workers):
            self._end(worker)

    def _start(self) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there,), daemon=True)
        with starting_workers():
            process.start()
        there.close()
        self._workers.append(worker := _Worker(process, here))
        with contextlib.suppress(OSError):
            # Not with the start: what is large waits here until the process has imported.
            here.send((self._job, self._arguments))
        return worker

    def _end(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.process.kill()
        worker.process.join()
        worker.process.close()
        worker.pipe.close()


def check_can_be_sent(objects: Any, otherwise: str) -> None:
    """Refuse objects that processes of `Workers` cannot read, before any is started.

    Args:
        objects: anything.
        otherwise: what can be done instead of writing a class into a module, for the message.

    Raises:
        BadInputError: a class or a function in them is defined in a notebook or at a prompt; or they cannot be pickled.
    """
    try:
        _Pickler(io.BytesIO(), otherwise).dump(objects)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise BadInputError(f"cannot be sent to worker processes: {one_line(error)}; {otherwise}") from error


class _Pickler(ForkingPickler):
    """Finds what is defined in a program that other processes cannot import: it was not read from a file."""

    def __init__(self, file: io.BytesIO, otherwise: str):
        super().__init__(file)
        main = sys.modules["__main__"]
        self._otherwise = otherwise
        self._unreadable = main.__spec__ is None and getattr(main, "__file__", None) is None

    def reducer_override(self, found: Any) -> Any:
        if self._unreadable and isinstance(found, type | FunctionType) and found.__module__ == "__main__":
            raise BadInputError(
                f"{found.__qualname__} is defined in a notebook or at a prompt, where worker processes cannot import "
                f"it: write it into a module, such as {found.__qualname__.lower()}.py, and import it; {self._otherwise}"
            )
        return NotImplemented


def _work(pipe: Connection) -> None:
    """Main function of a process: run tasks until the pipe is closed."""
    end_with_parent()
    scale = 1 if sys.platform == "darwin" else 1024
    try:
        job, arguments = pipe.recv()
        while True:
            task = pipe.recv()
            pipe.send(_BEGUN)
            result = job(*arguments, task)
            pipe.send((result, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale))
    except (EOFError, OSError):  # the process that started this one has ended
        pass
    except KeyboardInterrupt:  # Ctrl-C to the whole group: the process that started this one reports it
        sys.exit(1)


@contextlib.contextmanager
def starting_workers() -> Iterator[None]:
    """Context whose processes leave Ctrl-C to this one and use one thread: many with many threads are slower.

    Nor do they import modules from the working directory, as Python would before it has the path of this process.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "PYTHONSAFEPATH")
    added = [name for name in names if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        with interrupts_deferred():
            yield
    finally:
        for name in added:
            del os.environ[name]


def end_with_parent() -> None:
    """End this process when the one that started it ends, even during a task."""
    threading.Thread(target=_wait_for_end, daemon=True).start()


def _wait_for_end() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)

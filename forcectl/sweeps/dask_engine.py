"""Trials on Dask: a scheduler somewhere, and workers that see the results directory."""

from __future__ import annotations

import contextlib
import logging
import queue
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, RunFailedError, one_line
from forcectl.runs.workers import EndedTask
from forcectl.sweeps.batches import Task
from forcectl.sweeps.engines import reported
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import Study, versions

CONNECT = 10.0  # [s] to reach a scheduler
RESTART = 60.0  # [s] in which workers may restart after all have died
_LOOK = 2.0  # [s] between two queries of the number of workers
_GONE = "the scheduler is gone: start it again"
_NO_WORKERS = "all workers are gone: start some again"
PER_THREAD = 2  # tasks in flight: more stall the scheduler, fewer leave workers without work


class DaskEngine:
    """Trials on the workers of a Dask scheduler.

    Args:
        study: the sweep.
        results: its directory, which every worker must see under the same path.
        timeout: of a trial [s], which workers check from time to time; None: none.
        address: of the scheduler.

    Raises:
        BadInputError: Dask is not installed, the scheduler cannot be reached, or it has no workers or workers with
            other versions.
    """

    def __init__(self, study: Study, results: Results, timeout: float | None, address: str):
        try:
            import distributed
            from distributed.comm.addressing import resolve_address
        except ImportError:
            raise BadInputError(
                f"--scheduler {address!r} needs Dask: install the extra with pip install 'forcectl[sweep]'"
            ) from None
        # A lost scheduler is reported in one line, not by the traceback that Dask logs.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            resolve_address(address)  # a client with an invalid address takes 20 s to close
            client: Any = distributed.Client
            self._client = client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, TimeoutError, ValueError, TypeError) as error:  # TypeError: tls:// without keys
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BadInputError(f"--scheduler {address!r} cannot be reached: {reason}") from None
        self._ended: queue.SimpleQueue[tuple[Task, Any]] = queue.SimpleQueue()
        self._futures: dict[Task, Any] = {}
        self._threads, self._next_look = 0, 0.0
        try:
            self._check_workers(results, address)
        except BaseException:
            self.close()
            raise
        self._given = (study, results, timeout)
        self._shared: Any = None

    def _check_workers(self, results: Results, address: str) -> None:
        mine = versions()
        try:
            states = self._client.run(_worker_state, str(results.folder))
        except OSError as error:
            raise BadInputError(
                f"--scheduler {address!r}: a worker disconnected, try again: {one_line(error)}"
            ) from None
        except Exception as error:
            raise BadInputError(
                f"--scheduler {address!r}: its workers cannot run forcectl: {one_line(error)}"
            ) from None
        if not states:
            raise BadInputError(f"--scheduler {address!r} has no workers: start some with `dask worker {address}`")
        for worker, (others, seen) in states.items():
            if others != mine:
                theirs = ", ".join(f"{k} {others.get(k)}" for k in mine if others.get(k) != mine[k])
                raise BadInputError(
                    f"worker {worker} has other versions: {theirs}; must be "
                    f"{', '.join(f'{k} {v}' for k, v in mine.items() if others.get(k) != v)}"
                )
            if not seen:
                raise BadInputError(
                    f"worker {worker} cannot access {str(results.folder)!r}: must be on a file system that all share"
                )

    @property
    def free(self) -> int:
        """Number of tasks that can be submitted now."""
        if time.monotonic() > self._next_look:
            with self._scheduler_there():
                self._threads = sum(self._client.nthreads().values())
            self._next_look = time.monotonic() + _LOOK
        return max(1, PER_THREAD * self._threads) - len(self._futures)

    @property
    def busy(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._futures)

    def submit(self, task: Task) -> None:
        """Hand a task to the scheduler."""
        with self._scheduler_there():
            if self._shared is None or self._shared.status != "finished":  # lost together with all workers that held it
                self._shared = self._scattered()
            key = f"trial-{task.trials[0]}-{uuid.uuid4().hex}"
            future = self._client.submit(_run, self._shared, task, pure=False, retries=0, key=key)
        self._futures[task] = future
        future.add_done_callback(lambda done: self._ended.put((task, done)))

    def _scattered(self) -> Any:
        """The data that every task needs, sent to the workers; waits for workers that restart."""
        deadline = time.monotonic() + RESTART
        while True:
            self._client.wait_for_workers(1, timeout=max(deadline - time.monotonic(), 0.1))
            try:
                return self._client.scatter([self._given], broadcast=True, hash=False)[0]
            except Exception:
                if self._client.status != "running" or time.monotonic() > deadline:
                    raise
                time.sleep(0.5)

    def wait(self) -> list[EndedTask]:
        """The tasks that have ended, as the scheduler reports."""
        found = []
        try:
            task, future = self._ended.get(timeout=0.5)
            while True:
                self._futures.pop(task, None)
                found.append(self._ended_task(task, future))
                task, future = self._ended.get_nowait()
        except queue.Empty:
            if self._client.status != "running":
                raise RunFailedError(_GONE) from None
        return found

    def _ended_task(self, task: Task, future: Any) -> EndedTask:
        with self._scheduler_there(), contextlib.suppress(CancelledError):
            if future.status == "finished":
                return EndedTask(task, future.result())
            if future.status == "error":
                return EndedTask(task, death=one_line(future.exception())[:200])
        return EndedTask(task, death="the workers that ran it ended", cancelled=True)

    def close(self) -> None:
        """Disconnect from the scheduler; trials that run there continue to their end."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self._client.cancel(list(self._futures.values()), force=True)
        with contextlib.suppress(Exception):
            self._client.close(timeout=1)

    @contextlib.contextmanager
    def _scheduler_there(self) -> Iterator[None]:
        """Context in which any error of the client becomes a one-line error."""
        try:
            yield
        except Exception as error:
            reason = _GONE
            with contextlib.suppress(Exception):  # of a scheduler that is gone
                if self._client.status == "running":
                    reason = one_line(error) if self._client.nthreads() else _NO_WORKERS
            raise RunFailedError(reason) from error


def _worker_state(folder: str) -> tuple[dict[str, str], bool]:
    """On a worker: its versions, and whether it sees the results directory."""
    return versions(), Path(folder).is_dir()


def _run(shared: tuple[Study, Results, float | None], task: Task) -> str:
    """On a worker: one task, see `reported`."""
    return reported(*shared, task)

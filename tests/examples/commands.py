"""Processes that begin with everything imported: each is forked from one that has it; a new Python pays seconds."""

import contextlib
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(  # what is not installed is left out
    [
        "dask.array",
        "distributed",
        "forcectl.cli.app",
        "forcectl.diagrams.loop",
        "forcectl.diagrams.station",
        "forcectl.figures.force",
        "forcectl.figures.motion",
        "forcectl.graph.formats.html",
        "forcectl.runs.reproduce",
        "h5netcdf",
        "matplotlib.pyplot",
        "rich.table",
    ]
)


def run_command(
    arguments: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    *,
    paths: Sequence[str] = (),
    script: Path | None = None,
) -> subprocess.CompletedProcess[str]:
    """`forcectl` with these arguments as a process of its own, or a script of Python.

    Args:
        arguments: of the command.
        folder: it is called in, which modules are looked for in first, as with `python -m`.
        environment: all variables of it.
        paths: where modules are looked for next.
        script: to run instead of forcectl.
    """
    return start_command(arguments, folder, environment, paths=paths, script=script).finish()


class RunningCommand:
    """A command at work, see `start_command`."""

    def __init__(self, arguments: list[str], *rest: object):
        self._arguments, self._written = arguments, TemporaryDirectory()
        self._outputs = [str(Path(self._written.name, name)) for name in ("stdout", "stderr")]
        self._process = WARM.Process(target=_run, args=(arguments, *rest, self._outputs))
        self._process.start()
        self.pid = self._process.pid

    def wait_for_start(self) -> None:
        """Wait until the command is called."""
        while not Path(self._outputs[1]).exists():
            time.sleep(0.01)

    def finish(self) -> subprocess.CompletedProcess[str]:
        """Wait for its end."""
        self._process.join()
        with self._written:
            texts = [Path(output).read_text(encoding="utf-8") for output in self._outputs]
        return subprocess.CompletedProcess(self._arguments, self._process.exitcode or 0, *texts)


def start_command(
    arguments: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    *,
    paths: Sequence[str] = (),
    script: Path | None = None,
) -> RunningCommand:
    """Start what `run_command` runs; arguments as there."""
    return RunningCommand(list(arguments), str(folder), dict(environment), list(paths), script and str(script))


def marked(mark: str) -> list[int]:
    """Processes that have a mark in the environment they were started with."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if mark.encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
    return found


def _run(
    arguments: list[str],
    folder: str,
    environment: dict[str, str],
    paths: list[str],
    script: str | None,
    outputs: list[str],
) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # as of a new process
    for number, output in enumerate(outputs, 1):
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT), number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[:0] = [folder, *paths]
    sys.argv = [script or "forcectl", *arguments]
    if script:
        runpy.run_path(script, run_name="__main__")
    else:
        from forcectl import cli

        cli.main()

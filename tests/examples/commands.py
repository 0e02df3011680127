"""Processes that begin with everything imported: each is forked from one that has it; a new Python pays seconds."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(  # what is not installed is left out
    [
        "dask.array",
        "distributed",
        "forcectl.cli",
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
    with TemporaryDirectory() as written:
        outputs = [str(Path(written, name)) for name in ("stdout", "stderr")]
        given = (list(arguments), str(folder), dict(environment), list(paths), script and str(script), outputs)
        process = WARM.Process(target=_run, args=given)
        process.start()
        process.join()
        texts = [Path(output).read_text(encoding="utf-8") for output in outputs]
        return subprocess.CompletedProcess(given[0], process.exitcode or 0, *texts)


def _run(
    arguments: list[str],
    folder: str,
    environment: dict[str, str],
    paths: list[str],
    script: str | None,
    outputs: list[str],
) -> None:
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

"""The commands `forcectl sweep` and `forcectl merge`."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from forcectl.cli.options import AllowImports, AsJson, Quiet, Workers, echo_json
from forcectl.errors import BadInputError, ForcectlError
from forcectl.interrupts import Interrupts, set_interrupt_message

if TYPE_CHECKING:
    from forcectl.sweeps.at_work import SweepProgress
    from forcectl.sweeps.run_sweep import SweepResult

_EVERY = 30.0  # [s] between two lines of progress where there is no terminal


def sweep(
    sweep: Annotated[
        str,
        typer.Argument(
            metavar="SWEEP", help="Sweep file, shipped sweep, or the directory of one (--resume and --status)."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of the results; default runs/<name>-<n>.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the sweep in SWEEP or --out.")] = False,
    retry: Annotated[str | None, typer.Option(metavar="failed", help="With --resume: also what failed.")] = None,
    fail_fast: Annotated[bool, typer.Option("--fail-fast", help="Stop at the first trial that fails.")] = False,
    shard: Annotated[str | None, typer.Option(metavar="I/N", help="This part of N only; see forcectl merge.")] = None,
    engine: Annotated[str, typer.Option(metavar="processes|sequential", help="Where trials run.")] = "processes",
    workers: Workers = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler that runs the trials instead.")
    ] = None,
    trial_timeout: Annotated[
        float | None, typer.Option(metavar="S", help="Longest elapsed time of a trial, in seconds.")
    ] = None,
    report: Annotated[bool, typer.Option(help="Write report.html and its figures.")] = True,
    allow_imports: AllowImports = None,
    status: Annotated[bool, typer.Option("--status", help="Only say how far the sweep in SWEEP is.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run variations of a scenario; finished trials are kept even if the sweep is stopped.

    Example: forcectl sweep robustness.yaml --out runs/robustness --workers 4
    """
    from forcectl.runs.claims.claim import free_name
    from forcectl.sweeps.results import IDENTITY
    from forcectl.sweeps.run_sweep import sweep as run_sweep
    from forcectl.sweeps.sweep_config import read_sweep

    if status:
        _show_status(sweep, as_json)
        return
    if retry not in (None, "failed"):
        raise BadInputError(f"--retry {retry!r}: must be failed")
    given = Path(os.path.expanduser(sweep))
    directory = out or (given if os.path.isfile(given / IDENTITY) else None)
    if directory is None and not resume:
        directory = free_name(Path("runs"), read_sweep(sweep).name)
    with Interrupts() as interrupts, _Display(quiet) as display:

        def show(progress: SweepProgress) -> None:
            interrupts.check()
            display.show(progress)

        try:
            result = run_sweep(
                sweep,
                out=out or (None if os.path.isfile(given / IDENTITY) else directory),
                resume=resume,
                retry_failed=retry is not None,
                fail_fast=fail_fast,
                shard=_shard(shard),
                engine=engine,
                workers=workers,
                scheduler=scheduler,
                trial_timeout=trial_timeout,
                report=report,
                allow_imports=allow_imports or (),
                progress=show,
            )
        except BaseException as error:
            if not display.shown or not isinstance(error, ForcectlError | KeyboardInterrupt):
                raise
            display.hide()
            how = f"go on with: forcectl sweep {directory} --resume"
            if isinstance(error, KeyboardInterrupt):
                set_interrupt_message(f"stopped; {how}")
                raise
            print(f"error: {error}; {how}", file=sys.stderr)
            raise typer.Exit(2 if isinstance(error, BadInputError) else 1) from error
    _show_result(result, report, as_json, quiet)


def merge(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Results of shards of one sweep.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Directory of the whole.")],
    allow_imports: AllowImports = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Merge the results of shards; may be repeated when there are more.

    Example: forcectl merge runs/part-1 runs/part-2 --out runs/whole
    """
    from forcectl.sweeps.merge import merge as put_together

    _show_result(put_together(folders, out, allow_imports=allow_imports or ()), True, as_json, quiet)


def _shard(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    number, slash, count = text.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise BadInputError(f"--shard {text!r}: must be I/N with I from 1 to N, for example 2/4")
    return int(number), int(count)


def _show_result(result: SweepResult, report: bool, as_json: bool, quiet: bool) -> None:
    from forcectl.sweeps.table import STATES

    counts = {state: result.count(state) for state in STATES if result.count(state)}
    if as_json:
        echo_json({"directory": str(result.directory), "counts": counts, "notes": result.notes})
    elif not quiet:
        typer.echo(", ".join(f"{count} {state}" for state, count in counts.items()) or "no trials in this shard")
        for note in result.notes:
            typer.echo(note)
        typer.echo(f"results in {result.directory}: trials.parquet{', report.html' if report else ''}")
        if set(counts) & {"pending", "lost", "running"}:
            typer.echo(f"go on with: forcectl sweep {result.directory} --resume")
    failed = result.table[result.table["state"] == "failed"]
    if len(failed):
        one = failed.iloc[0]
        others = f"; {len(failed) - 1} other{'s' * (len(failed) > 2)} failed" if len(failed) > 1 else ""
        print(f"error: trial {one['trial']} failed: {one['reason']}{others}", file=sys.stderr)
    if set(counts) - {"done"}:
        raise typer.Exit(1)


def _show_status(folder: str, as_json: bool) -> None:
    from forcectl.sweeps.merge import status

    found = status(folder)
    if as_json:
        echo_json(asdict(found))
        return
    counts = ", ".join(f"{count} {state}" for state, count in found.counts.items() if count)
    rest = "" if found.remaining_s is None else f"; about {_duration(found.remaining_s)} to go"
    typer.echo(f"{found.name}: {found.planned} trials{f': {counts}' if counts else ''}{rest}")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


class _Display:
    """A progress bar on standard error; where that is no terminal, a line every `_EVERY` seconds.

    Args:
        quiet: show nothing.
    """

    def __init__(self, quiet: bool):
        self._quiet = quiet

    def __enter__(self) -> _Display:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        self.shown = False
        self._terminal, self._last, self._started = sys.stderr.isatty(), 0.0, time.monotonic()
        columns = (MofNCompleteColumn(), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        text = TextColumn("{task.description}")
        disable = not self._terminal or self._quiet  # FORCE_COLOR makes no terminal of a pipe
        self._bars = Bars(*columns, text, console=Console(stderr=True), transient=True, disable=disable)
        self._task: Any = None
        self._bars.start()
        return self

    def show(self, progress: SweepProgress) -> None:
        """Show the progress of the sweep."""
        self.shown = True
        bad = [f"{n} {what}" for n, what in ((progress.failed, "failed"), (progress.lost, "lost")) if n]
        if self._terminal:
            if self._task is None:
                self._task = self._bars.add_task("", total=progress.total)
            self._bars.update(self._task, completed=progress.done, total=progress.total, description=", ".join(bad))
        elif not self._quiet and time.monotonic() - max(self._last, self._started) > _EVERY:
            self._last = time.monotonic()
            print(", ".join([f"{progress.done} of {progress.total} trials", *bad]), file=sys.stderr, flush=True)

    def hide(self) -> None:
        """Remove the bar."""
        self._bars.stop()

    def __exit__(self, *_: object) -> None:
        self.hide()

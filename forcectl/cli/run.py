"""The commands `forcectl run` and `forcectl show`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from forcectl.analysis.findings.finding import SEVERITIES, findings_lines, parse_severity
from forcectl.cli.options import (
    AllowImports,
    AsJson,
    Fidelity,
    Force,
    OnceCommand,
    Quiet,
    Seed,
    Settings,
    Target,
    Variant,
    echo_json,
    terminal,
)
from forcectl.cli.robot import print_assumed
from forcectl.errors import BadInputError
from forcectl.interrupts import set_interrupt_message
from forcectl.runs.terminal.realtime import check_realtime_rate

if TYPE_CHECKING:
    from forcectl.runs.result import RunResult
    from forcectl.runs.stored import StoredRun


def _checked(severity: str | None) -> str | None:
    return None if severity is None else parse_severity(severity, "--strict").word


def _rate(rate: float) -> float:
    return check_realtime_rate(rate, "--realtime-rate")


Strict = Annotated[
    str | None,
    typer.Option(
        metavar="[SEVERITY]",
        help="Exit with 1 on a finding that is at least: info, warning (if left out), or error.",
        callback=_checked,
    ),
]


class StrictCommand(OnceCommand):
    """A command whose option `--strict` may stand without a value, which then is `warning`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as usual, with the severity filled in."""
        following = [*args[1:], ""]
        alone = [word == "--strict" and after not in SEVERITIES for word, after in zip(args, following, strict=False)]
        filled = ["--strict=warning" if bare else w for w, bare in zip(args, alone, strict=True)]
        try:
            return super().parse_args(ctx, filled)
        except Exception as error:
            # A word after a bare --strict may be the scenario; if there is another one, it was meant as a severity.
            after = following[alone.index(True)] if any(alone) else ""
            if "unexpected extra argument" in str(getattr(error, "message", "")) and after.strip("-") == after != "":
                parse_severity(after, "--strict")
            raise


All = Annotated[bool, typer.Option("--all", help="Every metric, not only those that are expected and a short list.")]


def run(
    scenario: Target,
    variant: Variant = None,
    settings: Settings = None,
    seed: Seed = None,
    fidelity: Fidelity = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default runs/<name>-<n>.")
    ] = None,
    force: Force = False,
    allow_imports: AllowImports = None,
    replay: Annotated[
        bool, typer.Option("--replay", help="Also write a 3-D replay, one HTML page per variant.")
    ] = False,
    realtime_rate: Annotated[
        float,
        typer.Option(
            metavar="R", callback=_rate, help="At most R simulated seconds per second, 0.001 to 1000; 0: full speed."
        ),
    ] = 0.0,
    strict: Strict = None,
    all_: All = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a scenario, report findings on the run, and write log, metrics, figures and block diagram.

    Example: forcectl run fig_2_7 --set station.environment.stiffness=2e4 --seed 3
    """
    from forcectl.runs.claims.claim import Numbered
    from forcectl.runs.directory import of_analyses
    from forcectl.runs.terminal.progress import ProgressBars
    from forcectl.scenario.catalog import find_scenario
    from forcectl.scenario.gains import found_lines

    file = find_scenario(scenario)
    with ProgressBars(quiet) as progress:
        progress.stage("starting")  # Drake takes seconds to import
        from forcectl.cli.target import parse_settings
        from forcectl.runs.result import InterruptedRunError
        from forcectl.runs.run import run as simulate

        try:
            result = simulate(
                file,
                variant=variant,
                overrides=parse_settings(settings),
                seed=seed,
                fidelity=fidelity,
                out=out or Numbered(Path("runs"), file.name),
                force=force,
                allow_imports=allow_imports or (),
                replay=replay,
                realtime_rate=realtime_rate,
                progress=progress.show,
                stage=progress.stage,
            )
        except InterruptedRunError as interrupted:
            set_interrupt_message(str(interrupted))
            raise
    directory = Path(result.directory or ".")
    set_interrupt_message(f"interrupted: the results are in {directory}")
    if as_json:
        _echo_run(result, directory, "done")
    elif not quiet:
        title = f"{file.name}: {file.tree.get('title', '')}"
        remark = "Expectations are about the scenario as written; with --set none fails the run." if settings else ""
        _print_run(result, title, all_, remark)
        for line in found_lines(result.gains):
            typer.echo(line)
        print_assumed(result.assumed)
        pages = ", replay.html" if replay and len(result.metrics) == 1 else ", replay_<variant>.html" if replay else ""
        files = f"log.nc, metrics.json, figures/, diagram.html{pages}, scenario.yaml, manifest.json"
        typer.echo(f"results in {directory}: {', '.join([files, *of_analyses(directory)])}")
    if (not result.passed and not settings) or result.has_finding(strict):
        raise typer.Exit(1)


def show(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of a run or of a reproduction.")],
    all_: All = False,
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw the figures of the log, also of a run that was interrupted.")
    ] = False,
    allow_imports: AllowImports = None,
    as_json: AsJson = False,
) -> None:
    """Show the results of a run that was written, also of one that failed or was interrupted.

    Example: forcectl show runs/fig_2_7-1 --all
    """
    from forcectl.runs.claims.found import PARTIAL, found_at
    from forcectl.runs.stored import read_reproduction, read_run
    from forcectl.runs.terminal.tables import reproduction_lines
    from forcectl.sweeps.results import IDENTITY

    if (verdicts := read_reproduction(directory)) is not None:
        if as_json:
            echo_json({name: {v.target: v.as_row() for v in rows} for name, rows in verdicts.items()})
        else:
            terminal().print(reproduction_lines(verdicts.items()))
        return
    if os.path.isfile(directory / IDENTITY):
        raise BadInputError(
            f"{str(directory)!r} is the directory of a sweep, not of a run: open {directory / 'report.html'}, or see "
            f"`forcectl sweep {directory} --status`"
        )
    written = os.path.isdir(directory) and not directory.name.endswith(PARTIAL)
    if not written and (partial := found_at(directory)) is not None:
        typer.echo(f"{partial.directory}: {partial.state}")
        return
    stored = read_run(directory)
    if as_json:
        _echo_run(stored, directory, stored.state)
    else:
        _print_run(stored, f"{stored.name}: {stored.manifest.get('title', '')}", all_)
        for line in stored.code:
            typer.echo(line)
        typer.echo(f"{stored.state}; seed {stored.manifest['seed']}, {stored.manifest['fidelity']}, in {directory}")
    if figures:
        drawn = stored.draw(allow_imports or ())
        if not as_json:
            typer.echo(f"drawn: {drawn}")


def _echo_run(run: RunResult | StoredRun, directory: Path, state: str) -> None:
    content: dict[str, Any] = {"scenario": run.name, "directory": str(directory), "state": state}
    content["metrics"] = run.metrics
    content["findings"] = {name: [one.as_row() for one in found] for name, found in run.findings.items()}
    echo_json(content | {"expectations": {v.target: v.as_row() for v in run.verdicts}})


def _print_run(run: RunResult | StoredRun, title: str, all_: bool, remark: str = "") -> None:
    """Tables of metrics and expectations, a remark on the latter, and the findings."""
    from forcectl.runs.terminal.tables import metrics_table, short_list, verdict_table

    console, metrics, verdicts = terminal(), run.metrics, run.verdicts
    names = None if all_ else short_list(metrics, verdicts)
    if metrics:
        console.print(metrics_table(metrics, title, names, console.width))
        count = len({name for values in metrics.values() for name in values})
        if names is not None and len(names) < count:
            console.print(f"[dim]{len(names)} of {count} metrics; all of them with --all[/]")
    if verdicts:
        console.print()
        console.print(verdict_table(verdicts, "Expectations", console.width))
        if remark:
            console.print(f"[dim]{remark}[/]")
    typer.echo()
    typer.echo("\n".join(findings_lines(run.findings)))

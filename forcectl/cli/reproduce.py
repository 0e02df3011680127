"""The command `forcectl reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forcectl.cli import completion
from forcectl.cli.options import (
    AllowImports,
    AsJson,
    Fidelity,
    Force,
    Quiet,
    Seed,
    Settings,
    Variant,
    Workers,
    echo_json,
    terminal,
)
from forcectl.errors import BadInputError
from forcectl.interrupts import set_interrupt_message

if TYPE_CHECKING:
    from forcectl.runs.reproduce import Reproduction


def reproduce(
    experiments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ID]...", help="Experiments to run.", autocompletion=completion.experiments),
    ] = None,
    all_: Annotated[bool, typer.Option("--all", help="Every shipped experiment.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory to write; default runs/reproduce-<n>.")
    ] = None,
    check_: Annotated[
        bool,
        typer.Option(
            "--check", help="Exit with 1 on a miss that is no known gap, a gap that is met, or a drifted value."
        ),
    ] = False,
    variant: Variant = None,
    settings: Settings = None,
    seed: Seed = None,
    fidelity: Fidelity = None,
    workers: Workers = None,
    force: Force = False,
    allow_imports: AllowImports = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the one in --out: what has finished is not run again.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Every target, not only those that are missed.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run experiments of the thesis in parallel and compare with its numbers.

    Example: forcectl reproduce fig_2_7 fig_2_8 --check
    """
    from forcectl.runs.claims.claim import Numbered
    from forcectl.runs.terminal.progress import ProgressBars
    from forcectl.scenario.catalog import list_experiments

    if bool(experiments) == all_:
        raise BadInputError(f"reproduce: must have either names or --all, known: {', '.join(list_experiments())}")
    names = list_experiments() if all_ else list(dict.fromkeys(experiments or []))
    if resume and out is None:
        raise BadInputError("--resume: goes with --out, the directory of a reproduction that was stopped")
    with ProgressBars(quiet) as progress:
        progress.stage("starting")  # Drake takes seconds to import
        from forcectl.cli.target import parse_settings
        from forcectl.runs.reproduce import InterruptedReproductionError
        from forcectl.runs.reproduce import reproduce as compare

        try:
            progress.stage("simulating")
            report = compare(
                names,
                variant=variant,
                overrides=parse_settings(settings),
                seed=seed,
                out=out or Numbered(Path("runs"), "reproduce"),
                fidelity=fidelity,
                workers=workers,
                force=force,
                allow_imports=allow_imports or (),
                resume=resume,
                progress=progress.show,
            )
        except InterruptedReproductionError as interrupted:
            set_interrupt_message(str(interrupted))
            raise
    set_interrupt_message(f"interrupted: the results are in {report.directory}")
    if as_json:
        passed = {"directory": str(report.directory), "passed": report.passed, "notes": report.notes}
        echo_json(passed | {"experiments": report.summary()})
    elif not quiet:
        _print(report, verbose)
    if check_ and not report.passed:
        raise typer.Exit(1)


def _print(report: Reproduction, verbose: bool) -> None:
    """A line for each experiment, or with `verbose` a table, and a summary of all."""
    from forcectl.runs.terminal.tables import counts, reproduction_lines, verdict_table

    console = terminal()
    headed = [(f"{part.experiment}: {part.title} [{part.fidelity}]", part.verdicts) for part in report.parts]
    for heading, verdicts in headed if verbose else ():
        console.print(verdict_table(verdicts, heading, console.width))
        console.print()
    if not verbose:
        console.print(reproduction_lines(headed))
        console.print()
    every = [v for part in report.parts for v in part.verdicts]
    for note in report.notes:
        typer.echo(note)
    found, stale = counts(every), sum(v.stale for v in every)
    gaps = f", known gaps: {found.gaps}" if found.gaps else ""
    gaps += f", known gaps out of date: {stale}" if stale else ""
    typer.echo(
        f"{found.met} of {found.judged} targets met{gaps}, drifted: {found.drifted}; results in {report.directory}: "
        "report.html, summary.json and one run per folder"
    )

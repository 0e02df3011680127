"""The command `forcectl reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forcectl.cli import completion
from forcectl.cli.options import Fidelity, Force, Quiet, terminal
from forcectl.errors import BadInputError
from forcectl.interrupts import say_when_interrupted


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
    fidelity: Fidelity = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Processes; default one per processor.")
    ] = None,
    force: Force = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the one in --out: what has finished is not run again.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Every target, not only those that are missed.")
    ] = False,
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
        from forcectl.runs.reproduce import InterruptedReproductionError
        from forcectl.runs.reproduce import reproduce as compare
        from forcectl.runs.terminal.tables import reproduction_lines, verdict_table

        try:
            progress.stage("simulating")
            report = compare(
                names,
                out=out or Numbered(Path("runs"), "reproduce"),
                fidelity=fidelity,
                workers=workers,
                force=force,
                resume=resume,
                progress=progress.show,
            )
        except InterruptedReproductionError as interrupted:
            say_when_interrupted(str(interrupted))
            raise
    say_when_interrupted(f"interrupted: the results are in {report.directory}")
    console = terminal()
    headed = [(f"{part.experiment}: {part.title} [{part.fidelity}]", part.verdicts) for part in report.parts]
    for heading, verdicts in headed if verbose and not quiet else ():
        console.print(verdict_table(verdicts, heading, console.width))
        console.print()
    if not verbose and not quiet:
        console.print(reproduction_lines(headed))
        console.print()
    missed = sum(v.passed is False for part in report.parts for v in part.verdicts)
    known = sum(v.passed is False and bool(v.gap) for part in report.parts for v in part.verdicts)
    stale = sum(v.stale for part in report.parts for v in part.verdicts)
    judged = sum(v.passed is not None for part in report.parts for v in part.verdicts)
    drifted = sum(v.drifted is True for part in report.parts for v in part.verdicts)
    if not quiet:
        for note in report.notes:
            typer.echo(note)
        gaps = (f", known gaps: {known}" if known else "") + (f", known gaps out of date: {stale}" if stale else "")
        typer.echo(
            f"{judged - missed} of {judged} targets met{gaps}, drifted: {drifted}; results in {report.directory}: "
            "summary.json and one run per folder"
        )
    if check_ and not report.passed:
        raise typer.Exit(1)

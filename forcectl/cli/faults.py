"""The command `forcectl faults`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from forcectl.cli.options import (
    AllowImports,
    AsJson,
    Fidelity,
    Quiet,
    Seed,
    Settings,
    Target,
    Variant,
    Workers,
    echo_json,
    terminal,
)
from forcectl.interrupts import Interrupts, set_interrupt_message


def faults(
    scenario: Target,
    controllers: Annotated[
        str, typer.Option(metavar="A,B|all", help="Controllers in place of the scenario's; all: every one that fits.")
    ] = "",
    only: Annotated[str, typer.Option(metavar="A,B", help="These faults only; default all.")] = "all",
    begin: Annotated[
        float | None, typer.Option(metavar="S", help="When faults begin, in seconds; default half of the duration.")
    ] = None,
    variant: Variant = None,
    settings: Settings = None,
    seed: Seed = None,
    fidelity: Fidelity = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Keep logs, faults.md and faults.json there, to go on with; default: nothing."
        ),
    ] = None,
    workers: Workers = None,
    allow_imports: AllowImports = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a scenario once with each fault, and show its effect: force, command, status, finding.

    Exit code 1: a command was not a finite number, or a run failed.

    Example: forcectl faults fig_2_7 --fidelity OneDimensional --only "nan,frozen,contact lost" --set duration=2
    """
    from forcectl.cli.target import parse_settings
    from forcectl.runs.claims.lock import writing
    from forcectl.sweeps.faults.run_faults import try_faults
    from forcectl.sweeps.faults.tables import as_json as table_as_json
    from forcectl.sweeps.faults.tables import markdown, table

    if out is not None:
        set_interrupt_message(f"stopped; the same command goes on in {out}")
    with Interrupts() as interrupts:
        report = try_faults(
            scenario,
            controllers=controllers,
            faults=only,
            variant=variant,
            overrides=parse_settings(settings),
            seed=seed,
            fidelity=fidelity,
            begin=begin,
            out=out,
            workers=workers,
            allow_imports=allow_imports or (),
            progress=lambda progress: interrupts.check(),
        )
    if report.directory is not None:
        with writing(report.directory):
            (report.directory / "faults.md").write_text(markdown(report), encoding="utf-8")
            (report.directory / "faults.json").write_text(json.dumps(table_as_json(report), indent=1), encoding="utf-8")
    if as_json:
        echo_json(table_as_json(report))
    elif not quiet:
        console = terminal()
        console.print(table(report, console.width))
        for what, why in report.left_out.items():
            typer.echo(f"left out: {what}: {why}")
        if report.directory is not None:
            typer.echo(f"results in {report.directory}: faults.md, faults.json, trials.parquet, logs/")
    if any(row.failure or not row.finite for row in report.rows):
        raise typer.Exit(1)

"""The commands `forcectl graph` and `forcectl check`."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Annotated

import typer

from forcectl.cli.options import (
    AllowImports,
    AsJson,
    Diagrammed,
    Fidelity,
    Quiet,
    Settings,
    Variant,
    echo_json,
    terminal,
)
from forcectl.cli.robot import print_assumed
from forcectl.errors import BadInputError, unknown
from forcectl.interrupts import Interrupts


def graph(
    scenario: Diagrammed,
    format_: Annotated[
        str | None, typer.Option("--format", metavar="svg|html|dot|png|pdf|mermaid", help="Default: as --out, or svg.")
    ] = None,
    depth: Annotated[
        int, typer.Option(metavar="N", min=0, help="Levels of nesting to unfold; the HTML page starts there.")
    ] = 1,
    machine: Annotated[bool, typer.Option("--machine", help="The state machine of the controller instead.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write (replaced if it exists).")] = None,
    variant: Variant = None,
    settings: Settings = None,
    fidelity: Fidelity = None,
    allow_imports: AllowImports = None,
) -> None:
    """Draw the block diagram of a scenario, or of your own diagram, or a state machine.

    Example: forcectl graph fig_2_7 --format html --depth 2 --out loop.html
    """
    from forcectl.cli.target import named_diagram, named_machine
    from forcectl.graph import export

    if out is not None and not out.name:
        raise BadInputError(f"--out {str(out)!r} is a folder: must be a file")
    chosen = export.format_of(out) if out is not None and out.suffix else "svg"
    chosen = chosen if format_ is None else format_
    if chosen not in export.FORMATS:
        raise unknown("format", chosen, export.FORMATS)
    ending = out.suffix.lower()[1:] if out is not None else chosen
    if ending in export.FORMATS and ending != chosen:
        raise BadInputError(f"--format {chosen}: must be that of --out {str(out)!r}, or be left out")
    shown = (named_machine if machine else named_diagram)(scenario, variant, settings, fidelity, allow_imports)
    target = out or Path(f"{shown.name}.{'mmd' if chosen == 'mermaid' else chosen}")
    device = os.path.exists(target) and not os.path.isfile(target)  # written to, never replaced by a file
    partial = target if device else target.with_name(f".partial-{target.name}")
    with Interrupts():
        try:
            title = ", ".join(filter(None, (shown.name, variant)))
            export.graph(shown.content, depth=depth, title=title).save(partial, chosen)
            if not device:
                partial.replace(target)
        except OSError as error:
            raise BadInputError(f"--out {str(target)!r} cannot be written: {error.strerror}") from None
        finally:
            if not device:
                with contextlib.suppress(OSError):
                    partial.unlink(missing_ok=True)
    for line in shown.code:
        typer.echo(line)
    typer.echo(f"wrote {target}")


def check(
    scenario: Diagrammed,
    variant: Variant = None,
    settings: Settings = None,
    fidelity: Fidelity = None,
    allow_imports: AllowImports = None,
    source: Annotated[
        str | None, typer.Option("--from", metavar="PORT", help="Delays from here, such as station.contact_force ...")
    ] = None,
    target: Annotated[
        str | None, typer.Option("--to", metavar="PORT", help="... to here, and back; default once around the loop.")
    ] = None,
    scheme: Annotated[str | None, typer.Option(metavar="NAME", help="Integration scheme, such as cenic.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Also remarks and the feedthrough table.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Examine a diagram: wiring, feedthrough, algebraic loops, periods, delays; stability margins of a scenario.

    Without --variant the first one is examined, and the others are built.

    Example: forcectl check fig_2_7 --from station.measured_force --to station.joint_position_command
    """
    from forcectl.cli.target import info_lines, named_diagram, start_lines
    from forcectl.doctor import examine, render
    from forcectl.runs.entry import margins_of
    from forcectl.runs.run import assumed_of
    from forcectl.scenario.catalog import passed_over

    shown = named_diagram(scenario, variant, settings, fidelity, allow_imports, whole=True)
    report = examine(shown.content, sensor=source, command=target, scheme=scheme)
    margins = margins_of(shown.chosen) if shown.chosen and (as_json or not quiet) else []
    starts = shown.loop.task_starts() if shown.loop and (as_json or not quiet) else {}
    if as_json:
        numbers = {name: value for name, (value, _) in starts.items()}
        echo_json(report.to_dict() | {"margins": [each.to_dict() for each in margins], "task_starts": numbers})
    elif not quiet:
        render(report, terminal(), verbose=verbose)
        for line in (*margins, *start_lines(starts), *shown.code, *info_lines(shown)):
            typer.echo(line)
        if shown.chosen:
            print_assumed(assumed_of(shown.chosen.first))
        for line in passed_over():
            typer.echo(line, err=True)
    if not report.ok:
        raise typer.Exit(1)

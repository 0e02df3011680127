"""The command `forcectl robot`."""

from __future__ import annotations

from typing import Annotated

import typer

from forcectl.cli.options import terminal


def robot(
    folder: Annotated[str, typer.Argument(metavar="FOLDER", help="Robot folder, model file, or shipped robot.")],
) -> None:
    """Show what a robot folder defines, what is assumed, and all that is missing with proposed values.

    Exit code 0: complete; 1: something is missing or cannot be used.

    Example: forcectl robot comau_smart_six
    """
    from forcectl.runs.robots.report import examine_robot
    from forcectl.runs.robots.tables import print_robot

    report = examine_robot(folder)
    print_robot(report, terminal())
    if not report.complete:
        raise typer.Exit(1)


def print_assumed(assumed: dict[str, str]) -> None:
    """Print the parameters that are assumed for the robot of a scenario: key -> rule."""
    if assumed:
        parameters = ", ".join(f"{name} ({rule})" for name, rule in assumed.items())
        typer.echo(f"assumed of the robot: {parameters}; `forcectl robot` shows the values")

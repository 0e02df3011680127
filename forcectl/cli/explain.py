"""The command `forcectl explain`."""

from __future__ import annotations

from typing import Annotated

import typer


def explain(
    name: Annotated[
        str | None, typer.Argument(metavar="[METRIC]", help="A metric or a kind of findings; left out: all, as a page.")
    ] = None,
) -> None:
    """Show what a metric or a kind of findings is: unit, formula and sign, or severity.

    Example: forcectl explain overshoot_pct
    """
    from forcectl.analysis.tables.reference import explanation, page

    typer.echo(page() if name is None else explanation(name), nl=name is not None)

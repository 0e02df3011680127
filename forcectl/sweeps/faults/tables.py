"""The table of faults: for the terminal, as Markdown, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.markup import escape
from rich.table import Table

from forcectl.runs.terminal.listing import new_table
from forcectl.sweeps.faults.response import Response
from forcectl.sweeps.faults.run_faults import FaultReport

COLUMNS = ("controller", "fault", "peak force [N]", "command step", "safe after [s]", "status", "named by")
_NARROW = 110  # [characters] width of a terminal below which not all columns fit


def cells(row: Response) -> list[str]:
    """A row as text; words stand in place of missing numbers."""
    nothing = "stopped" if row.failure else "no force"
    peak = nothing if row.peak_force is None else f"{row.peak_force:.1f}"
    safe = nothing if row.peak_force is None else "never" if row.safe_time is None else f"{row.safe_time:.2f}"
    step = "no command" if row.command_step is None else f"{row.command_step:.2g} {row.step_unit}"
    status = "no guard" if row.status is None else str(row.status)
    named = row.failure or ", ".join(row.named_by) or "nothing"
    return [row.controller, row.fault, peak, step if row.finite else "not finite", safe, status, named]


def table(report: FaultReport, width: int) -> Table:
    """The table for a terminal: a column for each number, or where it is narrow a line of text for each fault.

    Args:
        report: of all runs.
        width: of the terminal [characters].
    """
    title = escape(f"{report.scenario}: {report.variant} [{report.fidelity}], from {report.begin:g} s")
    if width < _NARROW:
        lines = new_table(title, "fault")
        lines.add_column("outcome", overflow="fold")
        for row in report.rows:
            controller, fault, *numbers = map(escape, cells(row))
            lines.add_row(f"{controller}:\n  {fault}", in_words(numbers))
        return lines
    table = new_table(title, *map(escape, COLUMNS))
    for column in table.columns[:-1]:
        column.no_wrap = True
    for row in report.rows:
        table.add_row(*map(escape, cells(row)))
    return table


def in_words(numbers: Sequence[str]) -> str:
    """The cells of a row behind its name, as a text of two lines."""
    peak, step, safe, status, named = numbers
    force = peak if peak[0].isalpha() else f"{peak} N"
    after = safe if safe[0].isalpha() else f"after {safe} s"
    return f"peak force {force}, command step {step},\nsafe {after}, status {status}, named by {named}"


def markdown(report: FaultReport) -> str:
    """The table in Markdown, with a heading and the runs that were left out."""
    head = f"`{report.scenario}`, {report.variant}, {report.fidelity}, faults from {report.begin:g} s on:"
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(cells(row))} |" for row in report.rows]
    left = [f"- {what}: {why}" for what, why in report.left_out.items()]
    return "\n".join([head, "", *lines, *(["", "Left out:", "", *left] if left else []), ""])


def as_json(report: FaultReport) -> dict[str, Any]:
    """The table as strict JSON can hold it."""
    return {
        "scenario": report.scenario,
        "variant": report.variant,
        "fidelity": report.fidelity,
        "begin_s": report.begin,
        "rows": [asdict(row) for row in report.rows],
        "left_out": report.left_out,
        "directory": None if report.directory is None else str(report.directory),
    }

"""The table of faults: for the terminal, as Markdown, and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from forcectl.sweeps.faults.response import Response
from forcectl.sweeps.faults.run_faults import FaultReport

COLUMNS = ("controller", "fault", "peak force [N]", "command step", "safe after [s]", "status", "named by")


def cells(row: Response) -> list[str]:
    """A row as text."""
    step = "-" if row.command_step is None else f"{row.command_step:.2g} {row.step_unit}"
    safe = "never" if row.safe_time is None and row.peak_force is not None else _number(row.safe_time, ".2f")
    named = row.failure or ", ".join(row.named_by) or "-"
    step = step if row.finite else "not finite"
    status = "-" if row.status is None else str(row.status)
    return [row.controller, row.fault, _number(row.peak_force, ".1f"), step, safe, status, named]


def markdown(report: FaultReport) -> str:
    """The table, with a heading and what was left out."""
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


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)

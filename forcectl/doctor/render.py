"""A report as tables in the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape  # square brackets are units here, not markup
from rich.table import Table

from forcectl.doctor.report import SEVERITIES, Report
from forcectl.inspect.delay import DelayChain
from forcectl.inspect.events import PeriodicEvent

_STYLE = {"error": "bold red", "warning": "yellow", "info": "dim"}


def render(report: Report, console: Console, *, verbose: bool = False) -> None:
    """Print a report: findings, sample periods, delays; with `verbose` also infos and the feedthrough table."""
    shown = SEVERITIES if verbose else SEVERITIES[:2]
    findings = [f for f in report.findings if f.severity in shown]
    if findings:
        table = _table("Findings", "severity", "code", "where", "what")
        for finding in findings:
            severity = f"[{_STYLE[finding.severity]}]{finding.severity}[/]"
            table.add_row(severity, *map(escape, (finding.code, finding.path, finding.message)))
        console.print(table)
    if report.events:
        console.print(_events(report.events))
    for chain in report.delays:
        console.print(_delays(chain))
    if report.dead_time is not None:
        parts = " + ".join(f"{chain.total:g}" for chain in report.delays)
        console.print(f"Dead time once around the loop: {parts} = {report.dead_time:g} s")
    if verbose and report.feedthrough:
        table = _table("Direct feedthrough", "block", "output", "<- inputs")
        for row in report.feedthrough:
            table.add_row(*map(escape, (row.block, row.output, ", ".join(row.inputs) or "-")))
        console.print(table)
    counts = ", ".join(f"{len(report.of_severity(s))} {s}" for s in SEVERITIES)
    style = "red" if not report.ok else "yellow" if report.warnings else "green"
    console.print(f"[{style}]{escape(report.name or 'diagram')}: {counts}[/]")


def _events(events: tuple[PeriodicEvent, ...]) -> Table:
    """One row per timing; blocks of the same timing stand together."""
    groups: dict[tuple[float, float, str], list[str]] = {}
    for event in events:
        groups.setdefault((event.period, event.offset, event.kind), []).append(event.block)
    table = _table("Sample periods", "period [s]", "offset [s]", "kind", "blocks")
    for (period, offset, kind), blocks in sorted(groups.items()):
        table.add_row(f"{period:g}", f"{offset:g}", kind, escape(", ".join(blocks)))
    return table


def _delays(chain: DelayChain) -> Table:
    table = _table(f"Delay {escape(chain.source)} -> {escape(chain.target)}", "block", "way", "kind", "samples",
                   "delay [s]", "known from")  # fmt: skip
    for row in chain.rows:
        samples = str(row.samples) if row.samples else ""
        way = escape(f"{row.input} -> {row.output}")
        table.add_row(escape(row.block), way, row.kind, samples, f"{row.delay:g}", row.basis)
    reader = f"read by {chain.reader}" if chain.reader else ""
    worst = f" (up to {chain.worst:g})" if chain.worst > chain.total else ""
    table.add_section()
    table.add_row("total", escape(reader), "", "", f"{chain.total:g}{worst}", "")
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(escape(column), overflow="fold")  # paths are never cut
    return table

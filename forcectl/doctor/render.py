"""A report as tables in the terminal."""

from __future__ import annotations

import io
import re

from rich.console import Console
from rich.markup import escape  # square brackets are units here, not markup
from rich.table import Table

from forcectl.doctor.report import SEVERITIES, Report
from forcectl.inspect.delay import DelayChain
from forcectl.inspect.events import PeriodicEvent

_NARROW, _FOLDED = 120, 26  # [characters] of a narrow terminal, and of a line of a path there
_STYLE = {"error": "bold red", "warning": "yellow", "info": "dim"}


def render(report: Report, console: Console, *, verbose: bool = False) -> None:
    """Print a report: findings, sample periods, delays; with `verbose` also infos and the feedthrough table."""
    narrow = console.width < _NARROW
    shown = SEVERITIES if verbose else SEVERITIES[:2]
    findings = [f for f in report.findings if f.severity in shown]
    if findings:
        table = _table("Findings", "severity", "code", "where", "what")
        for finding in findings:
            severity = f"[{_STYLE[finding.severity]}]{finding.severity}[/]"
            table.add_row(severity, escape(finding.code), _path(finding.path, narrow), escape(finding.message))
        console.print(table)
    if report.events:
        console.print(_events(report.events, narrow))
    for chain in report.delays:
        console.print(_delays(chain, narrow))
    if report.dead_time is not None:
        parts = " + ".join(f"{chain.total:g}" for chain in report.delays)
        console.print(f"Dead time once around the loop: {parts} = {report.dead_time:g} s")
    if verbose and report.feedthrough:
        table = _table("Direct feedthrough", "block", "output", "<- inputs")
        for row in report.feedthrough:
            table.add_row(_path(row.block, narrow), escape(row.output), escape(", ".join(row.inputs) or "nothing"))
        console.print(table)
    style = "red" if not report.ok else "yellow" if report.warnings else "green"
    console.print(f"[{style}]{escape(report.name or 'diagram')}: {report.counts}[/]")


def as_html(report: Report) -> str:
    """A report as HTML, for a notebook."""
    console = Console(record=True, file=io.StringIO(), width=_NARROW)
    render(report, console)
    return console.export_html(inline_styles=True, code_format="<pre style='line-height:1.3'>{code}</pre>")


def _events(events: tuple[PeriodicEvent, ...], narrow: bool) -> Table:
    """One row per timing; blocks of the same timing stand together."""
    groups: dict[tuple[float, float, str], list[str]] = {}
    for event in events:
        groups.setdefault((event.period, event.offset, event.kind), []).append(event.block)
    table = _table("Sample periods", "period [s]", "offset [s]", "kind", "blocks")
    for (period, offset, kind), blocks in sorted(groups.items()):
        table.add_row(
            f"{period:g}",
            f"{offset:g}",
            kind,
            "\n".join(_path(block, narrow) for block in blocks) if narrow else escape(", ".join(blocks)),
        )
    return table


def _delays(chain: DelayChain, narrow: bool) -> Table:
    table = _table(f"Delay {escape(chain.source)} -> {escape(chain.target)}", "block", "way", "kind", "samples",
                   "delay [s]", "known from")  # fmt: skip
    for row in chain.rows:
        samples = str(row.samples) if row.samples else ""
        way = escape(f"{row.input} -> {row.output}")
        table.add_row(_path(row.block, narrow), way, row.kind, samples, f"{row.delay:g}", row.basis)
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


def _path(text: str, narrow: bool) -> str:
    """A path with markup escaped; in a narrow terminal a long one is broken after slashes and before dots."""
    lines = [""]
    for part in re.split(r"(?<=/)|(?=\.)", text):
        if narrow and lines[-1] and len(lines[-1]) + len(part) > _FOLDED:
            lines.append("")
        lines[-1] += part
    return escape("\n".join(lines))

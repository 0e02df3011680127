"""A report as tables in the terminal."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

from rich.console import Console, ConsoleOptions
from rich.markup import escape  # square brackets are units here, not markup
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from forcectl.doctor.report import SEVERITIES, Report
from forcectl.inspect.delay import DelayChain
from forcectl.inspect.events import PeriodicEvent

_NARROW = 120  # [characters] terminals narrower than this do not fit all columns of a delay table
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
            table.add_row(severity, escape(finding.code), Folded(finding.path), Folded(finding.message))
        console.print(table)
    if report.events:
        console.print(_events(report.events, narrow))
    for chain in report.delays:
        console.print(_delay_lines(chain) if narrow else _delays(chain))
    if report.dead_time is not None:
        parts = " + ".join(f"{chain.total:g}" for chain in report.delays)
        console.print(f"Dead time once around the loop: {parts} = {report.dead_time:g} s")
    if verbose and report.feedthrough:
        table = _table("Direct feedthrough", "block", "output", "<- inputs")
        for row in report.feedthrough:
            table.add_row(Folded(row.block), Folded(row.output), Folded(", ".join(row.inputs) or "nothing"))
        console.print(table)
    style = "red" if not report.ok else "yellow" if report.warnings else "green"
    console.print(f"[{style}]{escape(report.name or 'diagram')}: {report.counts}[/]")


def as_html(report: Report) -> str:
    """A report as HTML, for a notebook."""
    console = Console(record=True, file=io.StringIO(), width=_NARROW, force_jupyter=False)
    render(report, console)
    return console.export_html(inline_styles=True, code_format="<pre style='line-height:1.3'>{code}</pre>")


def _events(events: tuple[PeriodicEvent, ...], narrow: bool) -> Table:
    """One row per period, offset and kind, with all blocks that have these."""
    groups: dict[tuple[float, float, str], list[str]] = {}
    for event in events:
        groups.setdefault((event.period, event.offset, event.kind), []).append(event.block)
    table = _table("Sample periods", "period [s]", "offset [s]", "kind", "blocks")
    for (period, offset, kind), blocks in sorted(groups.items()):
        table.add_row(f"{period:g}", f"{offset:g}", kind, Folded(("\n" if narrow else ", ").join(blocks)))
    return table


def _delays(chain: DelayChain) -> Table:
    table = _table(_delay_title(chain), "block", "way", "kind", "samples", "delay [s]", "known from")
    for row in chain.rows:
        samples = str(row.samples) if row.samples else ""
        way = Folded(f"{row.input} -> {row.output}")
        table.add_row(Folded(row.block), way, row.kind, samples, f"{row.delay:g}", row.basis)
    table.add_section()
    table.add_row("total", Folded(_reader(chain)), "", "", _total(chain), "")
    return table


def _delay_lines(chain: DelayChain) -> Table:
    """The delay table for a narrow terminal: each block on a line, with its details below."""
    table = _table(_delay_title(chain), "delay [s]", "block")
    for row in chain.rows:
        samples = f", {row.samples} sample{'s' * (row.samples != 1)}" if row.samples else ""
        what = f"  {row.input} -> {row.output}: {row.kind}{samples}, {row.basis}"
        table.add_row(f"{row.delay:g}", Folded(f"{row.block}\n{what}"))
    table.add_section()
    table.add_row(_total(chain), Folded(", ".join(filter(None, ["total", _reader(chain)]))))
    return table


def _delay_title(chain: DelayChain) -> str:
    return f"Delay {escape(chain.source)} -> {escape(chain.target)}"


def _reader(chain: DelayChain) -> str:
    return f"read by {chain.reader}" if chain.reader else ""


def _total(chain: DelayChain) -> str:
    return f"{chain.total:g}{f' (up to {chain.worst:g})' if chain.worst > chain.total else ''}"


_TEXTS = ("block", "blocks", "way", "where", "what", "output", "<- inputs")  # columns that are folded


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(escape(column), no_wrap=column not in _TEXTS, overflow="fold")
    return table


class Folded:
    """Text that is wrapped at spaces; a word that is too long is broken after a slash, or else after an underscore.

    Args:
        text: plain text without markup.
    """

    def __init__(self, text: str):
        self._text = text

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        lines = self._text.split("\n")
        least = max(len(part.strip()) for part in re.split(r"(?<=[\s/_])", self._text))
        return Measurement(least, max(map(len, lines))).with_maximum(options.max_width)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        folded = [part for line in self._text.split("\n") for part in fold(line, options.max_width)]
        yield Text("\n".join(folded), overflow="fold")


def fold(text: str, width: int) -> list[str]:
    """A line in pieces of at most `width` characters; a word without a slash or an underscore is not broken."""
    return [line.rstrip() for line in _pieces(text, width, " /_") if line.strip()] or [""]


def _pieces(text: str, width: int, marks: str) -> list[str]:
    """A text in pieces of `width`, broken after the first mark, and long pieces after the next marks."""
    lines = [""]
    for piece in re.split(f"(?<={marks[0]})", text):
        if len(lines[-1]) + len(piece.rstrip()) <= width:
            lines[-1] += piece
            continue
        longer = len(piece.rstrip()) > width and len(marks) > 1
        lines += _pieces(piece, width, marks[1:]) if longer else [piece]
    return lines

"""Results as tables in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.markup import escape
from rich.table import Table

from forcectl.analysis.force_metrics import METRICS, metric_unit
from forcectl.runs.listing import new_table
from forcectl.scenario.expectations import Verdict


def metrics_table(metrics: Mapping[str, Mapping[str, float | None]], title: str = "") -> Table:
    """Metrics as rows, variants as columns; below, a line for each variant that did not reach its last targets."""
    table = new_table(escape(title), "metric", "unit")
    for variant in metrics:
        table.add_column(escape(variant), justify="right")
    names = list(dict.fromkeys([*METRICS, *(name for values in metrics.values() for name in values)]))
    for name in names:
        values = [one.get(name) for one in metrics.values()]
        if any(v is not None for v in values):
            table.add_row(name, metric_unit(name), *map(number, values))
    if missed := _unreached(metrics):
        table.caption, table.caption_style, table.caption_justify = escape("\n".join(missed)), "yellow", "left"
    return table


def _unreached(metrics: Mapping[str, Mapping[str, float | None]]) -> list[str]:
    lines = []
    for variant, values in metrics.items():
        missed = {
            name.removesuffix(".reached") for name, value in values.items() if name.endswith(".reached") and not value
        }
        if missed:
            said = [f"{arm} ({'stalled' if values[f'{arm}.stalled'] else 'still moving'})" for arm in sorted(missed)]
            lines.append(f"{variant}: last target not reached: {', '.join(said)}")
    return lines


def verdict_table(verdicts: Sequence[Verdict], title: str = "") -> Table:
    """Targets with the published value, ours, the deviation, what is allowed, the verdict and the drift."""
    table = new_table(escape(title), "target", "published")
    for column in ("ours", "deviation"):
        table.add_column(column, justify="right")
    for column in ("allowed", "verdict", "drift"):
        table.add_column(column)
    for v in verdicts:
        published = v.published if isinstance(v.published, str) else number(v.published)
        note = f"\n[dim]{escape(v.note)}[/]" if v.note else ""
        table.add_row(
            escape(v.target) + note,
            escape(published),
            number(v.ours),
            number(v.deviation),
            v.tolerance,
            verdict(v),
            drift(v),
        )
    return table


def verdict(v: Verdict) -> str:
    """The verdict as a coloured word."""
    return {True: "[green]pass[/]", False: "[bold red]missed[/]", None: "[dim]reported[/]"}[v.passed]


def drift(v: Verdict) -> str:
    """From which number ours has drifted away; "none" when it has not, nothing without such a number."""
    return {True: f"[bold red]from {number(v.expected)}[/]", False: "[green]none[/]", None: ""}[v.drifted]


def number(value: float | None) -> str:
    """Four significant digits; a dash for what is undefined."""
    return "–" if value is None else f"{value:.4g}"

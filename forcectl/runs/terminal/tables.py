"""Results as tables that fit the width of the terminal without cutting a number."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from forcectl.analysis.tables.metric_tables import metric_unit
from forcectl.runs.terminal.listing import new_table
from forcectl.scenario.expectations import Verdict

Metrics = Mapping[str, Mapping[str, float | None]]  # variant -> metric -> value

# Metrics that are shown by default, in addition to those of the expectations, if a run has them.
SHORT = (
    "overshoot_pct",
    "time_to_90pct_s",
    "settling_time_2pct_s",
    "steady_state_error_N",
    "peak_force_N",
    "contact_loss_s",
    "tracking_error_rad",
    "peak_contact_force_N",
    "reach_offset_mm",
    "reached",
    "time_reached_s",
    "ended",
)
# Words for a metric that is not defined, by a part of its name.
_UNDEFINED = {
    "settling": "not settled",
    "recovery": "not recovered",
    "time_to": "not reached",
    "rise_time": "not reached",
    "time_reached": "not reached",
    "lag_behind": "not reached",
}
_NARROW, _NUMBER, _GAP = 96, 13, 2  # [characters]: a narrow terminal, the widest number or word, between columns


def metrics_table(metrics: Metrics, title: str = "", names: Iterable[str] | None = None, width: int = 80) -> Table:
    """Metrics as rows, variants as columns; as many variants side by side as there is room for, others below.

    Args:
        metrics: variant -> metric -> value.
        title: heading.
        names: of the metrics, see `short_list`; None: all.
        width: of the terminal [characters].
    """
    every = list(dict.fromkeys(name for values in metrics.values() for name in values))
    rows = [
        name
        for name in (every if names is None else names)
        if any(values.get(name) is not None for values in metrics.values()) or (names is not None and name in every)
    ]
    first = max(map(len, ["metric", *rows]))
    unit = max(map(len, ["unit", *map(metric_unit, rows)]))
    left = width - first - unit - _GAP
    room = max(1, left // (_NUMBER + _GAP))
    share = left // max(1, min(room, len(metrics))) - _GAP
    whole = Table.grid(padding=(0, 0, 1, 0))
    whole.title, whole.title_justify, whole.title_style = escape(title) or None, "left", "bold"
    every_variant = list(metrics)
    for k in range(0, len(metrics), room):
        variants = every_variant[k : k + room]
        each = max(_NUMBER, min(share, max(map(len, variants))))
        table = new_table("", "metric", "unit")
        table.columns[1].no_wrap = True
        for variant in variants:
            table.add_column(escape(variant), justify="right", width=each, overflow="fold")
        for name in rows:
            values = [number(metrics[variant].get(name), undefined(name)) for variant in variants]
            table.add_row(escape(name), escape(metric_unit(name)), *values)
        whole.add_row(table)
    if missed := _unreached(metrics):
        whole.caption, whole.caption_style, whole.caption_justify = escape("\n".join(missed)), "yellow", "left"
    return whole


def short_list(metrics: Metrics, verdicts: Iterable[Verdict]) -> list[str]:
    """The metrics that are shown by default: those that verdicts are on, and those of `SHORT`."""
    expected = [name for v in verdicts for name in v.metrics]
    there = dict.fromkeys(name for values in metrics.values() for name in values)
    defined = {name for values in metrics.values() for name, value in values.items() if value is not None}
    # For a step the settling time is shown even where it is not defined.
    stepped = (name.removesuffix("overshoot_pct") for name in defined if name.endswith("overshoot_pct"))
    defined |= {f"{of}settling_time_2pct_s" for of in stepped}
    shown = [name for name in SHORT if name in defined]
    if not shown:  # those of several surfaces have a prefix
        shown = [name for name in there if name in defined and name.partition(".")[2] in SHORT]
    return [name for name in dict.fromkeys([*expected, *shown]) if name in there]


def _unreached(metrics: Metrics) -> list[str]:
    lines = []
    for variant, values in metrics.items():
        missed = {
            name.removesuffix(".reached") for name, value in values.items() if name.endswith(".reached") and not value
        }
        if missed:
            how = {arm: values[key] for arm in missed if (key := f"{arm}.stalled") in values}
            words = {arm: " (stalled)" if stalled else " (still moving)" for arm, stalled in how.items()}
            arms = [f"{arm}{words.get(arm, '')}" for arm in sorted(missed)]
            lines.append(f"{variant}: last target not reached: {', '.join(arms)}")
    return lines


class Counts(NamedTuple):
    """Numbers of targets that are judged, met, missed as known gaps, missed otherwise, and have drifted."""

    judged: int
    met: int
    gaps: int
    missed: int
    drifted: int


def counts(verdicts: Iterable[Verdict]) -> Counts:
    """The counts of some verdicts."""
    every = list(verdicts)
    judged, met = (sum(v.passed in which for v in every) for which in ((True, False), (True,)))
    missed = sum(v.surprising for v in every)
    return Counts(judged, met, judged - met - missed, missed, sum(bool(v.drifted) for v in every))


def verdict_table(verdicts: Sequence[Verdict], title: str = "", width: int = 80) -> Table:
    """Targets with verdict, our number, tolerance and published value: as columns, or in a narrow terminal as text.

    Args:
        verdicts: one for each target.
        title: heading.
        width: of the terminal [characters].
    """
    if width < _NARROW:
        lines = new_table(escape(title), "verdict")
        lines.add_column("target: ours (allowed; published)", overflow="fold")
        for v in verdicts:
            lines.add_row(verdict(v), Text(in_words(v)))
        return lines
    table = new_table(escape(title), "target", "published")
    table.columns[0].min_width, table.columns[1].min_width = 20, 14
    for column, least in (("ours", _NUMBER), ("deviation", 10)):
        table.add_column(column, justify="right", min_width=least)
    table.add_column("unit", min_width=max((len(v.unit) for v in verdicts), default=0))
    for column, least in (("allowed", 12), ("verdict", 8), ("drift", 10)):
        table.add_column(column, min_width=least)
    for v in verdicts:
        words = remarks(v, "\n")
        note = f"\n[dim]{escape(words)}[/]" if words else ""
        deviation = "" if v.deviation is None else number(v.deviation)
        cells = (published(v), number(v.ours), deviation, v.unit, v.tolerance)
        table.add_row(escape(v.target) + note, *map(escape, cells), verdict(v), drift(v))
    return table


def in_words(v: Verdict) -> str:
    """Target, our number, tolerance, published value and drift, as one line of text."""
    parts = [part for part in (v.tolerance, f"published: {published(v)}") if part]
    if v.drifted:
        parts.append(f"drifted from {number(v.expected)}")
    ours = f"{number(v.ours)} {v.unit}".rstrip() if v.ours is not None else number(None)
    words = remarks(v, "; ")
    return f"{v.target}: {ours} ({'; '.join(parts)}){f': {words}' if words else ''}"


def remarks(v: Verdict, between: str) -> str:
    """Remarks on a verdict: its note, and the reason of its known gap, or that the gap is out of date."""
    begin = "met, so that its known gap is out of date" if v.stale else "met at its bound" if v.passed else "known gap"
    gap = f"{begin}: {v.gap}" if v.gap and v.passed is not None else ""
    return between.join(filter(None, (v.note, gap)))


def reproduction_lines(parts: Iterable[tuple[str, Sequence[Verdict]]]) -> Table:
    """A line for each experiment, and below it its missed or drifted targets, and gaps that are met.

    Args:
        parts: heading and verdicts of each.
    """
    lines = new_table("", "targets met", "experiment")
    for heading, verdicts in parts:
        found = counts(verdicts)
        colour = "bold red" if found.missed else "yellow" if found.gaps else "green"
        lines.add_row(f"[{colour}]{found.met} of {found.judged}[/]", escape(heading))
        for v in verdicts:
            if v.passed is False or v.gap or v.drifted:
                lines.add_row(f"  {verdict(v)}", Text(in_words(v)))
    return lines


def as_html(tables: Iterable[Table], width: int) -> str:
    """Tables as HTML for a notebook, `width` characters wide."""
    console = Console(record=True, file=io.StringIO(), width=width, force_jupyter=False)
    for table in tables:
        console.print(table)
    return console.export_html(inline_styles=True, code_format="<pre style='line-height:1.3'>{code}</pre>")


def published(v: Verdict) -> str:
    """The published value of a target: a statement or a number."""
    return v.published if isinstance(v.published, str) else number(v.published, "nothing")


def verdict(v: Verdict) -> str:
    """The verdict as a coloured word."""
    missed = "[yellow]missed[/]" if v.gap else "[bold red]missed[/]"
    return {True: "[green]pass[/]", False: missed, None: "[dim]reported[/]"}[v.passed]


def drift(v: Verdict) -> str:
    """The expected number that ours has drifted from; "none" if it has not, "" without an expected number."""
    return {True: f"[bold red]from {number(v.expected)}[/]", False: "[green]none[/]", None: ""}[v.drifted]


def undefined(metric: str) -> str:
    """The words for a metric that is not defined, such as the settling time of a force that has not settled."""
    return next((words for part, words in _UNDEFINED.items() if part in metric), "not defined")


def number(value: float | None, otherwise: str = "not defined") -> str:
    """Four significant digits, or other words."""
    return otherwise if value is None else f"{value:.4g}"

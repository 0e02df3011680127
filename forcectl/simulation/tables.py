"""Results as tables in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.markup import escape
from rich.table import Table

from forcectl.simulation import catalog
from forcectl.simulation.expectations import Verdict
from forcectl.simulation.metrics import RUN_METRICS, STEP_METRICS, metric_unit


def metrics_table(metrics: Mapping[str, Mapping[str, float | None]], title: str = "") -> Table:
    """Metrics as rows, variants as columns."""
    table = _table(escape(title), "metric", "unit")
    for variant in metrics:
        table.add_column(escape(variant), justify="right")
    known = STEP_METRICS | RUN_METRICS
    names = list(dict.fromkeys([*known, *(name for values in metrics.values() for name in values)]))
    for name in names:
        values = [one.get(name) for one in metrics.values()]
        if any(v is not None for v in values):
            table.add_row(name, metric_unit(name), *map(number, values))
    return table


def verdict_table(verdicts: Sequence[Verdict], title: str = "") -> Table:
    """Targets with the published value, ours, the deviation, what is allowed and the verdict."""
    table = _table(escape(title), "target", "published")
    for column in ("ours", "deviation"):
        table.add_column(column, justify="right")
    for column in ("allowed", "verdict"):
        table.add_column(column)
    for v in verdicts:
        published = v.published if isinstance(v.published, str) else number(v.published)
        note = f"\n[dim]{escape(v.note)}[/]" if v.note else ""
        table.add_row(
            escape(v.target) + note, escape(published), number(v.ours), number(v.deviation), v.tolerance, verdict(v)
        )
    return table


def verdict(v: Verdict) -> str:
    """The verdict as a coloured word."""
    return {True: "[green]pass[/]", False: "[bold red]missed[/]", None: "[dim]reported[/]"}[v.passed]


def number(value: float | None) -> str:
    """Four significant digits; a dash for what is undefined."""
    return "–" if value is None else f"{value:.4g}"


def catalog_tables() -> list[Table]:
    """Everything there is to choose from."""
    scenarios = _table("Experiments", "name", "title", "source")
    for name in catalog.list_experiments():
        tree = catalog.find_scenario(name).tree
        scenarios.add_row(name, escape(str(tree.get("title", ""))), escape(str(tree.get("source", ""))))
    presets = _table("Plant presets", "preset", "what it changes")
    for name in catalog.list_presets():
        presets.add_row(name, escape(str(catalog.find_preset(name).tree.get("description", ""))))
    parts = _table("Stations, controllers and references", "key", "choices")
    parts.add_row("station.fidelity", ", ".join(catalog.FIDELITIES))
    for key, names in catalog.list_models().items():
        parts.add_row(key, ", ".join(names))
    parts.add_row("controller", ", ".join(f"!{tag}" for tag in catalog.CONTROLLERS))
    parts.add_row("reference", ", ".join(f"!{tag}" for tag in catalog.REFERENCES))
    blocks = _table("Blocks", "block", "what it is")
    for name, text in catalog.list_blocks().items():
        blocks.add_row(name, escape(text))
    return [scenarios, presets, parts, blocks]


def _table(title: str, *columns: str) -> Table:
    table = Table(
        title=title or None, title_justify="left", title_style="bold", header_style="bold", box=None, pad_edge=False
    )
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0 and column != "target")
    return table

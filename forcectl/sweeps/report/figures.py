"""The figures of a sweep, from its table and its recorded signals."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from forcectl.analysis.tables.metric_tables import metric_unit
from forcectl.arrays import Array
from forcectl.conventions import unit_of
from forcectl.figures.force import COLOURS, write_svg
from forcectl.sweeps.report.envelope import Envelope, envelope_figure, read_envelope
from forcectl.sweeps.report.numbers import (
    KeyColumn,
    Sensitivity,
    arm_column,
    by_influence,
    groups,
    key_columns,
    outcome,
    rates,
    sensitivity,
    share_over,
    shown_metrics,
)
from forcectl.sweeps.report.panels import (
    FEW_ARMS,
    GREY,
    MOST_PANELS,
    PER_ROW,
    Drawn,
    below,
    beside,
    cut,
    heading,
    over_keys,
    panel_width,
    panels,
    styles,
    title,
)
from forcectl.sweeps.report.success import by_key_figure, map_figure, rates_figure, share_over_figure
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import CASE, Study

if TYPE_CHECKING:
    import pandas as pd

MOST_METRICS = 6
_MOST_KEYS = 6  # panels of a figure
_MOST_DOTS = 20_000
_TIMES = 1000.0  # ratio of the largest to the smallest value of a metric, from which its axis is logarithmic


def metric_figure(
    columns: Sequence[KeyColumn],
    values: Array,
    arm: NDArray[np.str_],
    arms: Sequence[str],
    label: str,
) -> Figure:
    """A metric over each key: median and range from 10 to 90 % of each value, or dots with the median of neighbours.

    Args:
        columns: of the keys, one for each panel.
        values: of the metric, by row.
        arm: by row.
        arms: in the order of their colours.
        label: of the metric.
    """
    figure, grid = over_keys(columns, values, arm, arms, label, _ranges, 3.4 if len(columns) == 1 else 2.7)
    finite = values[np.isfinite(values)]
    if len(finite) and finite.min() > 0 and finite.max() > _TIMES * finite.min():
        grid[0].set_yscale("log")
    return figure


def _ranges(axes: Axes, column: KeyColumn, positions: Array, values: Array, number: int, count: int) -> None:
    """Draw an arm in a panel."""
    colour, dashes = styles(count)[number]
    arms = column.key in ("arm", "")  # each arm has its own position
    dots = arms or not column.listed or len(values) <= 2 * len(column.distinct)
    if dots:
        spread = 0.3 * (np.arange(len(values)) * 0.618034 % 1 - 0.5) if arms else 0.0
        shown = slice(None, None, -(-len(values) // _MOST_DOTS))
        size = float(np.clip(2500 / len(values), 3, 16))
        axes.scatter(
            (positions + spread)[shown], values[shown], s=size, color=colour, alpha=0.35, lw=0, rasterized=True
        )
    found = [(middle, values[member]) for middle, member in groups(positions)]
    if column.listed or len(values) >= 3 * len(found):
        middles = np.array([middle for middle, _ in found])
        low, median, high = np.array([np.percentile(one, [10, 50, 90]) for _, one in found]).T
        if column.scale == "category":
            middles = middles + (0.0 if arms else beside(number, count))
            bars = [median - low, high - median]
            axes.errorbar(middles, median, bars, color=colour, fmt="o", ms=4, lw=1.3)
        else:
            axes.plot(middles, median, color=colour, ls=dashes, lw=1.6, marker="o", ms=3)
            if count <= FEW_ARMS:
                axes.fill_between(middles, low, high, color=colour, alpha=0.14, lw=0)


def sensitivity_figure(found: dict[str, Sensitivity]) -> Figure:
    """Sensitivity to each key, largest first, one panel for each arm.

    Args:
        found: sensitivities by arm, all Sobol indices or all rank correlations.
    """
    arms = list(found)[:MOST_PANELS]
    first = found[arms[0]]
    weight = np.mean([one.first if one.total is None else one.total for one in found.values()], axis=0)
    order = np.argsort(-weight, kind="stable")
    across = min(len(arms), PER_ROW - 1)
    height = 0.7 + 0.36 * len(order)
    figure, grid = panels(len(arms), share_y=True, share_x=True, height=height, across=across)
    places = np.arange(len(order), dtype=float)
    for i, (axes, arm) in enumerate(zip(grid, arms, strict=True)):
        one = found[arm]
        if one.total is not None:
            _bars(axes, places - 0.18, one.first, one.first_range, order, COLOURS[0])
            _bars(axes, places + 0.18, one.total, one.total_range, order, COLOURS[4])
        else:
            axes.barh(places, one.first[order], height=0.55, color=COLOURS[0])
        if one.chance is not None:
            axes.axvline(one.chance, color=GREY, lw=1.0, ls=(0, (4, 2)))
        heading(axes, arm, panel_width(len(arms), across))
        axes.set_yticks(places, [cut(first.keys[k], 42) for k in order], fontsize=8, parse_math=False)
        axes.set_ylim(len(order) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        if i + across >= len(grid):
            axes.set_xlabel("size of rank correlation" if one.total is None else "Sobol index", fontsize=9)
    low, high = grid[0].get_xlim()
    grid[0].set_xlim(min(low, 0.0), max(high, 1.0))
    if first.total is None:
        entry = Line2D(
            [], [], color=GREY, lw=1.0, ls=(0, (4, 2)), label="a key without influence exceeds it in 5 % of sweeps"
        )
        below(figure, [entry])
    else:
        labels = (("first order: the key alone", COLOURS[0]), ("total: with all its interactions", COLOURS[4]))
        below(figure, [Line2D([], [], color=colour, lw=6, label=label) for label, colour in labels])
    return figure


def _bars(axes: Axes, places: Array, value: Array, ends: Array | None, order: NDArray[np.int64], colour: str) -> None:
    axes.barh(places, value[order], height=0.34, color=colour)
    if ends is not None:
        axes.hlines(places, ends[0, order], ends[1, order], color="black", lw=1.0)


def draw(study: Study, results: Results, table: pd.DataFrame) -> tuple[list[Drawn], list[str]]:
    """The figures that a sweep has numbers for, and texts that say what could not be drawn, and why.

    Args:
        study: the sweep.
        results: its directory, for recorded signals.
        table: of its trials.
    """
    if not table["state"].isin(["done", "failed"]).any():
        return [], ["No trial is finished, so there are no figures yet."]
    columns = key_columns(study, table)
    label, good = outcome(study, table)
    drawn = _success(study, table, columns, label, good)
    notes: list[str] = []
    counted = bool(drawn)
    drawn += _share_over(study, table)
    numbers = {name: table[name].to_numpy(float) for name in shown_metrics(study, table)[:MOST_METRICS]}
    arm = table["arm"].to_numpy(str)
    for name, values in numbers.items():
        chosen = by_influence(columns, values)[:_MOST_KEYS] or [arm_column(study, table)]
        figure = metric_figure(chosen, values, arm, study.arms, with_unit(name))
        caption = "Medians; bars and bands are ranges from 10 to 90 % of the trials, dots are trials."
        caption += f" {_count(values)} of {len(values)} trials have a value."
        drawn.append(Drawn(f"metric_{_stem(name)}", name, caption, figure))
    ranked = ({label: good} if counted else {}) | numbers if len(columns) > 1 else {}
    for name, values in ranked.items():
        found = _sensitivity(study, table, columns, values)
        if isinstance(found, str):
            notes.append(f"No sensitivity of {name}: {found}.")
            continue
        drawn.append(_of_sensitivity(name, found))
    for name in study.config.envelope:
        envelopes = _envelopes(study, results, table, name)
        if not envelopes:
            notes.append(f"No envelope of {name}: no trial has recorded it.")
        drawn += _of_envelope(name, envelopes, unit_of(name))
    for one in drawn:
        title(one.figure, one.title)
    return drawn, notes


def with_unit(metric: str) -> str:
    """Name of a metric and its unit."""
    unit = metric_unit(metric)
    return f"{metric} [{unit}]" if unit and unit != "1" else metric


def _stem(name: str) -> str:
    return re.sub(r"\W+", "_", name)


def _count(values: Array) -> int:
    return int(np.isfinite(values).sum())


def _success(study: Study, table: pd.DataFrame, columns: list[KeyColumn], label: str, good: Array) -> list[Drawn]:
    known = good[np.isfinite(good)]
    if not study.config.success and known.all():  # no condition for success, and no failed trial
        return []
    condition = study.config.success or "a trial that does not fail"
    arm, arms = table["arm"].to_numpy(str), study.arms
    ordered = by_influence(columns, good)
    drawn = []
    if len(arms) > 1:
        figure = rates_figure(rates(study, table), label)
        drawn.append(Drawn("rates", f"{label} of each arm", "With the Wilson interval of 95 %.", figure))
    if len(columns) > 1:
        x, y = (column for column in columns if column in ordered[:2])
        figure = map_figure(x, y, good, arm, table["point"].to_numpy(int), arms, label)
        others = [column.key for column in columns if column not in (x, y)]
        over = f" Of {len(columns)} keys these two have the largest rank correlation with it." if others else ""
        drawn.append(Drawn("success_map", f"{label} over two keys", f"Counted: {condition}.{over}", figure))
    if columns:
        figure = by_key_figure(ordered[:_MOST_KEYS], good, arm, arms, label)
        caption = f"Counted: {condition}. Bands and bars: Wilson intervals of 95 %. Where a key takes many values, "
        caption += "neighbouring values are counted together."
        drawn.append(Drawn("success_by_key", f"{label} over each key", caption, figure))
    return drawn


def _share_over(study: Study, table: pd.DataFrame) -> list[Drawn]:
    over = study.config.share_over
    if over is None:
        return []
    finished = table[table["state"].isin(["done", "failed"])]
    parts = {case: finished[finished[CASE] == case] for case in study.config.cases} or {"": finished}
    found = {
        case: {arm: share_over(study, part, arm) for arm in study.arms} for case, part in parts.items() if len(part)
    }
    caption = f"Counted: {over.condition}, with {over.metric} up to the allowed value, of all finished trials."
    figure = share_over_figure(found, with_unit(over.metric))
    return [Drawn("share_over", f"share of trials over the allowed {over.metric}", caption, figure)]


def _sensitivity(
    study: Study, table: pd.DataFrame, columns: list[KeyColumn], values: Array
) -> dict[str, Sensitivity] | str:
    found, reasons = {}, {}
    for arm in study.arms:
        rows = np.flatnonzero((table["arm"] == arm).to_numpy(bool))
        own = [KeyColumn(c.key, c.unit, c.scale, c.positions[rows], c.labels) for c in columns]
        one = sensitivity(study, own, table["point"].to_numpy(int)[rows], values[rows])
        if isinstance(one, str):
            reasons[arm] = one
        else:
            found[arm] = one
    if found:
        return found
    return "; ".join(dict.fromkeys(reasons.values()))


def _of_sensitivity(name: str, found: dict[str, Sensitivity]) -> Drawn:
    one = next(iter(found.values()))
    if one.total is None:
        caption = "Size of Spearman's rank correlation; of keys without order the correlation ratio of the ranks."
    else:
        caption = "Shares of the variance, with intervals of 95 % from resampling."
    figure = sensitivity_figure(found)
    counts = ", ".join(dict.fromkeys(str(each.trials) for each in found.values()))
    return Drawn(f"sensitivity_{_stem(name)}", f"sensitivity of {name}", f"{caption} From {counts} trials.", figure)


def _envelopes(study: Study, results: Results, table: pd.DataFrame, name: str) -> dict[str, Envelope]:
    finished = table["state"].isin(["done", "failed"])
    found = {}
    for arm in study.arms:
        numbers = table["trial"][finished & (table["arm"] == arm)]
        envelope = read_envelope([results.signals_path(int(number)) for number in numbers], name)
        if envelope is not None:
            found[arm] = envelope
    return found


def _of_envelope(name: str, envelopes: dict[str, Envelope], unit: str) -> list[Drawn]:
    if not envelopes:
        return []
    size = max(envelope.levels.shape[1] for envelope in envelopes.values())
    used, planned = (sum(getattr(one, part) for one in envelopes.values()) for part in ("trials", "planned"))
    caption = f"From {used} of {planned} finished trials; a failed trial counts up to the failure."
    drawn = []
    for k in range(size):
        own = {arm: one for arm, one in envelopes.items() if k < one.levels.shape[1]}
        label = name if size == 1 else f"{name}[{k}]"
        suffix = "" if size == 1 else f"_{k}"
        figure = envelope_figure(own, k, f"{label} [{unit}]" if unit else label)
        drawn.append(Drawn(f"envelope_{_stem(name)}{suffix}", f"{label} over time", caption, figure))
    return drawn


def rendered(figure: Figure) -> tuple[bytes, bytes]:
    """A figure as SVG and as PNG, without dates or random identifiers."""
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # keeps the layout, which is computed once for both formats
    vector, pixels = io.BytesIO(), io.BytesIO()
    write_svg(figure, vector)
    figure.savefig(pixels, format="png", dpi=150)
    return vector.getvalue(), pixels.getvalue()


def write_figures(results: Results, drawn: Sequence[Drawn]) -> dict[str, tuple[bytes, bytes]]:
    """Write figures into the directory of a sweep, and remove those of an earlier state; returns SVG and PNG by name.

    Args:
        results: the directory.
        drawn: the figures.

    Raises:
        StorageError: it cannot be written.
    """
    folder, found = results.folder / "figures", {}
    for one in drawn:
        found[one.name] = rendered(one.figure)
        for ending, content in zip((".svg", ".png"), found[one.name], strict=True):
            results.write(folder / f"{one.name}{ending}", partial(Path.write_bytes, data=content))
    for path in folder.glob("*.*"):
        if path.suffix in (".svg", ".png") and path.stem not in found:
            path.unlink()
    return found

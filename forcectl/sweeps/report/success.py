"""Figures of success: rate of each arm, maps over two keys, shares over each key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from forcectl.arrays import Array
from forcectl.figures.force import COLOURS
from forcectl.sweeps.agenda import wilson
from forcectl.sweeps.report.numbers import KeyColumn, Rate, groups
from forcectl.sweeps.report.panels import (
    FEW_ARMS,
    GREY,
    MOST_PANELS,
    PER_ROW,
    WIDTH,
    arm_legend,
    below,
    beside,
    heading,
    name_axis,
    over_keys,
    panel_width,
    panels,
    scale,
    styles,
)

BAD, GOOD = COLOURS[1], COLOURS[0]
SHARES = LinearSegmentedColormap.from_list("share", [BAD, "#f6efe4", GOOD])
_NONE = "#e6e6e6"  # no trial yet
_MOST_CELLS = 40  # in one direction of a panel
_SPARSE = 2  # largest ratio of cells to cells with points: a grid with conditions has empty cells
_MOST_WRITTEN = 80  # cells of a panel with numbers in them
_MANY_DOTS = 600  # of a panel
_HEIGHT = 2.9  # [in] of a map


def rates_figure(rates: Sequence[Rate], label: str) -> Figure:
    """Success rate of each arm with its Wilson interval.

    Args:
        rates: of the arms.
        label: what is counted.
    """
    figure = Figure(figsize=(WIDTH, 0.9 + 0.32 * len(rates)), layout="constrained")
    axes = figure.add_subplot()
    places = [float(place) for place in range(len(rates))]
    for place, rate in zip(places, rates, strict=True):
        if rate.trials:
            axes.plot([100 * rate.low, 100 * rate.high], [place, place], color=GOOD, lw=2.2, solid_capstyle="butt")
            axes.plot(100 * rate.share, place, "o", color=GOOD, ms=6)
        axes.text(1.01, place, f"{rate.successes}/{rate.trials}", va="center", fontsize=8,
                  transform=axes.get_yaxis_transform())  # fmt: skip
    axes.set_yticks(places, [rate.arm or "all trials" for rate in rates], fontsize=9, parse_math=False)
    axes.set(xlim=(-2, 102), ylim=(len(rates) - 0.5, -0.5))
    axes.set_xlabel(f"{label} [%]", fontsize=9)
    axes.grid(axis="x", color="#e4e4e4", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=8)
    return figure


def share_over_figure(found: Mapping[str, Mapping[str, tuple[Array, Array, int]]], metric: str) -> Figure:
    """Share of trials that succeed with at most some value of a metric, over it: a panel a case, a line an arm.

    Args:
        found: results of `share_over` by case and arm; without cases the name of the case is "".
        metric: name and unit.
    """
    shown = dict(list(found.items())[:MOST_PANELS])
    figure, grid = panels(len(shown), share_x=True, share_y=True)
    width, arms = panel_width(len(shown)), list(next(iter(shown.values())))
    every = [values for one in shown.values() for values, _, _ in one.values() if len(values)]
    last = 1.05 * max((float(values[-1]) for values in every), default=1.0)
    for i, (axes, (case, one)) in enumerate(zip(grid, shown.items(), strict=True)):
        for (values, share, count), (colour, dashes) in zip(one.values(), styles(len(arms)), strict=True):
            if not count:
                continue
            over = np.concatenate([[0.0], values, [last]])
            level = np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]])
            axes.step(over, 100 * level, where="post", color=colour, ls=dashes, lw=1.6)
            if len(arms) <= FEW_ARMS:
                low, high = 100 * np.array([wilson(round(each * count), count) for each in level]).T
                axes.fill_between(over, low, high, step="post", color=colour, alpha=0.14, lw=0)
        heading(axes, case, width)
        axes.set(xlim=(0.0, last), ylim=(-4, 104))
        if i + PER_ROW >= len(grid):
            name_axis(axes, metric, "x", width)
        if i % PER_ROW == 0:
            axes.set_ylabel("share of trials [%]", fontsize=9)
    arm_legend(figure, arms)
    return figure


def map_figure(
    x: KeyColumn,
    y: KeyColumn,
    good: Array,
    arm: NDArray[np.str_],
    point: NDArray[np.int64],
    arms: Sequence[str],
    label: str,
) -> Figure:
    """Success over two keys, one panel for each arm: cells for lists, dots for distributions.

    Args:
        x: key across.
        y: key upwards.
        good: by row: 1, 0, or NaN.
        arm: by row.
        point: by row; the trials of a point make one dot.
        arms: in the order of the panels.
        label: what is counted.
    """
    arms = arms[:MOST_PANELS]
    figure, grid = panels(len(arms), share_x=True, share_y=True, height=_HEIGHT)
    width = panel_width(len(arms))
    cells = _is_grid(x, y)
    shares = False
    for axes, name in zip(grid, arms, strict=True):
        rows = arm == name
        heading(axes, name, width)
        if cells:
            _cells(axes, x, y, np.where(rows, good, np.nan), width)
            shares = True
        else:
            shares |= _dots(axes, x.positions[rows], y.positions[rows], good[rows], point[rows])
        scale(axes, x, "x", width)
        scale(axes, y, "y", _HEIGHT - 0.6)
        if cells:
            axes.set(xlim=_edges(x)[[0, -1]].tolist(), ylim=_edges(y)[[0, -1]].tolist())
    for i, axes in enumerate(grid):
        if i + PER_ROW >= len(grid):
            name_axis(axes, x.label, "x", width)
        if i % PER_ROW == 0:
            name_axis(axes, y.label, "y", _HEIGHT - 0.4)
    if shares:
        colours = ScalarMappable(Normalize(0, 100), SHARES)
        bar = figure.colorbar(colours, ax=grid, shrink=0.8, aspect=30, pad=0.02)
        bar.set_label(f"{label} [%]", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    else:
        none = f"no {label}" if not label.startswith("no ") else label.removeprefix("no ")
        below(figure, [_mark(GOOD, "o", label), _mark(BAD, "X", none)])
    return figure


def _is_grid(x: KeyColumn, y: KeyColumn) -> bool:
    """Whether two keys take few values, and most of their combinations; points of distributions do not."""
    across, up = len(x.distinct), len(y.distinct)
    if max(across, up) > _MOST_CELLS:
        return False
    return across * up <= _SPARSE * len(np.unique(np.column_stack([x.positions, y.positions]), axis=0))


def _mark(colour: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], ls="", marker=marker, color=colour, ms=6, mec="white", mew=0.4, label=label)


def _edges(column: KeyColumn) -> Array:
    """Borders of the cells of a key: in the middle between its values, on the scale of its axis."""
    if column.scale == "category":
        return np.linspace(-0.5, len(column.labels) - 0.5, len(column.labels) + 1)
    values = np.log10(column.distinct) if column.scale == "log" else column.distinct
    middle = (values[1:] + values[:-1]) / 2
    edges: Array = np.array([2 * values[0] - middle[0], *middle, 2 * values[-1] - middle[-1]])
    return np.power(10.0, edges) if column.scale == "log" else edges


def _cells(axes: Axes, x: KeyColumn, y: KeyColumn, good: Array, width: float) -> None:
    across, up = (np.arange(len(column.labels)) if column.scale == "category" else column.distinct for column in (x, y))
    column, row = np.searchsorted(across, x.positions), np.searchsorted(up, y.positions)
    known = np.isfinite(good)
    count, sums = np.zeros((len(up), len(across))), np.zeros((len(up), len(across)))
    np.add.at(count, (row[known], column[known]), 1)
    np.add.at(sums, (row[known], column[known]), good[known])
    with np.errstate(invalid="ignore"):
        share = 100 * sums / count
    axes.set_facecolor(_NONE)
    axes.grid(False)
    axes.pcolormesh(_edges(x), _edges(y), np.ma.masked_invalid(share), cmap=SHARES, vmin=0, vmax=100, lw=0.6, ec="w")
    if count.max() > 1 and share.size <= _MOST_WRITTEN and len(across) * 0.3 < width:
        for i, j in zip(*np.nonzero(count), strict=True):
            colour = "white" if abs(share[i, j] - 50) > 30 else "black"
            axes.text(across[j], up[i], f"{share[i, j]:.0f}", ha="center", va="center", fontsize=7, color=colour)


def _dots(axes: Axes, x: Array, y: Array, good: Array, point: NDArray[np.int64]) -> bool:
    """Draw the points of an arm; returns whether they are shares, from several trials each."""
    known = np.isfinite(good)
    x, y, good = x[known], y[known], good[known]
    _, first, which = np.unique(point[known], return_index=True, return_inverse=True)
    size = float(np.clip(14000 / max(len(first), 1), 6, 40))
    many = len(first) > _MANY_DOTS
    style: dict[str, Any] = {"linewidths": 0.0 if many else 0.4, "edgecolors": "white", "rasterized": many, "zorder": 2}
    if len(first) < len(good):
        share = 100 * np.bincount(which, good) / np.bincount(which)
        style["edgecolors"] = "none" if many else GREY
        axes.scatter(x[first], y[first], c=share, cmap=SHARES, vmin=0, vmax=100, s=size, **style)
        return True
    for value, colour, marker in ((1, GOOD, "o"), (0, BAD, "X")):
        chosen = good == value
        axes.scatter(x[chosen], y[chosen], color=colour, marker=marker, s=size, **style)
    return False


def by_key_figure(
    columns: Sequence[KeyColumn],
    good: Array,
    arm: NDArray[np.str_],
    arms: Sequence[str],
    label: str,
) -> Figure:
    """Share of successes over each key, one line for each arm, with Wilson intervals.

    Args:
        columns: of the keys, one for each panel.
        good: by row: 1, 0, or NaN.
        arm: by row.
        arms: in the order of their colours.
        label: what is counted.
    """
    figure, grid = over_keys(columns, good, arm, arms, f"{label} [%]", _shares)
    grid[0].set_ylim(-4, 104)
    return figure


def _shares(axes: Axes, column: KeyColumn, positions: Array, good: Array, number: int, count: int) -> None:
    """Draw an arm in a panel."""
    colour, dashes = styles(count)[number]
    found = [(middle, good[member]) for middle, member in groups(positions)]
    middles = np.array([middle for middle, _ in found])
    share = np.array([100 * one.mean() for _, one in found])
    low, high = 100 * np.array([wilson(int(one.sum()), len(one)) for _, one in found]).T
    if column.scale == "category":
        middles = middles + beside(number, count)
        axes.errorbar(middles, share, [share - low, high - share], color=colour, fmt="o", ms=4, lw=1.2)
        return
    axes.plot(middles, share, color=colour, ls=dashes, lw=1.6, marker="o", ms=3)
    if count <= FEW_ARMS:
        axes.fill_between(middles, low, high, color=colour, alpha=0.14, lw=0)

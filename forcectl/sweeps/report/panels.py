"""Panels of the figures of a sweep: their arrangement, the axis of a key, colours of arms, legends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import NDArray

from forcectl.arrays import Array
from forcectl.figures.force import frame, look_of
from forcectl.figures.targets import GREY as GREY
from forcectl.sweeps.report.numbers import KeyColumn, short

FEW_ARMS = 4  # up to here bands of arms can be told apart
MOST_PANELS = 12
PER_ROW = 3
WIDTH = 9.0  # [in]
_HEIGHT = 2.7  # [in] of a panel
_MOST_LABELS = 9  # values of a key that are all written at its axis
_LONG = 5  # letters of such a value
_LETTER = 0.073  # [in] wide, at a size of 9


@dataclass(frozen=True)
class Drawn:
    """A figure of a sweep.

    Attributes:
        name: of its files.
        title: in words.
        caption: explanation of what the figure shows.
        figure: the figure.
    """

    name: str
    title: str
    caption: str
    figure: Figure


Draw = Callable[[Axes, KeyColumn, Array, Array, int, int], None]


def over_keys(
    columns: Sequence[KeyColumn],
    values: Array,
    arm: NDArray[np.str_],
    arms: Sequence[str],
    label: str,
    draw: Draw,
    height: float = _HEIGHT,
) -> tuple[Figure, list[Axes]]:
    """A figure of numbers over each key.

    Args:
        columns: of the keys, one for each panel.
        values: of the number, by row; not finite where there is none.
        arm: by row.
        arms: in the order of their colours.
        label: of the number.
        draw: draws an arm into a panel: axes, column, positions and values of the arm, its index, number of arms.
        height: of a panel [in].
    """
    figure, grid = panels(len(columns), share_y=True, height=height)
    width = panel_width(len(columns))
    for i, (axes, column) in enumerate(zip(grid, columns, strict=True)):
        for number, name in enumerate(arms):
            own = np.isfinite(values) & (arm == name)
            if own.any():
                draw(axes, column, column.positions[own], values[own], number, len(arms))
        scale(axes, column, "x", width)
        name_axis(axes, column.label, "x", width)
        if i % PER_ROW == 0:
            name_axis(axes, label, "y", height)
    if columns[0].key != "arm":
        arm_legend(figure, arms)
    return figure, grid


def panels(
    count: int, *, share_x: bool = False, share_y: bool = False, height: float = _HEIGHT, across: int = PER_ROW
) -> tuple[Figure, list[Axes]]:
    """A figure of width `WIDTH` with panels in rows.

    Args:
        count: of panels.
        share_x: all panels have the same x axis.
        share_y: all panels have the same y axis.
        height: of a panel [in].
        across: largest number of panels in a row.
    """
    columns = min(count, across)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(WIDTH, 0.5 + height * rows), layout=ConstrainedLayoutEngine(wspace=0.04))
    grid = figure.subplots(rows, columns, sharex=share_x, sharey=share_y, squeeze=False).ravel()
    for spare in grid[count:]:
        spare.set_visible(False)
    if share_x:
        for axes in grid[count - columns : count]:  # with nothing below them
            axes.xaxis.set_tick_params(labelbottom=True)
    for axes in grid[:count]:
        frame(axes)
        axes.tick_params(which="both", labelsize=8)
    return figure, list(grid[:count])


def panel_width(count: int, across: int = PER_ROW) -> float:
    """Approximate width of a panel for labels [in]."""
    return WIDTH / min(count, across) - 0.7


def heading(axes: Axes, text: str, width: float) -> None:
    """Set the title of a panel, cut to the width of the panel.

    Args:
        axes: of the panel.
        text: of the title.
        width: of the panel [in].
    """
    axes.set_title(cut(text, int(width / _LETTER)), loc="left", fontsize=9, parse_math=False)


def cut(text: str, most: int) -> str:
    """A text cut to at most `most` characters; of a key the last names are kept, which are most specific."""
    if len(text) <= most:
        return text
    key, gap, unit = text.partition(" [")
    while len(key) + len(gap) + len(unit) + 1 > most and "." in key:
        key = key.partition(".")[2]
    shorter = f"…{key}{gap}{unit}"
    return shorter if len(shorter) <= most else f"…{text[-(most - 1) :]}" if "." in text else f"{text[: most - 1]}…"


def name_axis(axes: Axes, text: str, which: Literal["x", "y"], size: float) -> None:
    """Set the name of an axis, cut to the size of the panel.

    Args:
        axes: of the panel.
        text: of the name.
        which: "x" or "y".
        size: of the panel in that direction [in].
    """
    label = cut(text, int(size / _LETTER))
    (axes.set_xlabel if which == "x" else axes.set_ylabel)(label, fontsize=9, parse_math=False)


def scale(axes: Axes, column: KeyColumn, which: Literal["x", "y"], size: float) -> None:
    """Set scale, ticks and limits of an axis for a key.

    Args:
        axes: of the panel.
        column: of the key.
        which: "x" or "y".
        size: of the panel in that direction [in].
    """
    axis = axes.xaxis if which == "x" else axes.yaxis
    limits = axes.set_xlim if which == "x" else axes.set_ylim
    if column.scale == "category":
        count = len(column.labels)
        step = max(1, math.ceil(count * (0.13 if which == "y" else 0.15) / size))
        labels = [cut(label, 16) for label in column.labels]
        axis.set_major_locator(FixedLocator(np.arange(0.0, count, step).tolist()))
        axis.set_major_formatter(FixedFormatter(labels[::step]))
        if which == "x" and sum(map(len, labels)) * 0.09 > size:
            axes.tick_params(axis="x", labelrotation=35)
            for label in axes.get_xticklabels():
                label.set(ha="right", rotation_mode="anchor")
        limits(-0.5, count - 0.5)
        for label in axis.get_ticklabels():
            label.set_parse_math(False)
        return
    if column.scale == "log":
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    distinct = column.distinct
    places = np.log10(distinct) if column.scale == "log" else distinct
    span = places[-1] - places[0]
    labels = [short(value) for value in distinct[:_MOST_LABELS]]
    longest = max(map(len, labels))
    needed = (longest + 1) * _LETTER if which == "x" else 2.5 * _LETTER
    if longest <= _LONG and len(distinct) == len(labels) and np.diff(places).min() * size > needed * span:
        axis.set_major_locator(FixedLocator(distinct.tolist()))
        axis.set_major_formatter(FixedFormatter(labels))
        axis.set_minor_locator(NullLocator())
    ends = np.array([places[0] - 0.04 * span, places[-1] + 0.04 * span])
    low, high = 10**ends if column.scale == "log" else ends
    limits(float(low), float(high))


def styles(count: int) -> list[tuple[str, object]]:
    """Colour and dashes of arms, see `look_of`."""
    return [look_of(i) for i in range(count)]


def beside(number: int, count: int) -> float:
    """Offset of an arm from the position of a category, so that arms do not hide each other."""
    return (number - (count - 1) / 2) * min(0.12, 0.6 / count)


def arm_legend(figure: Figure, arms: Sequence[str]) -> None:
    """A legend of the arms below a figure, in the order of `styles`; none for a sweep without arms."""
    entries = [
        Line2D([], [], color=colour, ls=dashes, lw=1.8, label=arm)
        for arm, (colour, dashes) in zip(arms, styles(len(arms)), strict=True)
        if arm
    ]
    below(figure, entries)


def below(figure: Figure, entries: Sequence[Artist]) -> None:
    """A legend below a figure.

    Args:
        figure: that gets the legend; its height grows accordingly.
        entries: of the legend; if empty, there is none.
    """
    if not entries:
        return
    widths = [0.7 + 0.075 * len(str(entry.get_label())) for entry in entries]
    columns = len(entries) if sum(widths) < WIDTH else max(1, int(WIDTH / max(widths)))
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 0.1 + 0.2 * math.ceil(len(entries) / columns))
    legend = figure.legend(handles=list(entries), ncol=columns, frameon=False, fontsize=8, loc="outside lower center")
    for text in legend.get_texts():
        text.set_parse_math(False)


def title(figure: Figure, text: str) -> None:
    """Heading of a figure."""
    figure.suptitle(text, x=0.01, ha="left", fontsize=11, parse_math=False)

"""Time lines of task state machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from matplotlib.figure import Figure

from forcectl.figures.force import COLOURS, stacked

_KINDS = (COLOURS[0], COLOURS[2], COLOURS[1])  # the machine goes on, success, failure
_MOST_VARIANTS = 6


def transition_figure(runs: Mapping[str, Sequence[Any]], modes: Sequence[str], title: str = "") -> Figure:
    """Time line of the modes, a row for each that was entered, with the value that caused each transition.

    Args:
        runs: stays in modes (`Stay`) by the name of the variant; the first six are drawn.
        modes: names in their order.
        title: heading.
    """
    shown = dict(list(runs.items())[:_MOST_VARIANTS])
    entered = [mode for mode in modes if any(stay.mode == mode for stays in shown.values() for stay in stays)]
    figure, rows = stacked(len(shown), 7.5, 0.9 + (0.5 + 0.34 * len(entered)) * len(shown), title)
    for axes, (name, stays) in zip(rows, shown.items(), strict=True):
        whole = stays[-1].end - stays[0].begin
        for stay in stays:
            row = entered.index(stay.mode)
            # A stay too short to be seen is drawn with the smallest visible length.
            length = max(stay.end - stay.begin, 0.004 * whole)
            axes.barh(row, length, left=stay.begin, height=0.55, color=_KINDS[stay.kind])
            if stay.value is not None:
                late = stay.begin > stays[0].begin + 0.85 * whole
                axes.annotate(
                    f"{round(stay.value, 9):.3g}",  # no 3e-34 of what has come to rest
                    (stay.begin, row),
                    (-4 if late else 4, 0),
                    textcoords="offset points",
                    ha="right" if late else "left",
                    va="center",
                    fontsize=8,
                    bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85},
                )
        for before, after in pairwise(stays):
            ends = entered.index(before.mode), entered.index(after.mode)
            axes.vlines(after.begin, min(ends), max(ends), color="0.6", lw=0.8, zorder=0)
        axes.set_yticks(range(len(entered)), entered)
        axes.set_ylim(len(entered) - 0.5, -0.5)
        if name:
            axes.set_title(name, fontsize=9, loc="left", parse_math=False)
    rows[-1].set_xlabel("time [s]; numbers: value that caused the transition")
    return figure

"""Figure of an insertion, as Fig. 6.10."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from forcectl.figures.force import COLOURS, stacked

_NAME_SIZE = 7  # of the modes [pt]
_ROWS = ("force along the bore [N]", "force across the bore [N]", "speed [m/s]", "depth [mm]", "tilt [deg]")


def insertion_figure(
    truth: Any, log: Any, stays: Sequence[Any], title: str = "", task: int = 1, coordinate: int = 1
) -> Figure:
    """True and estimated forces, commanded speeds, depth and tilt over time, with the modes.

    Args:
        truth: of an `InsertionAnalysis`.
        log: of the same run; estimate and speeds are drawn where it has them.
        stays: in modes.
        title: heading.
        task, coordinate: numbers of the task and of its first coordinate, from 1 on, that these are of.
    """
    figure, rows = stacked(5, 7.5, 0.8 + 1.7 * 5, title)
    along, across, speed, depth, tilt = rows
    time = truth.time
    along.plot(time, np.abs(truth.force[:, 2]), color=COLOURS[0], lw=1.5, label="true")
    across.plot(time, np.hypot(truth.force[:, 0], truth.force[:, 1]), color=COLOURS[0], lw=1.5)
    if "task_wrench" in log:
        estimated = log["task_wrench"].values[:, 6 * task - 3 : 6 * task]
        along.plot(time, np.abs(estimated[:, 2]), color=COLOURS[1], lw=1.0, label="estimated")
        across.plot(time, np.hypot(estimated[:, 0], estimated[:, 1]), color=COLOURS[1], lw=1.0)
    if "task_velocity" in log:
        for name, values, colour in zip(
            "xyz", log["task_velocity"].values.T[coordinate - 1 :], COLOURS[2:], strict=False
        ):
            speed.plot(time, values, color=colour, lw=1.2, label=name)
        speed.legend(frameon=False, fontsize=8, loc="lower left", ncol=3)
    depth.plot(time, 1e3 * truth.depth, color=COLOURS[0], lw=1.5)
    tilt.plot(time, np.degrees(truth.tilt), color=COLOURS[0], lw=1.5)
    along.legend(frameon=False, fontsize=8, loc="upper left")
    for axes, label in zip(rows, _ROWS, strict=True):
        axes.set_ylabel(label, fontsize=8)
        for stay in stays[1:]:
            axes.axvline(stay.begin, color="0.6", lw=0.7, zorder=0)
    _name_modes(along, stays)
    rows[-1].set_xlabel("time [s]; vertical lines: transitions")
    return figure


def _name_modes(axes: Axes, stays: Sequence[Any]) -> None:
    """Names above the axes where the stays begin, each at the lowest height at which it overlaps none before it."""
    begin, end = axes.get_xlim()
    per_second = 72.0 * axes.bbox.width / axes.figure.dpi / (end - begin)  # [pt/s]
    ends: list[float] = []  # of the last name at each height [pt]
    for stay in stays:
        x = per_second * stay.begin
        height = next((k for k, taken in enumerate(ends) if taken < x), len(ends))
        width = TextPath((0.0, 0.0), stay.mode, size=_NAME_SIZE).get_extents().width
        ends[height : height + 1] = [x + width + 4.0]
        axes.annotate(
            stay.mode,
            (stay.begin, 1.0),
            (1, 3 + 9 * height),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=_NAME_SIZE,
        )

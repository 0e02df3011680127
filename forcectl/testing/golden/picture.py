"""A log as a picture: each signal over time, with the tube that it should have stayed in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from forcectl.arrays import Array
from forcectl.testing.golden.compare import Difference
from forcectl.testing.golden.tube import tube_around
from forcectl.testing.runs import Log

_MOST = 12  # signals of a picture
_RUN, _TUBE, _OFF = "#0072b2", "#bbbbbb", "#d55e00"


def draw(
    log: Log,
    golden: Log | None = None,
    time: float = 0.0,
    value: Mapping[str, Array] | None = None,
    found: Sequence[Difference] = (),
) -> Figure:
    """A figure with a row for each signal; of a log that was compared, for those that differ.

    Args:
        log: of this run.
        golden: the log it was compared with.
        time: tolerance [s].
        value: of each golden signal.
        found: the differences.
    """
    marks = {each.signal: each.when for each in found if np.isfinite(each.when)}
    labels = [(name, i, samples.shape[1]) for name, samples in log.values.items() for i in range(samples.shape[1])]
    rows = [(name, i, name if size == 1 else f"{name}[{i}]") for name, i, size in labels]
    rows = ([row for row in rows if row[2] in marks] or rows)[:_MOST]
    figure = Figure(figsize=(7.0, 0.6 + 1.6 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, i, label) in zip(axes, rows, strict=True):
        if golden is not None and value is not None and name in golden.values:
            then = golden.values[name][:, min(i, golden.values[name].shape[1] - 1)]
            width = float(value[name][min(i, len(value[name]) - 1)])
            grid = golden.time
            lower, upper = tube_around(grid, then, grid, time, width)
            empty = lower > upper
            lower, upper = np.where(empty, np.nan, lower), np.where(empty, np.nan, upper)
            axis.fill_between(grid, lower, upper, color=_TUBE, linewidth=1.5, label="tube around the golden log")
        axis.plot(log.time, log.values[name][:, i], color=_RUN, linewidth=1.2, label="this run")
        if label in marks:
            axis.axvline(marks[label], color=_OFF, linewidth=1.0, linestyle="--", label="first difference")
        unit = log.units.get(name, "")
        axis.set_ylabel(f"{label} [{unit}]" if unit else label, fontsize=8)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    axes[-1].set_xlabel("time [s]")
    return figure

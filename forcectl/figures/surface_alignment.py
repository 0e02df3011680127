"""Figure of a flat tool that aligns with a plate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from forcectl.figures.force import COLOURS, legend_above, stacked

Array = NDArray[np.float64]


def surface_alignment_figure(
    runs: Mapping[str, tuple[Array, Array, Array, Array]], wanted: tuple[float, float], title: str = ""
) -> Figure:
    """Force, torque and tilt over time.

    Args:
        runs: by the name of the variant: time [s], true force [N], true torque [Nm], tilt [deg], each of shape (k,).
        wanted: largest torque of a tool that is aligned [Nm], and the time from which it is to be [s].
        title: heading.
    """
    figure, rows = stacked(3, 7.5, 0.8 + 2.2 * 3, title)
    for k, (name, (time, *values)) in enumerate(runs.items()):
        for axes, each in zip(rows, values, strict=True):
            axes.plot(time, each, color=COLOURS[k % len(COLOURS)], lw=1.0, label=name)
    rows[1].axhline(wanted[0], color="0.4", lw=0.9, ls=(0, (2, 2)))
    for axes, label in zip(rows, ("force [N]", "torque [Nm]", "tilt [deg]"), strict=True):
        axes.axvline(wanted[1], color="0.4", lw=0.9, ls=(0, (2, 2)))
        axes.set_ylabel(label)
    rows[-1].set_xlabel("time [s]; dotted: largest torque and time of the alignment")
    legend_above(rows[0], 2)
    return figure

"""Figure of a rotation under a force in a band, as Fig. 6.17."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from forcectl.figures.force import COLOURS, legend_above, stacked

Array = NDArray[np.float64]


def kept_force_figure(
    runs: Mapping[str, tuple[Array, Array, Array, Array]], band: tuple[float, float], title: str = ""
) -> Figure:
    """Force, torque and angle over time from the beginning of the rotation.

    Args:
        runs: by the name of the variant: time [s], true force [N], true torque [Nm], angle [rad], each of shape (k,).
        band: limits of the force [N].
        title: heading.
    """
    figure, rows = stacked(3, 7.5, 0.8 + 2.2 * 3, title)
    for k, (name, (time, *values)) in enumerate(runs.items()):
        shown = time >= -1.0
        for axes, each in zip(rows, values, strict=True):
            axes.plot(time[shown], each[shown], color=COLOURS[k % len(COLOURS)], lw=1.0, label=name)
    for limit in band:
        rows[0].axhline(limit, color="0.4", lw=0.9, ls=(0, (2, 2)))
    for axes, label in zip(rows, ("force [N]", "torque [Nm]", "angle [rad]"), strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel("time from the beginning of the rotation [s]; dotted: the band of the first variant")
    legend_above(rows[0], 2)
    return figure

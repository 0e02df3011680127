"""Figure of an alignment, as Fig. 6.5."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from forcectl.figures.force import COLOURS, legend_above, stacked

Array = NDArray[np.float64]


def alignment_figure(curves: Mapping[str, tuple[Array, Array, Array]], angle: float, title: str = "") -> Figure:
    """Angle, speed and torque over time.

    Args:
        curves: by the name of the variant: time [s], theta [rad] and mu [Nm], each of shape (k,).
        angle: of the hole [rad].
        title: heading.
    """
    figure, rows = stacked(3, 7.5, 0.8 + 2.2 * 3, title)
    for k, (name, (time, theta, torque)) in enumerate(curves.items()):
        # Every other one is dashed: curves that are the same show below each other.
        colour, dashes = COLOURS[k % len(COLOURS)], ("-", (0, (4, 2)))[k % 2]
        for axes, values in zip(rows, (theta, np.gradient(theta, time), torque), strict=True):
            axes.plot(time, values, color=colour, ls=dashes, lw=1.4, label=name)
    rows[0].axhline(angle, color="0.4", lw=0.9, ls=(0, (2, 2)))
    for axes, label in zip(rows, ("angle [rad]", "speed [rad/s]", "torque [Nm]"), strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel("time [s]; dotted: the hole")
    legend_above(rows[0], 2)
    return figure

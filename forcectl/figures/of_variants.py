"""Figures of analyses with a curve for each variant: an alignment (Fig. 6.5), a rotation (Fig. 6.17), a flat tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forcectl.arrays import Array
from forcectl.figures.force import colour_of, legend_above, stacked

_LIMIT: dict[str, Any] = {"color": "0.4", "lw": 0.9, "ls": (0, (2, 2))}


def alignment_figure(curves: Mapping[str, tuple[Array, Array, Array]], angle: float, title: str = "") -> Figure:
    """Angle, speed and torque over time.

    Args:
        curves: by the name of the variant: time [s], theta [rad] and mu [Nm], each of shape (k,).
        angle: of the hole [rad].
        title: heading.
    """
    runs = {name: (time, theta, np.gradient(theta, time), torque) for name, (time, theta, torque) in curves.items()}
    # Every other curve is dashed, so that equal curves remain visible.
    figure, rows = _curves(runs, ("angle [rad]", "speed [rad/s]", "torque [Nm]"), title, 1.4, ("-", (0, (4, 2))))
    rows[0].axhline(angle, **_LIMIT)
    rows[-1].set_xlabel("time [s]; dotted: angle of the hole")
    return figure


def kept_force_figure(
    runs: Mapping[str, tuple[Array, Array, Array, Array]], band: tuple[float, float], title: str = ""
) -> Figure:
    """Force, torque and angle over time from the beginning of the rotation.

    Args:
        runs: by the name of the variant: time [s], true force [N], true torque [Nm], angle [rad], each of shape (k,).
        band: limits of the force [N].
        title: heading.
    """
    shown = {name: tuple(each[run[0] >= -1.0] for each in run) for name, run in runs.items()}
    figure, rows = _curves(shown, ("force [N]", "torque [Nm]", "angle [rad]"), title)
    for limit in band:
        rows[0].axhline(limit, **_LIMIT)
    rows[-1].set_xlabel("time from the beginning of the rotation [s]; dotted: the band of the first variant")
    return figure


def surface_alignment_figure(
    runs: Mapping[str, tuple[Array, Array, Array, Array]], limits: tuple[float, float], title: str = ""
) -> Figure:
    """Force, torque and tilt over time of a flat tool that aligns with a plate.

    Args:
        runs: by the name of the variant: time [s], true force [N], true torque [Nm], tilt [deg], each of shape (k,).
        limits: largest torque of a tool that is aligned [Nm], and the time from which it is to be [s].
        title: heading.
    """
    figure, rows = _curves(runs, ("force [N]", "torque [Nm]", "tilt [deg]"), title)
    rows[1].axhline(limits[0], **_LIMIT)
    for axes in rows:
        axes.axvline(limits[1], **_LIMIT)
    rows[-1].set_xlabel("time [s]; dotted: largest torque and time of the alignment")
    return figure


def _curves(
    runs: Mapping[str, Sequence[Array]], labels: Sequence[str], title: str, width: float = 1.0, dashes: Any = ("-",)
) -> tuple[Figure, list[Axes]]:
    """Rows of quantities over time, the first array of each run, in one colour for each variant."""
    figure, rows = stacked(len(labels), 7.5, 0.8 + 2.2 * len(labels), title)
    for k, (name, (time, *values)) in enumerate(runs.items()):
        look = {"color": colour_of(k), "ls": dashes[k % len(dashes)], "lw": width, "label": name}
        for axes, each in zip(rows, values, strict=True):
            axes.plot(time, each, **look)
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    legend_above(rows[0], 2)
    return figure, rows

"""Figures of reaching with both arms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from forcectl.arrays import Array
from forcectl.figures.force import COLOURS, colour_of, legend_above, stacked


def reach_figure(log: Any, distance: Array, every: int, title: str = "") -> Figure:
    """Tool centre points with their targets, one row per arm; distance of links; joint speeds, active constraints."""
    arms, time = [str(name) for name in log["arm"].values], log["time"].values
    figure, rows = stacked(len(arms) + 2, 7.5, 0.8 + 1.9 * (len(arms) + 2), title)
    place, target = (log[name].values.reshape(len(time), len(arms), 6) for name in ("task_position", "task_target"))
    for i, arm in enumerate(arms):
        for k, axis in enumerate("xyz"):
            rows[i].plot(time, place[:, i, k], color=COLOURS[k], lw=1.4, label=axis)
            rows[i].step(time, target[:, i, k], color=COLOURS[k], lw=0.9, ls=(0, (4, 2)), where="post")
        rows[i].set_ylabel(f"{arm}: TCP [m]")
        legend_above(rows[i], 3)
    rows[-2].plot(time[::every], 1e3 * distance, color=COLOURS[0], lw=1.4)
    rows[-2].set_ylabel("least distance [mm]")
    rows[-2].set_ylim(bottom=min(0.0, rows[-2].get_ylim()[0]))
    rows[-1].plot(time, np.linalg.norm(log["joint_velocity_command"].values, axis=1), color=COLOURS[0], lw=1.4)
    rows[-1].set_ylabel("joint speeds [rad/s]")
    binds = log["active_constraints"].values.ravel() > 0
    rows[-1].fill_between(time, 0.0, 1.0, where=binds, transform=rows[-1].get_xaxis_transform(), color="0.9", lw=0)
    rows[-1].set_xlabel("time [s]; dashed: targets, grey: a constraint is active")
    return figure


def null_space_figure(
    runs: Mapping[str, Any], found: Mapping[str, tuple[Array, Array]], limits: Any, every: int, title: str = ""
) -> Figure:
    """Joint speeds, distance to joint limits (`JointLimits`), distance of links, reflected mass of every variant."""
    figure, rows = stacked(4, 7.5, 0.8 + 1.9 * 4, title)
    for k, (name, log) in enumerate(runs.items()):
        time, colour = log["time"].values, colour_of(k)
        q, v = (log[f"joint_{kind}_command"].values for kind in ("position", "velocity"))
        room = np.degrees(np.minimum(limits.position_upper - q, q - limits.position_lower).min(axis=1))
        distance, mass = found[name]
        rows[0].plot(time, np.linalg.norm(v, axis=1), color=colour, lw=1.2, label=name)
        rows[1].plot(time, room, color=colour, lw=1.2)
        rows[2].plot(time[::every], 1e3 * distance, color=colour, lw=1.2)
        rows[3].plot(time[::every], mass.mean(axis=1), color=colour, lw=1.2)
    labels = "joint speeds [rad/s]", "distance to limits [deg]", "least distance [mm]", "reflected mass [kg]"
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    legend_above(rows[0], 4)
    return figure

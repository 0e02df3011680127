"""Figures of a motion loop: speeds of the joints, and forces at the tool centre points with their estimates."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from forcectl.conventions import TASK_COORDINATE
from forcectl.figures.file_names import file_names
from forcectl.figures.force import NOTHING, Found, colour_of, legend_above, mark_findings, stacked

_LOCAL = "estimated_local_wrench"
_DASHED: dict[str, Any] = {"lw": 1.0, "ls": (0, (4, 2))}
_AT_REST = 1e-3  # [rad/s] smallest range of the speed axis
# By dimension, a signal that has values in all components that exist in a variant.
_OF_COMPONENTS = {
    "joint": "link_position",
    "arm": "arm_contact_force",
    "wrench_component": "tip_wrench",
    TASK_COORDINATE: "task_position",
    "task_wrench_component": "task_wrench",
}


def one_variant(log: Any, index: int = 0) -> Any:
    """The log of one variant alone, without the times, joints, arms and tasks that only others have."""
    if "variant" not in log.dims:
        return log
    one = log.isel(variant=index).dropna("time", how="all")
    for dimension, signal in _OF_COMPONENTS.items():
        if signal in one:
            one = one.isel({dimension: one[signal].notnull().any("time").values})
    return one


def motion_figures(log: Any, title: str = "", findings: Found = NOTHING) -> dict[str, Figure]:
    """The figures of any run, by file name: motion of the first variant, forces of each that has any.

    Args:
        log: over time, or over (variant, time).
        title: heading.
        findings: of every variant; those of the first are marked in its motion.
    """
    names = [str(name) for name in np.ravel(log["variant"].values)] if "variant" in log.coords else [""]
    logs = {name: one_variant(log, i) for i, name in enumerate(names)}
    logs = {name: one for name, one in logs.items() if one["arm"].size}  # another may have no such readings
    first, one = next(iter(logs.items()))
    figures = {"motion": speed_figure(one, title)}
    mark_findings(figures["motion"].axes[-1], {first: "#000000"}, findings)
    parts = file_names(names)
    for name, one in logs.items():
        if _estimated(one) or one["tip_wrench"].values.any():
            shown = f"{title}: {name}" if "variant" in log.dims else title
            figures[f"forces_{parts[name]}" if len(names) > 1 else "forces"] = force_figure(one, shown)
    return figures


def speed_figure(log: Any, title: str = "") -> Figure:
    """Joint speeds over time, one row per arm.

    The log does not say which arm a joint is of. Rows are named by arm where all can have as many joints.
    """
    arms, joints = ([str(name) for name in log[part].values] for part in ("arm", "joint"))
    alike = len(joints) % len(arms) == 0
    figure, rows = stacked(len(arms), 8.0, 0.9 + 2.6 * len(arms), title)
    for arm, own, axes in zip(arms, np.array_split(joints, len(arms)), rows, strict=True):
        for k, joint in enumerate(own):
            axes.plot(log["time"], log["link_velocity"].sel(joint=joint), color=colour_of(k), lw=1.2, label=str(joint))
        least, most = axes.get_ylim()  # rounding of an arm at rest must not look like motion
        axes.set_ylim(min(least, -_AT_REST), max(most, _AT_REST))
        axes.set_ylabel(f"{arm}: joint speed [rad/s]" if alike else "joint speed [rad/s]")
        legend_above(axes, 7, 7.0)
    return figure


def force_figure(log: Any, title: str = "") -> Figure:
    """True forces at the tool centre points over time, and what was estimated, one row per arm.

    True forces are in the world. If an estimate is in other axes, which the log does not name, only magnitudes are
    shown.
    """
    arms, estimated = [str(name) for name in log["arm"].values], _estimated(log)
    figure, rows = stacked(len(arms), 8.0, 0.9 + 2.6 * len(arms), title)
    for arm, axes in zip(arms, rows, strict=True):
        of_arm = [f"{arm}_force_{part}" for part in "xyz"]
        for name, word, look in ((estimated, "estimated", {"lw": 1.4}), ("tip_wrench", "true", _DASHED)):
            if name:
                force = log[name].sel(wrench_component=of_arm).values
                shown = dict(zip("xyz", force.T, strict=True))
                if estimated == _LOCAL:
                    shown = {"magnitude": np.linalg.norm(force, axis=1)}
                for k, (part, values) in enumerate(shown.items()):
                    axes.plot(log["time"], values, color=colour_of(k), label=f"{part}, {word}", **look)
        axes.set_ylabel(f"{arm}: force [N]")
        legend_above(axes, 6)
    return figure


def _estimated(log: Any) -> str:
    """Name of the estimated wrenches of a log; empty without any."""
    return next((name for name in ("estimated_wrench", _LOCAL) if name in log and log[name].notnull().any()), "")

"""Figures of a motion loop: speeds of the joints, and forces at the tool centre points with their estimates."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forcectl.figures.force import COLOURS, frame

_AXES = ("x", "y", "z")


_OF_COMPONENTS = {"joint": "link_position", "arm": "arm_contact_force", "wrench_component": "tip_wrench"}


def one_variant(log: Any, index: int = 0) -> Any:
    """The log of one variant alone, without the times, joints and arms that only others have."""
    if "variant" not in log.dims:
        return log
    one = log.isel(variant=index).dropna("time", how="all")
    for dimension, signal in _OF_COMPONENTS.items():
        one = one.isel({dimension: one[signal].notnull().any("time").values})
    return one


def motion_figures(log: Any, title: str = "") -> dict[str, Figure]:
    """The figures of any run, by file name: motion of the first variant, forces of each that has any."""
    figures = {"motion": speed_figure(one_variant(log), title)}
    names = [str(name) for name in log["variant"].values] if "variant" in log.dims else [""]
    for i, name in enumerate(names):
        one = one_variant(log, i)
        if "estimated_wrench" in one or one["tip_wrench"].values.any():
            shown = f"{title}: {name}" if name else title
            figures["forces" if len(names) == 1 else f"forces_{i + 1}"] = force_figure(one, shown)
    return figures


def _rows(log: Any) -> list[str]:
    return [str(name) for name in log["arm"].values]


def speed_figure(log: Any, title: str = "") -> Figure:
    """Joint speeds over time, one row per arm."""
    arms, joints = _rows(log), [str(name) for name in log["joint"].values]
    each = len(joints) // len(arms)
    figure, rows = _stack(len(arms), title)
    for i, (arm, axes) in enumerate(zip(arms, rows, strict=True)):
        for k, joint in enumerate(joints[i * each : (i + 1) * each]):
            axes.plot(log["time"], log["link_velocity"].sel(joint=joint), color=_colour(k), lw=1.2, label=joint)
        axes.set_ylabel(f"{arm}: joint speed [rad/s]")
        axes.legend(frameon=False, fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=7, columnspacing=1.0)
    return figure


def force_figure(log: Any, title: str = "") -> Figure:
    """True forces at the tool centre points over time, and what was estimated, one row per arm."""
    arms = _rows(log)
    figure, rows = _stack(len(arms), title)
    for arm, axes in zip(arms, rows, strict=True):
        for k, part in enumerate(_AXES):
            component = f"{arm}_force_{part}"
            if "estimated_wrench" in log:
                estimate = log["estimated_wrench"].sel(wrench_component=component)
                axes.plot(log["time"], estimate, color=_colour(k), lw=1.4, label=f"{part}, estimated")
            true = log["tip_wrench"].sel(wrench_component=component)
            axes.plot(log["time"], true, color=_colour(k), lw=1.0, ls=(0, (4, 2)), label=f"{part}, true")
        axes.set_ylabel(f"{arm}: force [N]")
        axes.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=6)
    return figure


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _stack(count: int, title: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(8.0, 0.9 + 2.6 * count), layout="constrained")
    rows = list(figure.subplots(count, sharex=True, squeeze=False)[:, 0])
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, parse_math=False)
    rows[-1].set_xlabel("time [s]")
    for axes in rows:
        frame(axes)
    return figure, rows

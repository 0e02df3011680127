"""Range of a recorded signal over trials: median, 10 to 90 %, smallest and largest value, for each arm."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from forcectl.arrays import Array
from forcectl.sweeps.report.panels import GREY, MOST_PANELS, PER_ROW, below, heading, panel_width, panels, styles

MOST_READ = 4000  # trials of an arm
MOST_COMPONENTS = 7
_BEYOND = 4.0  # times the range of 10 to 90 %: values further away are cut off
_LEVELS = (0, 10, 50, 90, 100)  # [%]


@dataclass(frozen=True)
class Envelope:
    """Range of a signal.

    Attributes:
        time: of the samples [s], shape (samples,).
        levels: smallest value, 10 %, median, 90 % and largest value, shape (5, components, samples).
        trials: number of trials that it is computed from.
        planned: number of trials of the arm.
    """

    time: Array
    levels: Array
    trials: int
    planned: int


def read_envelope(paths: Sequence[Path], name: str) -> Envelope | None:
    """The range of a signal over the trials of some files; None where none of them has it.

    Of a vector the first `MOST_COMPONENTS` components are read, which bounds the memory in use.
    Where trials end early, later values are from the others. Of very many trials an evenly distributed part is read.

    Args:
        paths: of the files, some of which need not exist.
        name: of the signal.
    """
    step = -(-len(paths) // MOST_READ) if paths else 1
    found = [one for path in paths[::step] if (one := _read(path, name)) is not None]
    if not found:
        return None
    size = max(len(values) for _, values in found)
    time = max((time for time, _ in found), key=lambda one: float(one[-1]))
    stack = np.full((len(found), size, len(time)), np.nan)
    for i, (own, values) in enumerate(found):
        for k, component in enumerate(values):
            same = len(own) == len(time) and own[-1] == time[-1]
            stack[i, k] = component if same else np.interp(time, own, component, right=np.nan)
    levels = np.full((len(_LEVELS), size, len(time)), np.nan)
    for k in range(size):
        there = np.isfinite(stack[:, k]).any(axis=0)
        levels[:, k, there] = np.nanpercentile(stack[:, k][:, there], _LEVELS, axis=0)
    return Envelope(time, levels, len(found), len(paths))


def _read(path: Path, name: str) -> tuple[Array, Array] | None:
    try:
        with np.load(path) as file:
            time, values = file["time"], np.atleast_2d(file[name])[:MOST_COMPONENTS]
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    return (time, values) if np.isfinite(values).any() else None


def envelope_figure(envelopes: Mapping[str, Envelope], component: int, label: str) -> Figure:
    """The range of one component of a signal over time, one panel for each arm.

    Args:
        envelopes: by arm.
        component: number from 0.
        label: of the signal.
    """
    arms = list(envelopes)[:MOST_PANELS]
    figure, grid = panels(len(arms), share_x=True, share_y=True, height=3.4 if len(arms) == 1 else 2.7)
    width = panel_width(len(arms))
    kept = {arm: envelope.levels[:, component] for arm, envelope in envelopes.items() if arm in arms}
    for i, (axes, arm, (colour, _)) in enumerate(zip(grid, arms, styles(len(arms)), strict=True)):
        least, low, median, high, most = kept[arm]
        time = envelopes[arm].time
        axes.fill_between(time, least, most, color=GREY, alpha=0.16, lw=0)
        axes.fill_between(time, low, high, color=colour, alpha=0.35, lw=0)
        axes.plot(time, median, color=colour, lw=1.8)
        heading(axes, arm, width)
        if i + PER_ROW >= len(grid):
            axes.set_xlabel("time [s]", fontsize=9)
        if i % PER_ROW == 0:
            axes.set_ylabel(label, fontsize=9, parse_math=False)
        axes.set_xlim(float(time[0]), float(time[-1]))
    cut_off = _limit(list(kept.values()))
    if cut_off is not None:
        grid[0].set_ylim(*cut_off)
    colour = styles(1)[0][0] if len(arms) == 1 else "black"
    entries = [
        Line2D([], [], color=colour, lw=1.8, label="median"),
        Patch(color=colour, alpha=0.35, lw=0, label="10 to 90 %"),
        Patch(color=GREY, alpha=0.25, lw=0, label="all trials" + (", in part beyond the axis" if cut_off else "")),
    ]
    below(figure, entries)
    return figure


def _limit(levels: Sequence[Array]) -> tuple[float, float] | None:
    """Limits of an axis that a few diverging trials would make unreadable; None where all values can be shown."""
    low, high = (float(np.nanmin([one[1] for one in levels])), float(np.nanmax([one[3] for one in levels])))
    least, most = (float(np.nanmin([one[0] for one in levels])), float(np.nanmax([one[4] for one in levels])))
    span = high - low
    if span <= 0 or most - least <= 2 * _BEYOND * span:
        return None
    return max(least, low - span), min(most, high + span)

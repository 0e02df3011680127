"""Allowed forces in the figure of a force: bands around each constant reference, and targets with their ranges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from forcectl.arrays import Array

BANDS = (0.05, 0.02)  # of the reference, in which a force is settled
_SHADES = ("#ececec", "#d9d9d9")
_HELD = 0.2  # [s] shortest time of a constant reference with a band
_MOST_REFERENCES = 3  # largest number of different references with bands
_MOST_TARGETS = 12
GREY = "#707070"
_ARROW = 0.05  # length, of the height of the axes, where one side is open


class ForceTarget(NamedTuple):
    """The allowed range of a force.

    Attributes:
        variant: whose force; "" where there is one only.
        time: of the force that is judged [s].
        low, high: allowed range [N]; None: open.
        published: published force [N]; None: there is none.
    """

    variant: str
    time: float
    low: float | None
    high: float | None
    published: float | None = None


def draw_bands(axes: Axes, references: Iterable[tuple[Array, Array]]) -> None:
    """Shade 5 % and 2 % around every constant desired force.

    Args:
        axes: force over time.
        references: times and desired forces that differ, shapes (k,) [s, N].
    """
    every = list(references)
    if len(every) > _MOST_REFERENCES:
        return
    label: str | None = f"within {' % and '.join(f'{100 * band:g}' for band in BANDS)} %"
    for time, desired in every:
        changes = np.flatnonzero(np.diff(desired) != 0) + 1
        for part in np.split(np.arange(len(desired)), changes):
            force, begin, end = desired[part[0]], time[part[0]], time[part[-1]]
            if not force > 0 or end - begin < _HELD:
                continue
            for band, shade in zip(BANDS, _SHADES, strict=True):
                low, high = (1 - band) * force, (1 + band) * force
                axes.fill_between([begin, end], low, high, color=shade, lw=0, zorder=0.5, label=label)
                label = None


def draw_targets(axes: Axes, colours: Mapping[str, str], targets: Sequence[ForceTarget]) -> None:
    """Mark the allowed range at the time of the force that is judged: a bar, or an arrow where one side is open.

    Args:
        axes: force over time, with the curves.
        colours: of the variants by name.
        targets: of them; those of others are left out, and all where they are too many to be distinguished.
    """
    shown = [one for one in targets if one.variant in colours or len(colours) == 1]
    if not shown or len(shown) > _MOST_TARGETS:
        return
    begin, end = axes.get_xlim()
    low, high = axes.get_ylim()
    stub = _ARROW * (high - low)
    look: dict[str, Any] = {"lw": 1.6, "capsize": 4, "capthick": 1.6, "zorder": 4}
    for one in shown:
        colour = colours.get(one.variant, next(iter(colours.values())))
        time = float(np.clip(one.time, begin + 0.01 * (end - begin), end - 0.01 * (end - begin)))
        if one.low is not None and one.high is not None:
            middle, half = (one.low + one.high) / 2, (one.high - one.low) / 2
            axes.errorbar(time, middle, yerr=half, fmt="none", ecolor=colour, **look)
        elif one.high is not None:
            axes.errorbar(time, one.high, yerr=stub, uplims=True, fmt="none", ecolor=colour, **look)
        elif one.low is not None:
            axes.errorbar(time, one.low, yerr=stub, lolims=True, fmt="none", ecolor=colour, **look)
        if one.published is not None:
            axes.plot(time, one.published, marker="D", ms=5, mfc="white", mec=colour, mew=1.4, ls="", zorder=4.5)
    axes.plot([], [], color=GREY, marker="|", ms=9, mew=1.6, ls="", label="target: allowed force")
    if any(one.published is not None for one in shown):
        axes.plot([], [], color=GREY, marker="D", ms=5, mfc="white", mew=1.4, ls="", label="published force")

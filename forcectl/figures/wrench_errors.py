"""Figure of the errors of estimated wrenches."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from forcectl.arrays import Array
from forcectl.figures.force import COLOURS, colour_of, frame, plain_names
from forcectl.figures.shown import ShownFigure


def error_figure(errors: Mapping[str, Mapping[str, Array]], title: str = "") -> Figure:
    """Cumulative distribution of errors over time: one panel per quantity, one curve per variant.

    Args:
        errors: sizes over time, by variant and by the quantity with its unit.
        title: heading.
    """
    quantities = list(next(iter(errors.values())))
    figure = ShownFigure(figsize=(3.6 * len(quantities) + 2.6, 4.2), layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, parse_math=False)
    shares = np.linspace(1.0, 99.9, 990)
    panels = np.atleast_1d(figure.subplots(1, len(quantities), sharey=True))
    for axes, quantity in zip(panels, quantities, strict=True):
        for k, (name, found) in enumerate(errors.items()):
            dashes = "-" if k < len(COLOURS) else ":"
            axes.plot(np.percentile(found[quantity], shares), shares, dashes, color=colour_of(k), lw=1.4, label=name)
        axes.axhline(95.0, color="0.6", lw=0.8)
        axes.set_xscale("log")
        axes.set_xlabel(quantity)
        frame(axes)
    panels[0].set_ylabel("share of the time [%]; line: 95 %")
    if len(errors) > 1:
        entries = panels[0].get_legend_handles_labels()
        plain_names(figure.legend(*entries, frameon=False, fontsize=8, loc="outside right upper"))
    return figure

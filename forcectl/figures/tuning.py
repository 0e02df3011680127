"""Figures of a tuned controller: the experiment it was tuned on, and the closed loop that is expected of it."""

from __future__ import annotations

from matplotlib.figure import Figure

from forcectl.arrays import Array
from forcectl.figures.force import COLOURS, stacked
from forcectl.figures.targets import GREY

_NOTHING = 1e-3  # smallest difference that is drawn to scale, as a share of the largest force


def experiment_figure(time: Array, displacement: Array, force: Array, model_force: Array, title: str = "") -> Figure:
    """The record over time, displacement above and force below, with the plant model's force for that displacement.

    Args:
        time: (k,) [s].
        displacement: (k,) [m].
        force, model_force: (k,) [N].
    """
    figure, (above, below) = stacked(2, 8.0, 5.0)
    above.set_title(title, loc="left", fontsize=11, parse_math=False)
    above.plot(time, 1e3 * displacement, color=COLOURS[0], lw=1.5)
    above.set_ylabel("displacement [mm]")
    below.plot(time, force, color=COLOURS[0], lw=1.5, label="recorded")
    below.plot(time, model_force, color=COLOURS[1], lw=1.2, ls=(0, (5, 3)), label="plant model, from the displacement")
    below.set_ylabel("force [N]")
    below.set_xlim(float(time[0]), float(time[-1]))
    below.legend(frameon=False, fontsize=9, loc="best")
    return figure


def prediction_figure(time: Array, predicted: Array, model: Array, title: str = "") -> Figure:
    """Force of the tuned loop as predicted, and of the reference model, for a step of the reference.

    Args:
        time: (k,) [s].
        predicted, model: (k,) [N]; the prediction may end in NaN.
    """
    figure, (above, below) = stacked(2, 8.0, 5.0, ratios=(3, 1))
    above.set_title(title, loc="left", fontsize=11, parse_math=False)
    above.plot(time, predicted, color=COLOURS[0], lw=1.8, label="tuned loop, predicted")
    above.plot(time, model, color=GREY, lw=1.4, ls=(0, (5, 3)), label="reference model")
    above.set_ylabel("force [N]")
    above.legend(frameon=False, fontsize=9, loc="lower right")
    below.axhline(0.0, color=GREY, lw=1.0)
    below.plot(time, predicted - model, color=COLOURS[0], lw=1.5)
    below.set_ylabel("difference [N]")
    below.set_xlim(float(time[0]), float(time[-1]))
    largest = float(model.max())
    if float(abs(predicted - model).max()) < _NOTHING * largest:  # so that rounding errors do not fill the axes
        below.set_ylim(-_NOTHING * largest, _NOTHING * largest)
    # A predicted loop that diverges must not hide the reference model.
    if not (predicted[-1] == predicted[-1] and abs(predicted).max() < 3 * largest):
        above.set_ylim(-largest, 3 * largest)
        below.set_ylim(-2 * largest, 2 * largest)
    return figure

"""A state machine as a chart: plain values, without a robot or a Drake system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

End = Literal["", "success", "failure"]


@dataclass(frozen=True)
class ChartMode:
    """A mode of a chart.

    Attributes:
        name: unique in the chart.
        end: how the machine ends in this mode; "" if it does not.
        notes: lines of text below the name.
    """

    name: str
    end: End = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChartArrow:
    """A transition from one mode to another; the label is its guard."""

    source: str
    target: str
    label: str


@dataclass(frozen=True)
class MachineChart:
    """Modes, start mode and transitions of a machine, for `forcectl.graph`.

    Attributes:
        name: of the machine.
        start: name of the first mode.
        modes: in the order of their numbers.
        arrows: transitions; those of a mode in the order in which they are checked.
    """

    name: str
    start: str
    modes: tuple[ChartMode, ...]
    arrows: tuple[ChartArrow, ...]

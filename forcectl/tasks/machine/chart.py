"""A state machine as it is drawn: plain values, without a robot or a Drake system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

End = Literal["", "success", "failure"]


@dataclass(frozen=True)
class ChartMode:
    """A mode of a chart.

    Attributes:
        name: unique in the chart.
        end: whether the machine ends here, and how; "" where it goes on.
        notes: lines below the name.
    """

    name: str
    end: End = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChartArrow:
    """A transition from one mode to another, with its guard in words."""

    source: str
    target: str
    label: str


@dataclass(frozen=True)
class MachineChart:
    """Modes, the one at the start, and the transitions between them, for `forcectl.graph`.

    Attributes:
        name: of the machine.
        start: name of the mode that it starts in.
        modes: in their order.
        arrows: those of a mode in the order in which they are looked at.
    """

    name: str
    start: str
    modes: tuple[ChartMode, ...]
    arrows: tuple[ChartArrow, ...]

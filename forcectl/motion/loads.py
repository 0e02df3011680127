"""Loads on a robot over time: wrenches at the tool centre points, held, ramped, one after the other, and again.

A load of the list acts from `start` on: each of its wrenches for `hold`, with a ramp of `ramp` at both ends, then a
`pause` without; all of it `repeats` times, `every` so many seconds. Loads on one arm add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, OutputPort

from forcectl.errors import invalid, unknown
from forcectl.framework.batch import check, check_count
from forcectl.robot.model import RobotModel

Array = NDArray[np.float64]
_ROUNDING = 1e-9  # [s] of the times of ticks


@dataclass(kw_only=True)
class LoadConfig:
    """One entry of scenario part `loads`."""

    arm: str = ""  # which arm; empty: the first
    start: float = 0.0  # [s], >= 0
    hold: float = 1.0  # [s] of each wrench, > 0, ramps included
    pause: float = 0.0  # [s] after each wrench, >= 0
    ramp: float = 0.0  # [s], >= 0 and at most half of `hold`
    wrenches: list[list[float]] = field(default_factory=list)  # each [torque; force] in the world [Nm, N]
    repeats: int = 1  # >= 1
    every: float = 0.0  # [s] from the start of one repeat to the next

    def __post_init__(self) -> None:
        for name in ("start", "pause", "ramp", "every"):
            check(name, getattr(self, name), "not negative")
        check_count("repeats", self.repeats)
        if check("hold", self.hold, "positive") < 2 * self.ramp:
            raise invalid("ramp", self.ramp, f"at most half of hold, {self.hold / 2:g} s")
        if not self.wrenches:
            raise invalid("wrenches", self.wrenches, "at least one wrench")
        for wrench in self.wrenches:
            if len(wrench) != 6:
                raise invalid("wrenches", wrench, "six numbers each, [torque; force]")
            for value in wrench:
                check("wrenches", value)
        if self.repeats > 1 and self.every < self.duration:
            raise invalid("every", self.every, f"at least what one repeat lasts, {self.duration:g} s")

    @property
    def duration(self) -> float:
        """Of one repeat [s]."""
        return len(self.wrenches) * (self.hold + self.pause)

    def wrench(self, time: float) -> Array:
        """The wrench at a time [s], shape (6,) [Nm, N]."""
        since = time - self.start
        if self.repeats > 1 and since >= 0:
            since -= min(since // self.every, self.repeats - 1) * self.every
        which, within = divmod(since, self.hold + self.pause)
        if not 0 <= which < len(self.wrenches) or within >= self.hold:
            return np.zeros(6)
        edge = min(within, self.hold - within)
        share = min(1.0, edge / self.ramp) if self.ramp > 0 else 1.0
        full: Array = share * np.array(self.wrenches[int(which)], dtype=float)
        return full


class Loads(LeafSystem):
    """The sum of the loads on each arm.

    ```
    name: Loads
    input_ports: []
    output_ports: [external_wrench]
    ```

    external_wrench: shape (6a,), on the robot at the TCP of each arm in the world, [torque; force] [Nm, N]. State.

    Sampling: every `period` [s]; the load of a tick shows after it.

    Args:
        loads: of the arms in `arms`, by name.
    """

    port_units = {"external_wrench": "Nm,N"}

    def __init__(self, loads: Sequence[LoadConfig], arms: Sequence[str], *, period: float):
        super().__init__()
        self._loads = [(list(arms).index(load.arm or arms[0]), load) for load in loads]
        self._count = len(arms)
        state = self.DeclareDiscreteState(6 * len(arms))
        self.DeclareStateOutputPort("external_wrench", state)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._update
        )

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        total = np.zeros((self._count, 6))
        for arm, load in self._loads:
            total[arm] += load.wrench(context.get_time() + _ROUNDING)
        next_state.set_value(total.ravel())


def add_loads(builder: DiagramBuilder, loads: Sequence[LoadConfig], robot: RobotModel, period: float) -> OutputPort:
    """Add the loads; returns the port with the wrenches, shape (6a,) [Nm, N].

    Raises:
        BadInputError: a load on an arm that the robot has not.
    """
    arms = list(robot.parts.arms)
    for load in loads:
        if load.arm and load.arm not in arms:
            raise unknown("arm", load.arm, arms)
    block = builder.AddNamedSystem("loads", Loads(loads, arms, period=period))
    return block.GetOutputPort("external_wrench")

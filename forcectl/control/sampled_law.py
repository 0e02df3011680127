"""A sampled control law whose command acts in the tick it is computed in, and is then held.

A command kept in discrete state reaches sampled plants one tick late. One computed in an unrestricted update does not,
but such an event copies the state of the whole diagram and throws away everything computed so far in the tick: a
multibody plant would solve its step twice. Here the output is computed from the inputs at the tick and kept as state
for the rest of it: no delay and nothing computed twice. A continuous plant's integrator, too, sees the new command when
its step ends on a tick: runge_kutta3 gives that a sixth of the step.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.lanes import Lane, LaneBlock, Parameter, check, lane_values


class SampledLaw(LaneBlock):
    """Base of sampled laws for n lanes.

    A subclass declares its input ports, then calls `declare_command`, and gives the law in `command`.

    Args:
        size: lanes n. parameters: see `LaneBlock`. period: control tick [s].
    """

    def __init__(self, size: int, parameters: Mapping[str, Parameter], period: float):
        self._period = check("period", period, "positive")
        super().__init__(size, parameters)

    def declare_command(self, name: str, reads: set[Any], initial: ArrayLike = 0.0) -> None:
        """Declare the output port `name` of shape (n,), its memory and its event.

        Args:
            reads: tickets of the inputs the law uses. initial: the command held before the first tick.
        """
        start = lane_values("initial command", initial, self._size)
        # The tick the held command belongs to (repeated per lane), then the command.
        self._held = self.DeclareDiscreteState(np.concatenate([np.full(self._size, -1.0), start]))
        reads = reads | {self.time_ticket(), self.discrete_state_ticket(self._held), self.all_parameters_ticket()}
        self._output = self.DeclareVectorOutputPort(name, self._size, self._calc, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self._period, offset_sec=0.0, update=self._hold)

    @abstractmethod
    def command(self, context: Context, held: Lane) -> Lane:
        """The command of a new tick, from the inputs and the command held so far."""

    def _tick(self, context: Context) -> float:
        # The small shift keeps an instant k * period, rounded down, in its own tick.
        return (context.get_time() + 1e-9) // self._period

    def _calc(self, context: Context, output: BasicVector) -> None:
        memory = context.get_discrete_state(self._held).value()
        held = memory.item(1) if self._size == 1 else memory[self._size :]
        known = memory.item(0) == self._tick(context)
        self.write(output, held if known else self.command(context, held))

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        memory = np.empty(2 * self._size)
        memory[: self._size] = self._tick(context)
        memory[self._size :] = self._output.Eval(context)
        next_state.set_value(self._held, memory)

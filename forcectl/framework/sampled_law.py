"""A sampled control law whose command acts in the tick it is computed in, and is then held.

A command kept in discrete state reaches sampled plants one tick late. One computed in an unrestricted update does not,
but such an event copies the state of the whole diagram and throws away everything computed so far in the tick: a
multibody plant would solve its step twice. Here the output is computed from the inputs at the tick and kept as state
for the rest of it: no delay and nothing computed twice. A continuous plant's integrator, too, sees the new command when
its step ends on a tick: runge_kutta3 gives that a sixth of the step.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.framework.batch import BatchParameter, Lane, LaneBlock, check, lane_values
from forcectl.framework.cache import BlockCache, values_of_tick


class SampledLaw(LaneBlock):
    """Base of sampled laws for n lanes.

    A subclass declares its input ports, then calls `declare_command` and gives the law in `step`. What it remembers
    besides the command it may show with `declare_output`.

    Args:
        size: lanes n. parameters: see `LaneBlock`. period: control tick [s].
    """

    def __init__(self, size: int, parameters: Mapping[str, BatchParameter], period: float):
        self._period = check("period", period, "positive")
        super().__init__(size, parameters)

    def declare_command(
        self, name: str, reads: set[Any], initial: ArrayLike = 0.0, further: Mapping[str, ArrayLike] | None = None
    ) -> None:
        """Declare the output port `name` of shape (n,), the memory of the law and its event.

        Args:
            reads: tickets of the inputs the law uses. initial: the command held before the first tick.
            further: what else the law remembers from tick to tick, by name, with the value before the first one.
        """
        memory = {name: initial, **(further or {})}
        self._place = {key: i for i, key in enumerate(memory)}
        self._ones = np.ones(self._size)
        start = [lane_values(f"initial {key}", value, self._size) for key, value in memory.items()]
        # The time of the tick the held values belong to (repeated per lane), then the values.
        self._held = self.DeclareDiscreteState(np.concatenate([np.full(self._size, -self._period), *start]))
        reads = reads | {self.time_ticket(), self.discrete_state_ticket(self._held), self.all_parameters_ticket()}
        # A law that remembers nothing but its command needs no cache beside that of its port.
        self._now: BlockCache | None = None
        if further:
            self._now = values_of_tick(self, reads)
            self.declare_output(name)
        else:
            self._command = self.DeclareVectorOutputPort(name, self._size, self._show, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self._period, offset_sec=0.0, update=self._hold)

    def declare_output(self, name: str) -> None:
        """Declare an output port of shape (n,) that shows the remembered value of that name."""
        place, now, single = self._place[name], self._now, self._size == 1
        if now is None:
            raise ValueError(f"{name}: the law remembers its command only, and that is an output")

        def show(context: Context, output: BasicVector) -> None:
            value = now.Eval(context)[place]
            output.SetAtIndex(0, value) if single else output.SetFromVector(value)

        self.DeclareVectorOutputPort(name, self._size, show, prerequisites_of_calc={now.ticket()})

    def remembered(self, context: Context, name: str) -> Lane:
        """A remembered value after the tick that the outputs show, by the name it was declared with."""
        now = self._now
        values = self._compute(context) if now is None else now.Eval(context)
        return values[self._place[name]]

    @abstractmethod
    def step(self, context: Context, held: Sequence[Lane]) -> Sequence[Lane]:
        """The values of a new tick, the command first, from the inputs and the values held so far.

        Args:
            held: a number for every value of one lane, else the array of all of them, (k, n). What is returned may be
                such an array, too.
        """

    def _compute(self, context: Context) -> Sequence[Lane]:
        state = context.get_discrete_state(self._held)
        # Arrays as a copy: a view that a law hands on would keep the context alive from within its own cache.
        values = self.lanes(state.value() if self._size == 1 else state.CopyToVector())
        since, held = values[0] if self._size == 1 else values.item(0), values[1:]
        # Rounding of the times of the ticks is far below the margin.
        return held if context.get_time() - since < 0.999 * self._period else self.step(context, held)

    def _show(self, context: Context, output: BasicVector) -> None:
        self.write(output, self._compute(context)[0])

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        time = context.get_time()
        values = self._now.Eval(context) if self._now else (self.lane(self._command.Eval(context)),)
        if self._size > 1:
            # Rows of an array are put together at a third of the cost of those of a list.
            rest = (values.ravel(),) if isinstance(values, np.ndarray) else values
            next_state.set_value(self._held, np.concatenate([time * self._ones, *rest]))
        else:
            next_state.set_value(self._held, np.array([time, *values]))

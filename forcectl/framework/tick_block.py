"""A block without lanes that computes everything of a tick at once, in the tick, and holds it: one vector of memory.

What `SampledLaw` does for laws of n lanes, and for the same reasons, see there.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteStateIndex, DiscreteValues, InputPort, LeafSystem

from forcectl.framework.cache import values_of_tick

Vector = NDArray[np.float64]


class TickBlock(LeafSystem):
    """Base of such blocks. A subclass declares its inputs, then calls `declare_memory` and `show`; `step` is a tick."""

    def declare_memory(
        self, start: Vector, inputs: Iterable[InputPort], period: float, kept: Mapping[str, Vector] | None = None
    ) -> None:
        """Declare the memory and its event.

        Args:
            start: before the first tick, (m,); its first element is the time of the tick that it belongs to, which is
                -period. inputs: all that `step` reads. period: tick [s]. kept: what else is known after a tick,
                which the next one does not read, by name, as it is before the first tick.
        """
        self._period = period
        self._memory = self.DeclareDiscreteState(start)
        self._end = end = len(start)
        self._kept: dict[str, tuple[DiscreteStateIndex, slice]] = {}
        for name, part in ({} if kept is None else kept).items():
            self._kept[name] = self.DeclareDiscreteState(part), slice(end, end + len(part))
            end += len(part)
        reads = {port.ticket() for port in inputs}
        self._now = values_of_tick(self, reads | {self.time_ticket(), self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._hold)

    def show(self, name: str, place: slice) -> None:
        """Declare an output port with a part of the memory after the tick."""
        now = self._now

        def put(context: Context, output: BasicVector) -> None:
            output.SetFromVector(now.Eval(context)[place])

        self.DeclareVectorOutputPort(name, place.stop - place.start, put, prerequisites_of_calc={now.ticket()})

    def show_kept(self, name: str) -> None:
        """Declare an output port with what was kept in the tick before; by Drake, without a call into Python."""
        self.DeclareStateOutputPort(name, self._kept[name][0])

    @abstractmethod
    def step(self, context: Context, memory: Vector, time: float) -> Vector:
        """The memory after a tick, its time first, and after it what is kept."""

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        values = self._now.Eval(context)
        next_state.set_value(self._memory, values[: self._end])
        for state, place in self._kept.values():
            next_state.set_value(state, values[place])

    def _compute(self, context: Context) -> Vector:
        # A copy: a view that is handed on, unchanged, would keep the context alive from within its own cache.
        memory: Vector = context.get_discrete_state(self._memory).CopyToVector()
        time = context.get_time()
        # Rounding of the times of the ticks is far below the margin.
        if time - memory.item(0) >= 0.999 * self._period:
            return self.step(context, memory, time)
        kept = [context.get_discrete_state(state).value() for state, _ in self._kept.values()]
        return np.concatenate([memory, *kept]) if kept else memory

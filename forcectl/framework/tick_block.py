"""A block without lanes that computes everything of a tick at once, in the tick, and holds it: memory with names.

What `SampledLaw` does for laws of n lanes, and for the same reasons, see there. Besides the memory the state holds what
the last tick started from, its memory and its inputs, so that a tick can be looked at after it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, LeafSystem

from forcectl.errors import BadInputError
from forcectl.framework.cache import values_of_tick

Vector = NDArray[np.float64]

# Vectors by their names.
Memory = Mapping[str, Vector]


class _Tick(NamedTuple):
    """values: memory and what is kept after a tick. start: what it started from, part by part; None between ticks."""

    values: Memory
    start: list[Vector] | None


class TickStart(NamedTuple):
    """What a tick starts from.

    memory: of the tick before, with its time [s].
    inputs: by the names of their ports, without those that are left unconnected.
    """

    memory: Memory
    inputs: Memory


class _Packed:
    """Vectors of given sizes by name, one after the other in one vector."""

    def __init__(self, sizes: Mapping[str, int]):
        self._places: dict[str, slice] = {}
        self.size = 0
        for name, size in sizes.items():
            self._places[name] = slice(self.size, self.size + size)
            self.size += size

    def unpack(self, vector: Vector) -> dict[str, Vector]:
        return {name: vector[place] for name, place in self._places.items()}

    def pack(self, parts: Memory) -> Vector:
        return np.concatenate([parts[name] for name in self._places])


class TickBlock(LeafSystem):
    """Base of such blocks. A subclass declares its inputs, then calls `declare_memory` and `show`; `step` is a tick."""

    # Names of inputs that may be left unconnected.
    optional_inputs: tuple[str, ...] = ()

    def declare_memory(
        self, memory: Memory, inputs: Sequence[InputPort], period: float, kept: Memory | None = None
    ) -> None:
        """Declare the memory and its event.

        Args:
            memory: what a tick knows of the one before, by name, as it is before the first tick. Its time is added.
            inputs: all that `step` reads.
            period: tick [s].
            kept: what else is known after a tick, which the next one does not read, by name, as it is before the first
                tick.
        """
        self._period = period
        self._initial = {"time": np.full(1, -period), **memory}
        self._parts = _Packed({name: len(part) for name, part in self._initial.items()})
        self._memory = self.DeclareDiscreteState(self._parts.pack(self._initial))
        self._kept = {name: self.DeclareDiscreteState(part) for name, part in (kept or {}).items()}
        self._inputs = {port.get_name(): port for port in inputs}
        self._optional = tuple(name for name in self.optional_inputs if name in self._inputs)
        self._readings = _Packed({name: port.size() for name, port in self._inputs.items()})
        self._start = self.DeclareDiscreteState(self._parts.size + self._readings.size)
        reads = {port.ticket() for port in inputs}
        self._now = values_of_tick(self, reads | {self.time_ticket(), self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._hold)

    def show(self, name: str, part: str | None = None, element: int | None = None) -> None:
        """Declare an output port with a part of the memory after the tick.

        Args:
            name: of the port.
            part: of the memory; that of the same name when left out.
            element: of the part; all of it when left out.
        """
        now, part = self._now, name if part is None else part

        def put(context: Context, output: BasicVector) -> None:
            output.SetFromVector(now.Eval(context).values[part])

        def put_element(context: Context, output: BasicVector) -> None:
            output.SetAtIndex(0, now.Eval(context).values[part][element])

        whole = element is None
        size = len(self._initial[part]) if whole else 1
        self.DeclareVectorOutputPort(name, size, put if whole else put_element, prerequisites_of_calc={now.ticket()})

    def show_kept(self, name: str) -> None:
        """Declare an output port with what was kept in the tick before; by Drake, without a call into Python."""
        self.DeclareStateOutputPort(name, self._kept[name])

    @abstractmethod
    def step(self, context: Context, start: TickStart) -> dict[str, Vector]:
        """The memory after a tick, and what is kept, by name.

        Args:
            context: for places to work in; what it depends on is in `start`.
            start: memory and inputs.
        """

    def last_tick(self, context: Context) -> TickStart:
        """What the tick started from whose values the outputs show.

        Raises:
            BadInputError: there was none yet.
        """
        memory = self._parts.unpack(context.get_discrete_state(self._memory).CopyToVector())
        if self._is_due(context, memory):
            return TickStart(memory, self._read(context))
        if memory["time"].item() < 0.0:
            raise BadInputError(f"{self.get_name()}: there was no tick yet at t = {context.get_time():g} s")
        start = context.get_discrete_state(self._start).CopyToVector()
        inputs = self._readings.unpack(start[self._parts.size :])
        for name in self._unconnected(context):
            del inputs[name]
        return TickStart(self._parts.unpack(start), inputs)

    def _is_due(self, context: Context, memory: Memory) -> bool:
        # Rounding of the times of the ticks is far below the margin.
        return bool(context.get_time() - memory["time"].item() >= 0.999 * self._period)

    def _read(self, context: Context) -> dict[str, Vector]:
        missing = self._unconnected(context) if self._optional else ()
        return {name: port.Eval(context) for name, port in self._inputs.items() if name not in missing}

    def _unconnected(self, context: Context) -> list[str]:
        return [name for name in self._optional if not self._inputs[name].HasValue(context)]

    def _compute(self, context: Context) -> _Tick:
        # A copy: a view that is handed on, unchanged, would keep the context alive from within its own cache.
        before = context.get_discrete_state(self._memory).CopyToVector()
        memory = self._parts.unpack(before)
        if not self._is_due(context, memory):
            return _Tick(memory, None)
        inputs = self._read(context)
        values = self.step(context, TickStart(memory, inputs))
        values["time"] = np.array([context.get_time()])
        read = [inputs[name] if name in inputs else np.full(port.size(), np.nan) for name, port in self._inputs.items()]
        return _Tick(values, [before, *read])

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        values, start = self._now.Eval(context)
        if start is None:  # an event that was forced between two ticks changes nothing
            return
        next_state.set_value(self._memory, self._parts.pack(values))
        next_state.set_value(self._start, np.concatenate(start))
        for name, state in self._kept.items():
            next_state.set_value(state, values[name])

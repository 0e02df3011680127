"""Sampled blocks whose outputs take effect at the tick in which they are computed, and are held until the next one.

A command kept in discrete state reaches sampled plants one tick late. An unrestricted update would avoid this delay,
but it copies the state of the whole diagram and invalidates all cached values of the tick: a multibody plant would
solve its step twice. Here the outputs are computed from the inputs at the tick, and kept as state until the next tick.
So there is no delay, and nothing is computed twice. The integrator of a continuous plant also uses the new command at
the end of a step that ends on a tick; in runge_kutta3 this stage has a weight of a sixth.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import ref

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, OutputPort

from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.framework.batch import BatchBlock, batch_values, check
from forcectl.framework.block import BlockCache, PythonBlock, values_of_tick

# Quantities by their names: each a number or an array.
Memory = Mapping[str, Any]

_START = "start of the tick"  # key of the memory before the tick and the inputs, in blocks that store them


class TickStart(NamedTuple):
    """Memory and inputs at the start of a tick.

    Attributes:
        memory: memory after the tick before, with its "time" [s], which is negative before the first tick.
        inputs: values by port name, without unconnected ports.
    """

    memory: Memory
    inputs: Memory


# From Drake 1.58 on a class may have only one base of Drake's, so the class that the two below share has none.
if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem as _Shared
else:
    _Shared = object


class _Ticks(_Shared):
    """Common part of `SampledBlock` and `SampledBatch`."""

    if not TYPE_CHECKING:
        __slots__ = ()  # see `PythonBlock`

    # Names of inputs that may be left unconnected.
    optional_inputs: Sequence[str] = ()
    # Whether the Context also stores memory and inputs at the start of the last tick, see `last_tick`.
    keeps_start = False
    # Shape of the numbers of the memory in `step`; empty: floats.
    _shape: tuple[int, ...] = ()

    def declare_memory(
        self,
        memory: Memory,
        inputs: Sequence[InputPort],
        period: float,
        kept: Mapping[str, Vector] | None = None,
    ) -> None:
        """Declare the memory and its event.

        Args:
            memory: quantities that one tick passes to the next, numbers and vectors by name, with their values before
                the first tick.
            inputs: all ports that `step` reads.
            period: time from tick to tick [s].
            kept: further results of a tick that the next tick does not read, by name, with their values before the
                first tick.
        """
        self._period = check("period", period, "positive")
        self._soonest = 0.999 * period  # [s] from tick to tick, with a margin for rounding errors of the times
        self._inputs = {port.get_name(): port for port in inputs}
        self._optional = {name: self._inputs[name] for name in self.optional_inputs if name in self._inputs}
        self._wide = [port.get_name() for port in inputs if port.size() > math.prod(self._shape)]
        self._scalars = not (self._shape or self._optional or self._wide)  # whether all inputs are single numbers
        self._readers = [(name, port.Eval) for name, port in self._inputs.items() if name not in self._optional]
        self._names = tuple(memory)
        initial = {name: self._initial(name, value) for name, value in memory.items()}
        self._numbers = ["time", *(name for name, value in initial.items() if value.shape == self._shape)]
        self._vectors: dict[str, slice] = {}
        end = len(self._numbers)
        for name, value in initial.items():
            if name not in self._numbers:
                self._vectors[name] = slice(end, end + len(value))
                end += len(value)
        self._packed_size = end * math.prod(self._shape)
        state = self.DeclareDiscreteState(self._pack({**initial, "time": -self._period}))
        self._reads: set[Any] = {port.ticket() for port in inputs}
        self._reads |= {self.time_ticket(), self.all_parameters_ticket(), self.discrete_state_ticket(state)}
        self._state, self._memory = state, int(state)  # an int is looked up in half the time
        self._kept = {name: self.DeclareDiscreteState(part) for name, part in (kept or {}).items()}
        if self.keeps_start:
            self._missing = {port.get_name(): np.full(port.size(), np.nan) for port in inputs}
            self._start = self.DeclareDiscreteState(self._packed_size + sum(port.size() for port in inputs))
        self._now: BlockCache | None = None
        self._port: OutputPort | None = None
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self._period, offset_sec=0.0, update=self._hold)

    def show(self, *names: str, vector: str | None = None) -> None:
        """Declare output ports with quantities of the memory after the tick.

        Args:
            names: names of the ports, and of the quantities, unless a vector is given.
            vector: name of a quantity of shape (k, n), whose first rows the ports show.
        """
        # A block whose only memory is its output needs no cache but that of the port.
        if self._now is None and (vector or len(self._names) > 1):
            self._now = values_of_tick(self, self._reads)
        for element, name in enumerate(names):
            self._declare_output(name, vector, element)

    def _declare_output(self, name: str, vector: str | None, element: int) -> None:
        place = None if vector else self._vectors.get(name)
        size = math.prod(self._shape) * (1 if place is None else place.stop - place.start)
        block: Any = ref(self)
        now: Any = self._now
        reads = {now.ticket()} if now else self._reads

        def put_number(context: Context, output: BasicVector) -> None:
            output.SetAtIndex(0, (now.Eval(context) if now else block()._compute(context))[name])

        def put_vector(context: Context, output: BasicVector) -> None:
            output.SetFromVector((now.Eval(context) if now else block()._compute(context))[name])

        def put_element(context: Context, output: BasicVector) -> None:
            output.SetFromVector(now.Eval(context)[vector][element])

        put = put_element if vector else put_number if place is None and not self._shape else put_vector
        self._port = self.DeclareVectorOutputPort(name, size, put, prerequisites_of_calc=reads)

    def show_held(self, name: str, vector: str | None = None, element: int = 0, factor: float = 1.0) -> None:
        """Declare an output port with a number of the memory after the tick before: no direct feedthrough.

        Args:
            name: name of the port, and of the number unless `vector` gives another one.
            vector: name of a vector of the memory, or of a number with another name than the port.
            element: index in the vector.
            factor: factor by which the number is multiplied.
        """
        state, size = self._memory, math.prod(self._shape)
        place = self._vectors.get(vector or name)
        first = size * (self._numbers.index(vector or name) if place is None else place.start + element)

        def put(context: Context, output: BasicVector) -> None:
            output.SetFromVector(context.get_discrete_state(state).value()[first : first + size] * factor)

        def put_number(context: Context, output: BasicVector) -> None:
            output.SetAtIndex(0, context.get_discrete_state(state).GetAtIndex(first) * factor)

        reads: Any = {self.discrete_state_ticket(self._state)}
        self.DeclareVectorOutputPort(name, size, put if self._shape else put_number, prerequisites_of_calc=reads)

    def show_kept(self, *names: str) -> None:
        """Declare output ports with `kept` quantities of the tick before, as state outputs that do not call Python."""
        for name in names:
            self.DeclareStateOutputPort(name, self._kept[name])

    @abstractmethod
    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """The memory after a tick and the `kept` quantities, by name.

        Args:
            context: for parameters and work space only; all else that a tick depends on are the other arguments.
            memory: memory after the tick before, with its "time" [s], which is negative before the first tick.
            inputs: values by port name, without unconnected ports.
        """

    def memory(self, context: Context) -> dict[str, Any]:
        """The memory after the tick whose results are at the outputs, by name, with the "time" of that tick [s]."""
        memory = dict(self._after(context))
        memory.pop(_START, None)
        return memory

    def held(self, context: Context) -> dict[str, Any]:
        """The memory after the tick before, by name, with the "time" of that tick [s]."""
        return self._unpack(context.get_discrete_state(self._memory).value())

    def last_tick(self, context: Context) -> TickStart:
        """Memory and inputs at the start of the tick whose results are at the outputs; needs `keeps_start`.

        Raises:
            BadInputError: there was no tick yet, or the block does not store them.
        """
        if not self.keeps_start:
            raise BadInputError(
                f"last_tick: a {type(self).__name__} does not keep what its ticks start from; see memory"
            )
        now = context.get_time()
        memory = self.held(context)
        if now - memory["time"] >= self._soonest:
            return TickStart(memory, self._read(context))
        if memory["time"] < 0.0:
            raise BadInputError(f"{self.get_name()}: there was no tick yet at t = {now:g} s")
        start = context.get_discrete_state(self._start).CopyToVector()
        ends = np.cumsum([self._packed_size, *(port.size() for port in self._inputs.values())])
        before, *readings = np.split(start, ends[:-1])
        inputs = dict(zip(self._inputs, readings, strict=True))
        for name, port in self._optional.items():
            if not port.HasValue(context):
                del inputs[name]
        return TickStart(self._unpack(before), inputs)

    def _read(self, context: Context) -> dict[str, Any]:
        inputs = {name: read(context) for name, read in self._readers}
        for name, port in self._optional.items():
            if port.HasValue(context):
                inputs[name] = port.Eval(context)
        return inputs

    def _initial(self, name: str, value: Any) -> Vector:
        """The value of a quantity before the first tick, in the shape that it has in `step`."""
        return np.asarray(value, dtype=float)

    def _unpack(self, packed: Vector) -> dict[str, Any]:
        # A copy: a view that ends up in a cache of the same context would keep that context alive.
        packed = packed.copy()
        memory = dict(zip(self._numbers, packed[: len(self._numbers)].tolist(), strict=True))
        for name, place in self._vectors.items():
            memory[name] = packed[place]
        return memory

    def _pack(self, memory: Memory) -> Vector:
        numbers = [memory[name] for name in self._numbers]
        return np.concatenate([numbers, *(memory[name] for name in self._vectors)])

    def _compute(self, context: Context) -> Memory:
        packed, now = context.get_discrete_state(self._memory).value(), context.get_time()
        memory = self._unpack(packed)
        if now - memory["time"] < self._soonest:
            return memory
        inputs = self._read(context)
        after = self.step(context, memory, inputs)
        after["time"] = now
        if self.keeps_start:
            readings = [inputs.get(name, missing) for name, missing in self._missing.items()]
            after[_START] = np.concatenate([packed, *readings])
        return after

    def _after(self, context: Context) -> Memory:
        if self._now:
            return self._now.Eval(context)
        if self._port is None:
            return self._compute(context)
        value = self._port.Eval(context)
        tick = math.floor(context.get_time() / self._period + 1e-3)
        return {"time": tick * self._period, self._names[0]: value if self._shape or self._vectors else value.item()}

    def _hold(self, context: Context, next_state: DiscreteValues) -> None:
        after = self._after(context)
        next_state.set_value(self._memory, self._pack(after))
        for name, state in self._kept.items():
            next_state.set_value(state, after[name])
        # It is missing in an event that is forced between two ticks, which changes nothing.
        if _START in after:
            next_state.set_value(self._start, after[_START])


class SampledBlock(_Ticks, PythonBlock):
    """Base of sampled blocks: each tick computes a new memory from the last one and the inputs.

    A subclass declares its input ports, its memory and the outputs that `show` it. It implements a tick in `step`,
    where quantities are read and returned by name. In the Context one state vector holds them: the time of the tick,
    then numbers, then vectors. A state group for each quantity would make the tick of a small block 50 % slower;
    `memory` gives them by name.
    """


class SampledBatch(_Ticks, BatchBlock):
    """Base of sampled blocks of n batch elements; their state holds the time of the tick for each element.

    In `step` a quantity that is declared as a number, or with shape (n,), is one batch value, and so is an input of
    shape (n,). A quantity that is declared with shape (k, n) is k batch values, and so is an input of shape (k n,).
    """

    def _initial(self, name: str, value: Any) -> Vector:
        if np.ndim(value) == 2:
            return np.broadcast_to(value, (len(value), self._size)).reshape(-1, *self._shape)
        return batch_values(f"initial {name}", value, self._size).reshape(self._shape)

    def _read(self, context: Context) -> dict[str, Any]:
        if self._scalars:
            inputs = {}
            for name, read in self._readers:
                inputs[name] = read(context).item()
            return inputs
        inputs = super()._read(context)
        if not self._shape:
            return {name: value.tolist() if name in self._wide else value.item() for name, value in inputs.items()}
        for name in self._wide:
            inputs[name] = self.unstack(inputs[name])
        return inputs

    def _unpack(self, packed: Vector) -> dict[str, Any]:
        rows: Any = packed.copy().reshape(-1, *self._shape) if self._shape else packed.tolist()
        memory = dict(zip(self._numbers, rows))  # noqa: B905, the argument takes longer than the rest
        for name, place in self._vectors.items():
            memory[name] = rows[place]
        if self._shape:
            memory["time"] = packed.item(0)
        return memory

    def _pack(self, memory: Memory) -> Vector:
        if not self._shape:
            values = [memory[name] for name in self._numbers]
            for name in self._vectors:
                values.extend(memory[name])
            return np.array(values)
        rows = np.empty((self._packed_size // self._size, self._size))
        for row, name in enumerate(self._numbers):
            rows[row] = memory[name]
        for name, place in self._vectors.items():
            rows[place] = memory[name]
        return rows.ravel()

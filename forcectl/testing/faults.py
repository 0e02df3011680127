"""Faults of a signal between the blocks of any diagram: drop-out, spike, frozen value, noise, NaN.

A fault replaces the value that the readers of a port get. In Drake a value that the context fixes at an input port
takes precedence over the connection of the port. So the diagram is not changed, and all its connections work before and
after the fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, InputPort, System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.inspect.ports import find_inputs, named_outputs, unknown_port
from forcectl.inspect.wiring import PortAddress, Wiring, context_of, is_vector

Change = Callable[[Array], Array]  # of the elements that are faulty, at one tick


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What happens to a signal, and when.

    Attributes:
        start: [s].
        duration: [s]; it begins and ends with a tick of the run.
        index: the element that is faulty; None: all of them.
    """

    start: float = 0.0
    duration: float = np.inf
    index: int | None = None

    def __post_init__(self) -> None:
        if not self.start >= 0:
            raise invalid("start", self.start, "not negative [s]")
        if not self.duration > 0:
            raise invalid("duration", self.duration, "positive [s]")

    def begin(self, value: Array) -> Callable[[], Change]:
        """A function that is called at every tick and returns the change of that tick.

        Args:
            value: of the faulty elements at the first tick.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DropOut(Fault):
    """The signal is zero."""

    def begin(self, value: Array) -> Callable[[], Change]:
        """See `Fault`."""
        return lambda: np.zeros_like


@dataclass(frozen=True, kw_only=True)
class NotANumber(Fault):
    """The signal is NaN."""

    def begin(self, value: Array) -> Callable[[], Change]:
        """See `Fault`."""
        return lambda: lambda value: np.full_like(value, np.nan)


@dataclass(frozen=True, kw_only=True)
class Frozen(Fault):
    """The signal stays at the value that it has at the start of the fault."""

    def begin(self, value: Array) -> Callable[[], Change]:
        """See `Fault`."""
        kept = value.copy()
        return lambda: lambda value: kept


@dataclass(frozen=True)
class Spike(Fault):
    """A constant is added to the signal for a moment.

    Attributes:
        size: the constant, unit of the signal.
        duration: [s]; by default one tick.
    """

    size: float
    duration: float = field(default=1e-9, kw_only=True)

    def begin(self, value: Array) -> Callable[[], Change]:
        """See `Fault`."""
        return lambda: lambda value: value + self.size


@dataclass(frozen=True)
class Noise(Fault):
    """White noise, drawn anew at every tick.

    Attributes:
        std: standard deviation, unit of the signal.
        seed: the same one gives the same noise.
    """

    std: float
    seed: int = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.std > 0:
            raise invalid("std", self.std, "positive, in the unit of the signal")

    def begin(self, value: Array) -> Callable[[], Change]:
        """See `Fault`."""
        draws = np.random.default_rng(self.seed)

        def tick() -> Change:
            noise = draws.normal(0.0, self.std, value.size)
            return lambda value: value + noise

        return tick


class _FaultyPort:
    """A port, its readers and its faults."""

    def __init__(self, wiring: Wiring, name: str, faults: Fault | Sequence[Fault]):
        given: list[Any] = list(faults) if isinstance(faults, list | tuple) else [faults]
        for fault in given:
            if not isinstance(fault, Fault):
                raise invalid(f"faults[{name!r}]", fault, "a fault such as Frozen(start=0.5, duration=0.1), or several")
        self._faults: list[Fault] = given
        self._system = wiring.root
        source, readers = _resolved(wiring, name)
        self._of_root = not source.system
        self._source = wiring.port(source)
        self._readers: list[InputPort] = [wiring.port(reader) for reader in readers]
        if not is_vector(self._source):
            raise invalid("faults", name, "a port with numbers")
        for fault in self._faults:
            if fault.index is not None and not 0 <= fault.index < self._source.size():
                raise invalid(f"faults[{name!r}].index", fault.index, f"0 ... {self._source.size() - 1}")
        self._at_work: dict[int, Callable[[], Change]] = {}
        self._changes: list[tuple[slice, Change]] = []
        self.always_finite = True  # whether all values that readers got so far were finite

    @property
    def has_begun(self) -> bool:
        """Whether any of its faults has begun."""
        return bool(self._at_work)

    def active(self, time: float, period: float) -> frozenset[int]:
        """Indices of the faults that are active in the tick that begins at `time` [s]."""
        slack = 1e-6 * period
        return frozenset(
            i
            for i, fault in enumerate(self._faults)
            if fault.start - slack <= time < max(fault.start + fault.duration, fault.start + period / 2) - slack
        )

    def begin_tick(self, active: frozenset[int], context: Context, fault_free: Context) -> None:
        """Choose what happens to the signal from now to the next tick."""
        self._changes = []
        for i in sorted(active):
            fault = self._faults[i]
            part = slice(None) if fault.index is None else slice(fault.index, fault.index + 1)
            if i not in self._at_work:
                self._at_work[i] = fault.begin(self._value(context, fault_free)[part])
            self._changes.append((part, self._at_work[i]()))

    def apply(self, context: Context, fault_free: Context) -> None:
        """Give the readers the faulty value."""
        if not self._changes:
            return
        value = self._value(context, fault_free).copy()
        for part, change in self._changes:
            value[part] = change(value[part])
        self.always_finite &= bool(np.isfinite(value).all())
        for reader in self._readers:
            reader.FixValue(context_of(reader.get_system(), self._system, context), value)

    def _value(self, context: Context, fault_free: Context) -> Array:
        root = fault_free if self._of_root else context
        return self._source.Eval(context_of(self._source.get_system(), self._system, root))


def _resolved(wiring: Wiring, name: str) -> tuple[PortAddress, list[PortAddress]]:
    """Where the value of a port comes from, and the leaf inputs that read it.

    Raises:
        BadInputError: no port has this name, several have it, nothing is connected to it, or no block reads it.
    """
    outputs = named_outputs(wiring, name)
    ports = outputs or find_inputs(wiring, name)
    if not ports:
        raise unknown_port(wiring, name)
    if len(ports) > 1:
        raise BadInputError(f"port {name!r} is ambiguous: give the block as well, one of {_listed(wiring, ports)}")
    (port,) = ports
    source = port if port.side == "input" and not port.system else wiring.source(port)
    if source is None:
        raise BadInputError(f"port {name!r}: nothing is connected to it, so it can have no fault")
    # An output of the whole diagram has its readers inside.
    named = source if outputs and not port.system else port
    readers = list(dict.fromkeys(wiring.fed_inputs(named) if named.side == "output" else wiring.inner_inputs(named)))
    if not readers:
        raise BadInputError(f"port {name!r}: no block reads it, so a fault would change nothing")
    return source, readers


def _listed(wiring: Wiring, ports: Sequence[PortAddress]) -> str:
    return ", ".join(map(wiring.name, ports))


class FaultyPorts:
    """The faulty ports of a run.

    Args:
        system: any diagram or block.
        faults: one or several by the name of the port, `block.port`: of an output for all of its readers, of an input
            for this one.
        context: the run's, with its inputs fixed.
        period: tick of the run [s].

    Attributes:
        fault_free: a context without faults, for the values of the inputs of the whole diagram.
    """

    def __init__(self, system: System, faults: Mapping[str, Fault | Sequence[Fault]], context: Context, period: float):
        wiring = Wiring(system)
        self._ports = [_FaultyPort(wiring, name, those) for name, those in faults.items()]
        self._period = period
        self._active: list[frozenset[int]] = [frozenset() for _ in self._ports]
        self.fault_free = context.Clone()

    @property
    def has_begun(self) -> bool:
        """Whether any fault has begun."""
        return any(port.has_begun for port in self._ports)

    @property
    def always_finite(self) -> bool:
        """Whether all values that readers got so far were finite."""
        return all(port.always_finite for port in self._ports)

    def begin_tick(self, context: Context) -> Context:
        """The context of the run from this tick on: the same one, or another one where faults begin or end."""
        active = [port.active(context.get_time(), self._period) for port in self._ports]
        ended = any(before - now for before, now in zip(self._active, active, strict=True))
        begun = any(now - before for before, now in zip(self._active, active, strict=True))
        self._active = active
        if ended:  # a fixed value cannot be removed from a context
            clean = self.fault_free.Clone()
            clean.SetTimeStateAndParametersFrom(context)
            context = clean
        elif begun:
            context = context.Clone()
        for port, numbers in zip(self._ports, active, strict=True):
            port.begin_tick(numbers, context, self.fault_free)
        self.apply(context)
        return context

    def apply(self, context: Context) -> None:
        """Give the readers of the faulty ports their faulty values, from the present values."""
        for port in self._ports:
            port.apply(context, self.fault_free)

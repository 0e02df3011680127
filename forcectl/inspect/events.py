"""The periodic events of every block, found by simulating each block alone for a moment.

pydrake does not list declared events. But a simulator with nothing to integrate steps from event to event. The times of
its steps, and the counters that increase there, give kind, period and offset exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, EventStatus, System

from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import is_python_block, is_vector

_STEPS = 48  # number of events that are recorded per block
_HORIZON = 1e4  # [s], longest period that is found
_MOMENT = 1e-9  # [s], shorter than any period


@dataclass(frozen=True)
class PeriodicEvent:
    """One periodic event of one block; times in [s]."""

    block: str
    kind: str  # "discrete", "unrestricted" or "publish"
    period: float
    offset: float


@dataclass(frozen=True)
class Timing:
    """The events of the blocks of a diagram.

    Attributes:
        events: periodic events of all blocks.
        every_step: paths of the blocks with an event at every step of the simulator.
        failures: by path, the error of a block that cannot run alone.
    """

    events: tuple[PeriodicEvent, ...] = ()
    every_step: frozenset[str] = frozenset()
    failures: dict[str, BaseException] = field(default_factory=dict)


def read_timing(values: StartValues) -> Timing:
    """The events of all blocks, found by running each block alone from its start values.

    Drake's own blocks with abstract inputs are not run, as they may have effects outside (visualizers, drivers), except
    those of its primitives.
    """
    events: list[PeriodicEvent] = []
    every_step: set[str] = set()
    failures: dict[str, BaseException] = {}
    for path, system in values.wiring.leaves():
        if isinstance(system, MultibodyPlant) or _acts_outside(system):
            events += _declared(path, system)
            continue
        try:
            busy = _kinds_at_every_step(system, values.block_context(path))
            events += _periodic_events(path, system, values.block_context(path), busy)
            every_step |= {path} if busy else set()
        except FAILURES as failure:
            failures[path] = failure
            events += _declared(path, system)
    return Timing(tuple(events), frozenset(every_step), failures)


def _acts_outside(system: System) -> bool:
    if is_python_block(system) or type(system).__module__.startswith("pydrake.systems.primitives"):
        return False
    return any(not is_vector(system.get_input_port(i, False)) for i in range(system.num_input_ports()))


def _declared(path: str, system: System) -> list[PeriodicEvent]:
    """The periodic update that a block declares, without running it."""
    if isinstance(system, MultibodyPlant):
        # With sampled output ports the whole step is one unrestricted update (known from its measured delay).
        kind = "unrestricted" if system.has_sampled_output_ports() else "discrete"
        return [PeriodicEvent(path, kind, float(system.time_step()), 0.0)] if system.time_step() > 0 else []
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    return [] if timing is None else [PeriodicEvent(path, "discrete", timing.period_sec(), timing.offset_sec())]


def _alone(system: System, context: Context) -> Simulator:
    simulator = Simulator(system, context)
    # One derivative per event: the continuous states do not matter here, and may diverge.
    ApplySimulatorConfig(SimulatorConfig(integration_scheme="explicit_euler", max_step_size=_HORIZON), simulator)
    return simulator


def _counters(simulator: Simulator) -> dict[str, int]:
    """Number of events so far, by kind, in the order that Drake handles them in at one instant."""
    return {
        "unrestricted": simulator.get_num_unrestricted_updates(),
        "discrete": simulator.get_num_discrete_updates(),
        "publish": simulator.get_num_publishes(),
    }


def _kinds_at_every_step(system: System, context: Context) -> set[str]:
    """The kinds of events that occur in a step without any periodic event."""
    simulator = _alone(system, context)
    simulator.Initialize()
    simulator.AdvanceTo(_MOMENT)  # handles the events at time zero
    before = _counters(simulator)
    simulator.AdvanceTo(2 * _MOMENT)
    return {kind for kind, count in _counters(simulator).items() if count > before[kind]}


def _periodic_events(path: str, system: System, context: Context, busy: set[str]) -> Iterator[PeriodicEvent]:
    """The periodic events of one block, except kinds that occur at every step anyway."""
    simulator = _alone(system, context)
    stops: list[tuple[float, dict[str, int]]] = []

    def look(current: Context) -> EventStatus:
        stops.append((current.get_time(), _counters(simulator)))
        return (
            EventStatus.ReachedTermination(system, "seen enough") if len(stops) > _STEPS else EventStatus.DidNothing()
        )

    simulator.set_monitor(look)
    try:
        simulator.Initialize()
        simulator.AdvanceTo(_HORIZON)
    finally:
        simulator.clear_monitor()  # the monitor and the system would otherwise keep each other alive
    for kind in stops[-1][1]:
        if kind not in busy:
            yield from _decompose(_times(stops, kind), kind, path)


def _times(stops: list[tuple[float, dict[str, int]]], kind: str) -> list[float]:
    """Times of the events of one kind. Updates run at the start of the step after a stop, publishes at its end."""
    at_end = kind == "publish"
    times = [stops[0][0]] if at_end and stops[0][1][kind] else []
    for (earlier, before), (later, after) in itertools.pairwise(stops):
        if after[kind] > before[kind]:
            times.append(later if at_end else earlier)
    return times


def _decompose(left: list[float], kind: str, path: str) -> Iterator[PeriodicEvent]:
    """Split times of events into periodic sequences, the earliest and those of shortest period first."""
    while len(left) >= 2:
        offset = left[0]
        for candidate in left[1:]:
            period = _rounded(candidate - offset)
            count = math.floor((left[-1] - offset) / period + 1e-6) + 1
            expected = [offset + k * period for k in range(count)]
            if all(_contains(left, t) for t in expected):
                break
        else:
            return
        yield PeriodicEvent(path, kind, period, _rounded(offset))
        left = [t for t in left if not _contains(expected, t)]


def _contains(times: list[float], wanted: float) -> bool:
    return any(math.isclose(t, wanted, rel_tol=1e-9, abs_tol=1e-9) for t in times)


def _rounded(seconds: float) -> float:
    """A period without its rounding error: 0.004, not 0.0040000000000000036."""
    return float(f"{seconds:.10g}")

"""The periodic events of every block, found out by letting each block run alone for a moment.

pydrake does not list declared events. But a simulator that has nothing to integrate walks from event to event, so
the times at which it stops, and the counters that went up there, tell kind, period and offset exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, EventStatus, System

from forcectl.doctor.report import Finding, PeriodicEvent, error, info, warning
from forcectl.doctor.values import FAILURES, StartValues, one_line
from forcectl.doctor.wiring import is_python_block, is_vector

_STEPS = 48  # events looked at per block
_HORIZON = 1e4  # [s], slowest event that is found
KINDS = ("unrestricted", "discrete", "publish")  # Drake's order at one instant


def periodic_events(values: StartValues, findings: list[Finding]) -> tuple[PeriodicEvent, ...]:
    """The periodic events of all blocks. Blocks that cannot be run alone are added to `findings`."""
    events: list[PeriodicEvent] = []
    for path, system in values.wiring.leaves():
        events += _of_block(values, path, system, findings)
    return tuple(events)


def _failed(values: StartValues, path: str, system: System, failure: BaseException) -> Finding:
    context = values.block_context(path)
    missing = [
        port.get_name()
        for port in (system.get_input_port(i, False) for i in range(system.num_input_ports()))
        if not port.HasValue(context) and port.get_name() not in getattr(system, "optional_inputs", ())
    ]
    if missing:
        return info("timing-unknown", path, f"could not be run to see its events: no value at {', '.join(missing)}")
    what = f"{type(failure).__name__}: {one_line(failure)}"
    return error("update-raises", path, f"its updates fail when the block runs alone from its start values: {what}")


def _of_block(values: StartValues, path: str, system: System, findings: list[Finding]) -> list[PeriodicEvent]:
    if isinstance(system, MultibodyPlant):
        if not system.time_step() > 0:
            return []
        # With sampled output ports the whole step is one unrestricted update (measured by its delay to a controller).
        kind = "unrestricted" if system.has_sampled_output_ports() else "discrete"
        return [PeriodicEvent(path, kind, float(system.time_step()), 0.0)]
    abstract_input = any(not is_vector(system.get_input_port(i, False)) for i in range(system.num_input_ports()))
    if not is_python_block(system) and abstract_input:
        return _declared_discrete(path, system)  # visualizers, drivers: running them has effects outside
    context = values.block_context(path)
    try:
        return events_of(system, context, path)
    except FAILURES as failure:
        findings.append(_failed(values, path, system, failure))
        return _declared_discrete(path, system)


def _declared_discrete(path: str, system: System) -> list[PeriodicEvent]:
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        return []
    return [PeriodicEvent(path, "discrete", timing.period_sec(), timing.offset_sec())]


def events_of(system: System, context: Context, path: str = "") -> list[PeriodicEvent]:
    """Kind, period [s] and offset [s] of each periodic event of one block, its inputs already fixed."""
    simulator = Simulator(system, context)
    # One cheap derivative per event: the continuous states do not matter here, and may diverge.
    ApplySimulatorConfig(SimulatorConfig(integration_scheme="explicit_euler", max_step_size=_HORIZON), simulator)
    stops: list[tuple[float, tuple[int, int, int]]] = []

    def counters() -> tuple[int, int, int]:
        return (
            simulator.get_num_unrestricted_updates(),
            simulator.get_num_discrete_updates(),
            simulator.get_num_publishes(),
        )

    def look(current: Context) -> EventStatus:
        stops.append((current.get_time(), counters()))
        return (
            EventStatus.ReachedTermination(system, "seen enough") if len(stops) > _STEPS else EventStatus.DidNothing()
        )

    simulator.set_monitor(look)
    simulator.Initialize()
    simulator.AdvanceTo(_HORIZON)
    return [event for kind in KINDS for event in _decompose(_times(stops, kind), stops[-1][0], kind, path)]


def _times(stops: list[tuple[float, tuple[int, int, int]]], kind: str) -> list[float]:
    """When events of one kind happened. Updates run at the start of the step after a stop, publishes at its end."""
    index = KINDS.index(kind)
    times = []
    if kind == "publish" and stops[0][1][index]:
        times.append(stops[0][0])
    for (earlier, before), (later, after) in itertools.pairwise(stops):
        if after[index] > before[index]:
            times.append(later if kind == "publish" else earlier)
    return times


def _decompose(times: list[float], end: float, kind: str, path: str) -> list[PeriodicEvent]:
    """Split times of events into periodic sequences, the earliest and fastest first."""
    events = []
    left = list(times)
    while len(left) >= 2:
        offset = left[0]
        for candidate in left[1:]:
            period = _rounded(candidate - offset)
            expected = _lattice(offset, period, left[-1])
            if all(_contains(left, t) for t in expected):
                break
        else:
            break
        events.append(PeriodicEvent(path, kind, period, _rounded(offset)))
        left = [t for t in left if not _contains(expected, t)]
    return events


def _lattice(offset: float, period: float, end: float) -> list[float]:
    return [offset + k * period for k in range(math.floor((end - offset) / period + 1e-6) + 1)]


def _contains(times: list[float], wanted: float) -> bool:
    return any(math.isclose(t, wanted, rel_tol=1e-9, abs_tol=1e-9) for t in times)


def _rounded(seconds: float) -> float:
    """A period as it was written: 0.004, not 0.0040000000000000036."""
    return float(f"{seconds:.10g}")


def timing_findings(events: tuple[PeriodicEvent, ...]) -> Iterator[Finding]:
    """Periods that do not divide each other, and updates that are out of step; publishing is only noted."""
    seen: dict[tuple[str, float, float], PeriodicEvent] = {}
    for event in events:
        role = "publish" if event.kind == "publish" else "update"
        seen.setdefault((role, event.period, event.offset), event)
    unique = list(seen.values())
    for i, first in enumerate(unique):
        for second in unique[i + 1 :]:
            yield from _compare(first, second)


def _compare(a: PeriodicEvent, b: PeriodicEvent) -> Iterator[Finding]:
    finding = info if "publish" in (a.kind, b.kind) else warning
    where = f"{a.block}, {b.block}"
    slow, fast = max(a.period, b.period), min(a.period, b.period)
    ratio = slow / fast
    if abs(ratio - round(ratio)) > 1e-6 * ratio:
        yield finding(
            "periods-do-not-divide",
            where,
            f"periods {a.period:g} s and {b.period:g} s: {slow:g}/{fast:g} = {ratio:.6g} is no whole number, so the "
            f"samples drift against each other; {round(ratio)} x {fast:g} = {round(ratio) * fast:g} s would divide",
        )
        return
    shift = (a.offset - b.offset) / fast
    if abs(shift - round(shift)) > 1e-6:
        yield finding(
            "offsets-differ",
            where,
            f"offsets {a.offset:g} s and {b.offset:g} s at periods {a.period:g} s and {b.period:g} s never meet at one "
            "instant; use the same offset unless the delay in between is meant",
        )

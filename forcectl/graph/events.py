"""The sample times of a Drake block, from outside.

pydrake binds no list of a system's periodic events; only a unique discrete update can be asked for. The other kinds
(unrestricted updates, publishing) show themselves in the time at which a simulator of that block alone stops next.
No callback of the block runs while it is asked: the simulator is stopped at the event, and a callback that would run
first (publishing) is refused entry by a profile hook and tells the time by being refused.
"""

from __future__ import annotations

import math
import sys
import types
from dataclasses import dataclass

from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus, System
from pydrake.systems.primitives import VectorLogSink

_EVENTS_LOOKED_AT = 24
_FAR = 1.0e4  # [s]: an event later than this is not looked for
_BEFORE_START = -1.0  # [s]: no periodic event is earlier than zero


@dataclass(frozen=True, order=True)
class SampleTime:
    """One periodic event of a block.

    Attributes:
        period: [s], > 0.
        offset: [s], time of the first event.
    """

    period: float
    offset: float = 0.0


class _CallbackRefused(Exception):
    """Raised in place of a block's callback."""


def sample_times(system: System) -> tuple[SampleTime, ...]:
    """The periodic events of one leaf system, fastest first; empty for a diagram and for a block without any.

    Events that coincide with those of a faster one of the same block are not told apart from it.
    """
    if isinstance(system, Diagram):
        return ()
    found: set[SampleTime] = set()
    unique = system.GetUniquePeriodicDiscreteUpdateAttribute()
    if unique is not None:
        found.add(SampleTime(unique.period_sec(), unique.offset_sec()))
    elif (stated := _stated_period(system)) is not None:
        found.add(SampleTime(stated))
    if _written_in_python(system) or isinstance(system, VectorLogSink):
        known = [event.period for event in found]
        seen = _progressions(_event_times(system))
        found |= {event for event in seen if not any(math.isclose(event.period, p, rel_tol=1e-6) for p in known)}
    return tuple(sorted(found))


def runs_every_step(system: System) -> bool:
    """True for a Python block with an event at every step of the simulator."""
    return _written_in_python(system) and _next_event(system, _BEFORE_START) == _BEFORE_START


def _stated_period(system: System) -> float | None:
    """The period a C++ block tells through an accessor, [s]."""
    for name in ("time_step", "time_period", "period"):
        accessor = getattr(system, name, None)
        if callable(accessor) and not _written_in_python(system):
            value = float(accessor())
            return value if value > 0 and math.isfinite(value) else None
    return None


def _written_in_python(system: System) -> bool:
    return any(isinstance(vars(cls).get("__init__"), types.FunctionType) for cls in type(system).__mro__)


def _event_times(system: System) -> list[float]:
    """The first event times of the block, [s]."""
    times: list[float] = []
    start = _BEFORE_START
    while len(times) < _EVENTS_LOOKED_AT:
        time = _next_event(system, start)
        if time is None or time <= start:
            break
        times.append(time)
        start = time + 1.0e-9 * max(1.0, abs(time))
    return times


def _next_event(system: System, start: float) -> float | None:
    """Time of the next timed event after `start` [s]; `start` itself for an every-step event; None if there is none."""
    context = system.CreateDefaultContext()
    context.SetTime(start)
    simulator = Simulator(system, context)
    if context.num_continuous_states() > 0:
        _let_it_integrate(system, context, simulator)
    parameters = InitializeParams(suppress_initialization_events=True)
    probe = id(sys._getframe())  # not the frame itself: that ring would keep the simulator, and so the system, alive

    def stop(_: Context) -> EventStatus:
        return EventStatus.ReachedTermination(system, "next event found")

    def refuse(frame: types.FrameType, event: str, _: object) -> None:
        called_by_drake = event == "call" and id(frame.f_back) == probe
        if called_by_drake and frame.f_code is not stop.__code__ and frame.f_code.co_name != "DoCalcTimeDerivatives":
            raise _CallbackRefused

    simulator.set_monitor(stop)
    previous = sys.getprofile()
    sys.setprofile(refuse)
    try:
        simulator.Initialize(parameters)
        simulator.AdvanceTo(start + _FAR)
    except _CallbackRefused:
        pass
    except Exception:  # an input that is not connected here: the time reached still tells the event
        if context.get_time() == start:
            return None
    finally:
        sys.setprofile(previous)
        simulator.clear_monitor()  # a monitor that knows the system would keep both alive for ever
    time = float(context.get_time())
    return None if time >= start + _FAR else time


def _let_it_integrate(system: System, context: Context, simulator: Simulator) -> None:
    """Give a block with continuous state what a step up to its next event needs; the state itself is of no interest."""
    for index in range(system.num_input_ports()):
        port = system.get_input_port(index)
        port.FixValue(context, port.Allocate())
    integrator = simulator.get_mutable_integrator()
    integrator.set_maximum_step_size(2.0 * _FAR)
    integrator.set_fixed_step_mode(True)


def _progressions(times: list[float]) -> list[SampleTime]:
    """Explain event times by as few periods as possible; every period must recur through the whole window."""
    found: list[SampleTime] = []
    left = list(times)
    while left:
        # A second event of the block usually shares the first instant with the faster one, so that is tried first.
        shared = [SampleTime(left[0] - times[0], times[0])] if found else []
        candidates = [*shared, *(SampleTime(time - left[0], left[0]) for time in left[1:])]
        event = next((event for event in candidates if _recurs(event, times)), None)
        if event is None:
            left.pop(0)
            continue
        found.append(SampleTime(float(f"{event.period:.9g}"), float(f"{event.offset:.9g}")))
        left = [time for time in left if time < event.offset or not _is_multiple(time - event.offset, event.period)]
    return found


def _recurs(event: SampleTime, times: list[float]) -> bool:
    count = int((times[-1] - event.offset) / event.period + 1e-6)
    wanted = [event.offset + k * event.period for k in range(count + 1)]
    return len(wanted) >= 2 and all(any(abs(time - want) < 1e-7 for time in times) for want in wanted)


def _is_multiple(distance: float, period: float) -> bool:
    return abs(distance / period - round(distance / period)) < 1e-5

"""The delay between two ports of a diagram, measured by a step at one and the response at the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Context, System

from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.inspect.delay import ends_of_way
from forcectl.inspect.events import read_timing
from forcectl.inspect.ports import PortName
from forcectl.inspect.schedule import clean, instants
from forcectl.inspect.start import StartValues, fix_open_inputs
from forcectl.inspect.ways import Hops
from forcectl.inspect.wiring import Wiring, context_of, is_vector

_ROUNDING = 1e-12  # rounding error relative to the largest value of a signal


def measure_delay(
    system: System,
    source: PortName,
    target: PortName,
    *,
    tick: float,
    amplitude: ArrayLike = 1.0,
    start: float = 0.0,
    longest: float = 1.0,
    threshold: float | None = None,
    context: Context | None = None,
) -> float | None:
    """The time from a step at one port until another port differs from a run without the step.

    The step comes just before the updates at `start`. The target is read every `tick`, just before the updates of that
    instant, as a discrete block of period `tick` would read it. Feedthrough gives 0, one sampled block its period. A
    continuous filter responds a little already at the first tick: `threshold` sets the smallest response that counts.
    Where `source` is inside of the system, its readers are held at its value from `start` on, in both runs: a loop
    through it is opened there.

    Args:
        system: any diagram or block.
        source: a vector port by name or path, of the system or of a block inside. Where nothing on the path reads this
            output, the step is applied to the port that it is computed from.
        target: a vector output by name or path.
        tick: resolution [s], usually the control period.
        amplitude: size of the step in the unit of the source, not zero; one number, or one for each element. An equal
            step of all joints may leave the contact force unchanged.
        start: time of the step after the time of the context [s], a multiple of `tick`; it matters where periods
            differ.
        longest: longest delay that is measured, from `start` on [s].
        threshold: largest difference that counts as no response, in the unit of the target. Default: 1e-12 of the
            largest value of any of its elements since the step, which is within rounding errors.
        context: start of both runs; default: the default context. Unconnected vector inputs are held at zero.

    Returns:
        The delay [s], or None without a response.

    Raises:
        BadInputError: unknown port, abstract port, or a value out of range.
    """
    check("tick", tick, "positive")
    for name, given in {"start": start, "longest": longest, "threshold": threshold or 0.0}.items():
        check(name, given, "not negative")
    if not (np.isfinite(amplitude).all() and np.any(amplitude)):
        raise invalid("amplitude", amplitude, "finite numbers, not all zero: there is no step to measure with")
    wiring = Wiring(system)
    hops = Hops(wiring, read_timing(StartValues(wiring)).events)
    first, end = ends_of_way(hops, source, target)
    watched = wiring.port(end)
    for port in (*map(wiring.port, first.readers), watched):
        if not is_vector(port):
            raise invalid("port", port.get_name(), "a vector port: a step of an abstract value has no meaning")
    sizes = [wiring.port(port).size() for port in first.readers]
    if any(np.shape(amplitude) not in ((), (size,)) for size in sizes):
        raise invalid("amplitude", amplitude, f"a number, or one for each of {sizes[0]} elements")

    runs = []
    for _ in range(2):
        own = system.CreateDefaultContext() if context is None else context.Clone()
        fix_open_inputs(wiring, own)
        runs.append(Simulator(system, own))
        # In a context that has already run, initialisation events must not be repeated.
        runs[-1].Initialize(InitializeParams(suppress_initialization_events=own.get_time() > 0))
        times = instants(own.get_time() + start, tick, round(longest / tick) + 1)
        if start > 0:
            runs[-1].AdvanceTo(times[0])
    for run, step in zip(runs, (0.0, np.asarray(amplitude)), strict=True):
        for reader in first.readers:
            block, port = wiring.systems[reader.system], wiring.port(reader)
            here = context_of(block, system, run.get_mutable_context())
            value = port.Eval(here) if port.HasValue(here) else np.zeros(port.size())
            port.FixValue(here, value + step)
    contexts = [context_of(wiring.systems[end.system], system, run.get_context()) for run in runs]
    largest = 0.0
    for k, time in enumerate(times):
        if k > 0:  # at k = 0 AdvanceTo would already perform the updates of this instant
            for run in runs:
                run.AdvanceTo(time)
        values = np.array([watched.Eval(each) for each in contexts])
        largest = max(largest, np.abs(values[np.isfinite(values)]).max(initial=0.0))
        if np.any(np.abs(np.diff(values, axis=0)) > (_ROUNDING * largest if threshold is None else threshold)):
            return clean(k * tick)
    return None

"""The delay between two ports of a diagram, measured from outside: step one and watch the other."""

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

_ROUNDING = 1e-12  # of the size of a signal


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
    """Time from a step at one port until another port differs from a run without the step.

    The step comes just before the updates at `start`; the target is read every `tick` just before the updates of
    that instant, as a discrete block of period `tick` would read it. A feedthrough gives 0, one sampled block its
    period. A continuous filter on the way answers at the first tick, if only by little: give a `threshold` to ask for
    a visible answer. Where `source` is inside of the system, its readers are held at its value from `start` on, in both
    runs: a loop that is closed over it is cut open there.

    Args:
        system: any diagram or block.
        source: a vector port by name or path, of the system or of a block inside; where nothing on the way reads this
            output, what it is computed from is stepped.
        target: a vector output, likewise.
        tick: resolution [s], usually the control period.
        amplitude: size of the step, unit of the source, not zero, of all elements or of each: a step of all joints
            alike may leave the contact force as it is.
        start: when the step comes, after the time of the context [s], a multiple of `tick`; matters where periods
            differ.
        longest: when to give up, after `start` [s].
        threshold: largest difference that still counts as no answer, unit of the target; default 1e-12 of the largest
            value that any of its elements has had since the step, which is no more than rounding.
        context: where both runs start; default the default context. Open vector inputs are held at zero.

    Returns:
        The delay [s], or None when nothing changed.

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
        # A context that has already run must not go through the initialisation events once more.
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
        if k > 0:  # at k = 0 AdvanceTo would already carry out the updates of this instant
            for run in runs:
                run.AdvanceTo(time)
        values = np.array([watched.Eval(each) for each in contexts])
        largest = max(largest, np.abs(values[np.isfinite(values)]).max(initial=0.0))
        if np.any(np.abs(np.diff(values, axis=0)) > (_ROUNDING * largest if threshold is None else threshold)):
            return clean(k * tick)
    return None

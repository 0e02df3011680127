"""Blocks that do not repeat themselves: memory outside of the Context, random numbers, clocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import System

from forcectl.doctor.report import Finding, warning
from forcectl.inspect.events import Timing
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import PortAddress, is_python_block, is_vector

_SAMPLES = 4
_PLAIN = (bool, int, float, complex, str, list, tuple, dict, set, np.ndarray, np.generic)  # types that are compared


def not_repeatable(values: StartValues, timing: Timing) -> Iterator[Finding]:
    """Python blocks that give different outputs in two runs from the same start values, each in a Context of its own.

    Vector inputs are one more than at the start, so that an integral has something to add up, or as they are there
    where the block cannot be run with that.
    """
    for path, system in values.wiring.leaves():
        if not is_python_block(system) or path in timing.failures:
            continue
        outputs = [output for output in values.wiring.outputs(path) if is_vector(values.wiring.port(output))]
        ticks = [(event.offset, event.period) for event in timing.events if event.block == path]
        offset, period = max(ticks, key=lambda tick: tick[1], default=(0.0, 0.0))
        times = [offset + k * period for k in range(1, _SAMPLES + 1)] if period else []
        for more in (1.0, 0.0):
            try:
                before = _attributes(system)
                first, second = (_run(values, path, outputs, times, more) for _ in range(2))
                after = _attributes(system)
            except FAILURES:
                continue
            pairs = zip(outputs, first, second, strict=True)
            if changed := [values.wiring.port(port).get_name() for port, a, b in pairs if a != b]:
                kept = ", ".join(name for name, value in after.items() if before.get(name) != value)
                yield warning(
                    "not-repeatable",
                    path,
                    f"two runs from the same start give different {', '.join(changed)}: it remembers something outside "
                    f"of its Context{f' (attributes that changed: {kept})' if kept else ''}, draws random numbers or "
                    "reads a clock",
                )
            break


def _run(
    values: StartValues, path: str, outputs: list[PortAddress], times: list[float], more: float
) -> list[list[bytes]]:
    """The bits of each output at the start, or at the times of a run."""
    system, context = values.wiring.systems[path], values.block_context(path)
    for address in values.wiring.inputs(path) if more else ():
        port = values.wiring.port(address)
        if is_vector(port) and port.HasValue(context):
            port.FixValue(context, port.Eval(context) + more)
    ports = [values.wiring.port(output) for output in outputs]
    if not times:
        return [[port.Eval(context).tobytes()] for port in ports]
    simulator = Simulator(system, context)
    simulator.Initialize()
    found: list[list[bytes]] = [[] for _ in ports]
    for time in times:
        simulator.AdvanceTo(time)
        for bits, port in zip(found, ports, strict=True):
            bits.append(port.Eval(context).tobytes())
    return found


def _attributes(system: System) -> dict[str, str]:
    """What the attributes of a block show, those of plain types only."""
    return {name: repr(value) for name, value in vars(system).items() if isinstance(value, _PLAIN)}

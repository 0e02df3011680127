"""Blocks that are not repeatable: memory outside of the Context, random numbers, clocks."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, System

from forcectl.doctor.report import Finding, warning
from forcectl.inspect.events import Timing
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import PortAddress, Wiring, is_python_block, is_vector

_SAMPLES = 4
_PERIOD = 0.01  # [s], time between samples of a block without a period
_PLAIN = (bool, int, float, complex, str, list, tuple, dict, set, np.ndarray, np.generic)  # types that are compared


def not_repeatable(values: StartValues, timing: Timing) -> Iterator[Finding]:
    """Python blocks with different outputs in two runs from the same start values, each in a Context of its own.

    Vector inputs are the start values plus one, so that an integrator has an input other than zero. Where a block
    cannot run with these, they are the start values.
    """
    for path, system in values.wiring.leaves():
        if not is_python_block(system) or path in timing.failures:
            continue
        outputs = values.wiring.outputs(path)
        ticks = [(event.offset, event.period) for event in timing.events if event.block == path]
        offset, period = max(ticks, key=lambda tick: tick[1], default=(0.0, _PERIOD))
        times = [offset + k * period for k in range(1, _SAMPLES + 1)]
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
                    f"two runs from the same start give different {', '.join(changed)}: it keeps state outside "
                    f"of its Context{f' (attributes that changed: {kept})' if kept else ''}, draws random numbers or "
                    "reads a clock",
                )
            break


def _run(
    values: StartValues, path: str, outputs: list[PortAddress], times: list[float], more: float
) -> list[list[str]]:
    """The value of each output at the times of a run, as text."""
    system, context = values.wiring.systems[path], values.block_context(path)
    for address in values.wiring.inputs(path) if more else ():
        port = values.wiring.port(address)
        if is_vector(port) and port.HasValue(context):
            port.FixValue(context, port.Eval(context) + more)
    simulator = Simulator(system, context)
    # An error-controlled integrator would not end where a derivative is NaN.
    config = SimulatorConfig(integration_scheme="explicit_euler", max_step_size=times[1] - times[0])
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    found: list[list[str]] = [[] for _ in outputs]
    for time in times:
        simulator.AdvanceTo(time)
        for shown, output in zip(found, outputs, strict=True):
            shown.append(_shown(values.wiring, output, context))
    return found


def _shown(wiring: Wiring, output: PortAddress, context: Context) -> str:
    """The bits of a vector, or the text of a value of a plain type; "" for other values."""
    port = wiring.port(output)
    value = port.Eval(context)
    return value.tobytes().hex() if is_vector(port) else _plain(value)


def _plain(value: object) -> str:
    return re.sub(r" at 0x[0-9a-f]+", "", repr(value)) if isinstance(value, _PLAIN) else ""


def _attributes(system: System) -> dict[str, str]:
    """The values of a block's attributes as text, for plain types only."""
    return {name: _plain(value) for name, value in vars(system).items()}

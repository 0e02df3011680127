"""Time per tick of the command governor, one lane, in a diagram that does nothing else.

The force changes at every tick, as in a loop. The time of the same diagram without a governor is subtracted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

PERIOD, TICKS = 0.002, 2000


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.control.governor import CommandGovernor

    governors: dict[str, tuple[Callable[[], Any] | None, str]] = {
        "without a governor": (None, ""),
        "closed form, delay of 40 ticks": (lambda: CommandGovernor(1), "<= 20"),
        "closed form with limits": (lambda: CommandGovernor(1, upper_limit=40.0, rate_limit=1e3), ""),
        "closed form, delay of 160 ticks": (lambda: CommandGovernor(1, delay=0.32), ""),
        "quadratic program, horizon of 10 ticks": (lambda: CommandGovernor(1, horizon=10, upper_force=25.0), ""),
    }
    times = interleaved_medians([_run(make) for make, _ in governors.values()], max(5, repeats))
    for (name, (make, required)), spent in zip(governors.items(), times, strict=True):
        value = spent if make is None else spent - times[0]
        note = "" if make is None else "per tick, less the line above" if required else "per tick, less the first line"
        yield Row(name, 1e6 * value / TICKS, "us", required=required, note=note)


def _run(make: Callable[[], Any] | None) -> Callable[[], None]:
    """Advances the governor, fed with a force that decays, by `TICKS` ticks."""
    import numpy as np
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, ZeroOrderHold

    builder = DiagramBuilder()
    measured = builder.AddSystem(LinearSystem([[0.999]], np.zeros((1, 0)), [[12.0]], np.zeros((1, 0)), PERIOD))
    measured.configure_default_state([1.0])
    hold = builder.AddSystem(ZeroOrderHold(PERIOD, 1))
    if make is None:
        builder.Connect(measured.get_output_port(), hold.get_input_port())
    else:
        governor = builder.AddSystem(make())
        desired = builder.AddSystem(ConstantVectorSource([20.0]))
        builder.Connect(desired.get_output_port(), governor.GetInputPort("desired_force"))
        builder.Connect(measured.get_output_port(), governor.GetInputPort("measured_force"))
        builder.Connect(governor.GetOutputPort("governed_reference"), hold.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)

    def run() -> None:
        simulator.reset_context(diagram.CreateDefaultContext())
        simulator.Initialize()
        simulator.AdvanceTo(TICKS * PERIOD)

    return run


if __name__ == "__main__":
    main("Command governor", benchmark)

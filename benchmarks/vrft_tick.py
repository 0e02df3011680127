"""Time per tick of the law that VRFT tunes and of recursive VRFT, a batch of one each, in a diagram that does nothing
else.

The force and the displacement change at every tick. The time of the same diagram without the block is subtracted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main
from benchmarks._ticks import PERIOD, Case, tick_rows, ticking

GAINS = (-5.37e-5, -2.53e-4, 1.62e-8)


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.estimation.excited_compliance import ExcitedCompliance
    from forcectl.estimation.recursive_vrft import RecursiveVrft
    from forcectl.force.linear_law import LinearForceLaw

    blocks: dict[str, Case] = {
        "without a block": (None, ""),
        "linear law, PID": (
            lambda: LinearForceLaw(1, gains=GAINS, robot_compliance=3e-5, derivative_filter=0.004, lower_limit=-0.1),
            "<= 20",
        ),
        "recursive VRFT, without prefilter": (lambda: RecursiveVrft(1, prefilter=False, always=True), "<= 20"),
        "recursive VRFT, with prefilter": (lambda: RecursiveVrft(1, always=True), "<= 20"),
        "compliance from moves of the reference": (lambda: ExcitedCompliance(1, initial_compliance=1e-5), "<= 20"),
    }
    yield from tick_rows(blocks, _run, repeats)


def _run(make: Callable[[], Any] | None) -> Callable[[], None]:
    """Advances the block, fed with signals that turn and decay, by `TICKS` ticks."""
    import numpy as np
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import LinearSystem, ZeroOrderHold

    builder = DiagramBuilder()
    turn = 0.999 * np.array([[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]])
    sources = {
        name: builder.AddSystem(LinearSystem(turn, np.zeros((2, 0)), [row], np.zeros((1, 0)), PERIOD))
        for name, row in {
            "measured_force": [12.0, 0.0],
            "controller_output": [0.0, 1e-3],
            "displacement": [0.0, 1e-3],
            "desired_force": [9.0, 9.0],
        }.items()
    }
    for source in sources.values():
        source.configure_default_state([1.0, 0.0])
    block = None if make is None else builder.AddSystem(make())
    for name, source in sources.items():
        if block is not None and block.HasInputPort(name):
            builder.Connect(source.get_output_port(), block.GetInputPort(name))
    read = builder.AddSystem(ZeroOrderHold(PERIOD, 1))
    output = sources["measured_force"] if block is None else block
    builder.Connect(output.get_output_port(0), read.get_input_port())
    return ticking(builder.Build())


if __name__ == "__main__":
    main("Laws that VRFT tunes", benchmark)

"""What the benchmarks of blocks share: time per tick of a block in a diagram that does nothing else.

Its inputs change at every tick, as in a loop. The time of the same diagram without the block is subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks._measure import Row, interleaved_medians

PERIOD, TICKS = 0.002, 2000

# Makes the block, or None for the diagram without one, and the limit on its time.
Case = tuple[Callable[[], Any] | None, str]


def tick_rows(
    cases: Mapping[str, Case], runner: Callable[[Callable[[], Any] | None], Callable[[], None]], repeats: int
) -> Iterator[Row]:
    """One row per case [us]; the first case is the diagram without a block."""
    times = interleaved_medians([runner(make) for make, _ in cases.values()], max(5, repeats))
    for (name, (make, required)), spent in zip(cases.items(), times, strict=True):
        value = spent if make is None else spent - times[0]
        note = "" if make is None else "per tick, less the first line"
        yield Row(name, 1e6 * value / TICKS, "us", required=required, note=note)


def ticking(diagram: Any) -> Callable[[], None]:
    """A function that advances the diagram from its start by `TICKS` ticks."""
    from pydrake.systems.analysis import Simulator

    simulator = Simulator(diagram)

    def run() -> None:
        simulator.reset_context(diagram.CreateDefaultContext())
        simulator.Initialize()
        simulator.AdvanceTo(TICKS * PERIOD)

    return run


def under_a_decaying_force(
    make: Callable[[], Any] | None, output: str, desired_force: Sequence[float] = (15.0,)
) -> Callable[[], None]:
    """Advances a block with the inputs desired_force and measured_force; `output` names what is read of it."""
    import numpy as np
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, ZeroOrderHold

    builder = DiagramBuilder()
    measured = builder.AddSystem(LinearSystem([[0.999]], np.zeros((1, 0)), [[12.0]], np.zeros((1, 0)), PERIOD))
    measured.configure_default_state([1.0])
    hold = builder.AddSystem(ZeroOrderHold(PERIOD, 1))
    if make is None:
        builder.Connect(measured.get_output_port(), hold.get_input_port())
    else:
        block = builder.AddSystem(make())
        desired = builder.AddSystem(ConstantVectorSource(list(desired_force)))
        builder.Connect(desired.get_output_port(), block.GetInputPort("desired_force"))
        builder.Connect(measured.get_output_port(), block.GetInputPort("measured_force"))
        builder.Connect(block.GetOutputPort(output), hold.get_input_port())
    return ticking(builder.Build())

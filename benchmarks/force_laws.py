"""Time per tick of the scalar force laws, one lane each, in a diagram that does nothing else.

The force changes at every tick, as in a loop. The time of the same diagram without a law is subtracted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

PERIOD, TICKS, COMPLIANCE = 0.002, 2000, 2e-4


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.control.fourth_degree_force_law import FourthDegreeForceLaw
    from forcectl.control.integral import IntegralForceLaw
    from forcectl.control.invariance_control import InvarianceControl, InvarianceCorrection
    from forcectl.control.invariance_force_law import InvarianceForceLaw

    def integral() -> IntegralForceLaw:
        return IntegralForceLaw(1, integral_gain=3.0, compliance=COMPLIANCE)

    laws: dict[str, tuple[Callable[[], Any] | None, str]] = {
        "without a law": (None, ""),
        "integral": (integral, ""),
        "invariance [57]": (lambda: InvarianceForceLaw(1, compliance=COMPLIANCE), "<= 20"),
        "invariance control [56], with its integral law": (
            lambda: InvarianceControl(integral(), InvarianceCorrection(1, compliance=COMPLIANCE)),
            "",
        ),
        "invariance of degree 4": (
            lambda: FourthDegreeForceLaw(1, gamma=-1e5, alpha=3.0, bandwidth=12.6, compliance=COMPLIANCE),
            "",
        ),
    }
    times = interleaved_medians([_run(make) for make, _ in laws.values()], max(5, repeats))
    for (name, (make, required)), spent in zip(laws.items(), times, strict=True):
        value = spent if make is None else spent - times[0]
        note = "" if make is None else "per tick, less the line above"
        yield Row(name, 1e6 * value / TICKS, "us", required=required, note=note)


def _run(make: Callable[[], Any] | None) -> Callable[[], None]:
    """Advances the law, fed with a force that decays, by `TICKS` ticks."""
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
        law = builder.AddSystem(make())
        desired = builder.AddSystem(ConstantVectorSource([15.0]))
        builder.Connect(desired.get_output_port(), law.GetInputPort("desired_force"))
        builder.Connect(measured.get_output_port(), law.GetInputPort("measured_force"))
        builder.Connect(law.GetOutputPort("displacement_command"), hold.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)

    def run() -> None:
        simulator.reset_context(diagram.CreateDefaultContext())
        simulator.Initialize()
        simulator.AdvanceTo(TICKS * PERIOD)

    return run


if __name__ == "__main__":
    main("Force laws", benchmark)

"""Cost of the multibody closed loop divided by that of its bare plant, in one process and in turns.

The bare plant is the very one of the station, pressing with the same 15 N: same step, solver, joint springs and
contact, with the motor side held still and nothing else in the diagram. Both start at rest in contact: the loop is
first simulated until it has settled.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

SETTLED, DURATION = 3.0, 2.0  # [s]


def _prepare() -> tuple[Callable[[], None], Callable[[], None], Callable[[], float]]:
    import numpy as np
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    from benchmarks._loops import build
    from forcectl.diagrams.station import describe
    from forcectl.diagrams.station_multibody import add_plant

    loop = build("Multibody")
    settled = Simulator(loop.diagram)
    settled.AdvanceTo(SETTLED)
    station = loop.diagram.GetSubsystemByName("station")
    station_context = station.GetMyContextFromRoot(settled.get_context())
    motors = station.GetOutputPort("motor_position").Eval(station_context)
    links = station.GetOutputPort("link_position").Eval(station_context)

    builder = DiagramBuilder()
    plant, _, parts, weld = add_plant(builder, describe(loop.cell.config))
    bare = builder.Build()
    context = bare.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    still = np.concatenate([motors, np.zeros(len(motors))])
    plant.get_desired_state_input_port(parts.instance).FixValue(plant_context, still)
    plant.SetPositions(plant_context, links)
    alone = Simulator(bare, context)
    alone.Initialize()

    def force() -> float:
        """What the weld of the environment carries [N]."""
        row = list(plant.GetJointIndices()).index(weld.index())
        forces = plant.get_reaction_forces_output_port().Eval(plant_context)
        return float(np.linalg.norm(forces[row].translational()))

    def step_alone() -> None:
        alone.AdvanceTo(context.get_time() + DURATION)

    def step_loop() -> None:
        settled.AdvanceTo(settled.get_context().get_time() + DURATION)

    return step_alone, step_loop, force


def benchmark(repeats: int) -> Iterator[Row]:
    step_alone, step_loop, force = _prepare()
    alone, closed = interleaved_medians([step_alone, step_loop], repeats)
    yield Row("contact force of the bare plant", force(), "N", note="both press with about 15 N")
    yield Row("bare plant", DURATION / alone, "x real time")
    yield Row("closed loop", DURATION / closed, "x real time", ">= 5", "15")
    yield Row("closed loop / bare plant", closed / alone, "x", "<= 3", "1.3")


if __name__ == "__main__":
    main("Closed loop beside its plant", benchmark, repeats=9)

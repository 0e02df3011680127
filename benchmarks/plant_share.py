"""Cost of the multibody closed loop divided by that of its bare plant, in one process and in turns.

The bare plant is the very one of the station, pressing with the same 15 N: same step, solver, joint springs and
contact, and nothing else in the diagram but the source of its motor positions. It is stepped twice: through the motion
that the loop has made, which costs the contact solver what it costs in the loop, and held still, where the solver
starts from its solution and has nothing left to do.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

SETTLED, DURATION = 3.0, 2.0  # [s]


def _prepare() -> tuple[list[Callable[[], None]], Callable[[], float]]:
    import numpy as np
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import TrajectorySource
    from pydrake.trajectories import PiecewisePolynomial

    from benchmarks._loops import build
    from forcectl.diagrams.mechanics.world import add_world

    loop = build("Multibody")
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(SETTLED)
    begin = simulator.get_context().Clone()
    station = loop.diagram.GetSubsystemByName("station")
    links = station.GetOutputPort("link_position").Eval(station.GetMyContextFromRoot(begin))
    simulator.AdvanceTo(SETTLED + DURATION)
    log = loop.sink.FindLog(simulator.get_context())
    motors = log.data()[loop.signals["motor_position"].rows]
    moving = PiecewisePolynomial.FirstOrderHold(log.sample_times(), motors)
    still = PiecewisePolynomial(motors[:, log.sample_times().searchsorted(SETTLED)])

    def replay(motion: PiecewisePolynomial) -> tuple[Callable[[], None], Callable[[], float]]:
        builder = DiagramBuilder()
        site = add_world(builder, loop.workcell, 0)
        plant, parts, (weld,) = site.plant, site.parts, site.mountings
        source = builder.AddSystem(TrajectorySource(motion, output_derivative_order=1))
        builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(parts.instance))
        alone = Simulator(builder.Build())
        context = alone.get_mutable_context()
        plant_context = plant.GetMyMutableContextFromRoot(context)

        def step() -> None:
            context.SetTime(SETTLED)
            plant.SetPositions(plant_context, links)
            plant.SetVelocities(plant_context, np.zeros(len(links)))
            alone.Initialize()
            alone.AdvanceTo(SETTLED + DURATION)

        def force() -> float:
            row = list(plant.GetJointIndices()).index(weld.index())
            forces = plant.get_reaction_forces_output_port().Eval(plant_context)
            return float(np.linalg.norm(forces[row].translational()))

        return step, force

    def close() -> None:
        simulator.get_mutable_context().SetTimeStateAndParametersFrom(begin)
        simulator.Initialize()
        simulator.AdvanceTo(SETTLED + DURATION)

    (move, force), (hold, _) = replay(moving), replay(still)
    return [move, hold, close], force


def benchmark(repeats: int) -> Iterator[Row]:
    steps, force = _prepare()
    moving, still, closed = interleaved_medians(steps, repeats)
    yield Row("contact force of the bare plant", force(), "N", note="both press with about 15 N")
    yield Row("bare plant, the loop's motion", DURATION / moving, "x real time")
    yield Row("bare plant, held still", DURATION / still, "x real time")
    yield Row("closed loop", DURATION / closed, "x real time", ">= 5", "15")
    yield Row("closed loop / bare plant, same motion", closed / moving, "x", "<= 3", "1.3")
    yield Row("closed loop / bare plant held still", closed / still, "x", note="no solver iterations in the plant")


if __name__ == "__main__":
    main("Closed loop beside its plant", benchmark, repeats=9)

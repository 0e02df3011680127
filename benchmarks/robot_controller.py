"""The invariance controller of the six-axis robot, tick by tick: kinematics, constraints, quadratic program, all of it.

What is timed is one `AdvanceTo` of 2 ms from Python of a diagram that holds the controller and its references only, the
call and Drake's events included: steps of the force up and down during motion along the surface, with limits of joint
positions, speeds, accelerations and torques, a maximum force and a wall.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

TICKS, SKIPPED = 1000, 50


def benchmark(repeats: int) -> Iterator[Row]:
    import numpy as np
    from pydrake.systems.analysis import Simulator

    from forcectl.force.invariance.robot import InvarianceRobotConfig
    from forcectl.tasks.constraints.parts import WallConfig

    wall = WallConfig(point=[2.0, 0.0, 0.0], normal=[-1.0, 0.0, 0.0])
    laws: dict[str, dict[str, Any]] = {"invariance": {}, "corrected integral law": {"nominal_gain": 3.0}}
    for name, changes in laws.items():
        config = InvarianceRobotConfig(maximum_force=30.0, constraints=[wall], **changes)
        spent = np.empty((repeats, TICKS))
        for row in spent:
            simulator = Simulator(_build(config))
            simulator.Initialize()
            simulator.AdvanceTo(SKIPPED * 0.002)
            for k in range(TICKS):
                started = time.perf_counter()
                simulator.AdvanceTo((SKIPPED + k + 1) * 0.002)
                row[k] = time.perf_counter() - started
        p50, p99 = (float(np.median(np.percentile(spent, share, axis=1))) for share in (50, 99))
        note = f"{TICKS} ticks, median of {repeats} runs"
        yield Row(f"{name}, p50", 1e6 * p50, "us", required="<= 300", note=note)
        yield Row(f"{name}, p99", 1e6 * p99, "us", required="<= 1000")


def _build(config: Any) -> Any:
    """The controller with its references, pressing on a spring that follows the command."""
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ConstantVectorSource

    from forcectl.diagrams.force_controller import build_controller
    from forcectl.diagrams.model import plant_model
    from forcectl.diagrams.station import StationConfig
    from forcectl.diagrams.workcell import describe
    from forcectl.motion.references import SequenceConfig
    from forcectl.motion.tangential import TangentialMotionConfig

    workcell = describe(StationConfig(fidelity="Kinematic"))
    builder = DiagramBuilder()
    control = builder.AddNamedSystem("controller", build_controller(config, plant_model(workcell)))
    steps = SequenceConfig(times=[0.0, 0.7, 1.4], forces=[15.0, 5.0, 20.0]).add_to(builder, 1)
    motion = TangentialMotionConfig(distance=0.05, speed=0.02).add_to(
        builder, workcell.robot, workcell.start, workcell.contact.n
    )
    force = builder.AddSystem(ConstantVectorSource([10.0]))
    posture = builder.AddSystem(ConstantVectorSource(workcell.motor_start))
    for source, name in (
        (steps, "desired_force"),
        (motion, "unconstrained_reference"),
        (force, "measured_force"),
        (posture, "motor_position"),
        (posture, "motor_velocity"),
    ):
        builder.Connect(source.get_output_port(), control.GetInputPort(name))
    return builder.Build()


if __name__ == "__main__":
    main("Invariance controller of the robot, per tick", benchmark, repeats=3)

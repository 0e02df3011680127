"""Time per tick of forces along task coordinates and of references that comply, for a peg and for two whole poses.

Blocks run in a diagram that does nothing else, whose time is subtracted: wrenches and joint positions change at every
tick, and the references start from those of the tick before.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main
from benchmarks._ticks import PERIOD, Case, tick_rows, ticking


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.framework.rotation_vector import RotationVector
    from forcectl.robot.model import RobotModel
    from forcectl.tasks.compliance.parts import (
        AdmittanceGainsConfig,
        DampingOverConfig,
        ReferenceConfig,
        SwingConfig,
        mode_references,
    )
    from forcectl.tasks.compliance.references import CompliantReferences
    from forcectl.tasks.compliance.task_force import TaskForce
    from forcectl.tasks.coordinates import ArmTask
    from forcectl.tasks.reactive_motion import MotionLimitsConfig
    from forcectl.tasks.relative_task import RelativeTask
    from forcectl.tasks.task_frame import TaskFrame

    robot, turn = RobotModel.load("yumi", None), RotationVector()
    tip, gives = TaskFrame([0.0, 0.0, 0.05]), ReferenceConfig(comply=True)
    deep = DampingOverConfig(coordinate="z", at=[0.0, 0.02], factor=[5.0, 1.0])
    tilts = ReferenceConfig(comply=True, damping_over=deep, swing=SwingConfig(frequency=2.5, amplitude=0.026))
    said = {"z": ReferenceConfig(velocity=-0.075), "x": gives, "y": gives, "phi": tilts, "theta": tilts}
    peg = RelativeTask("left", "right", ["x", "y", "z", "phi", "theta"], turn, leader_frame=tip, follower_frame=tip)
    whole = RelativeTask("left", "right", orientation=turn, leader_frame=tip, follower_frame=tip)
    for tasks in ({"peg": peg}, {"lead": ArmTask("left", orientation=turn), "peg": whole}):
        count = sum(task.size for task in tasks.values())
        mode = mode_references(
            {"peg": said}, tasks, gains=AdmittanceGainsConfig(), limits=MotionLimitsConfig(), period=PERIOD
        )
        forces = partial(TaskForce, robot, list(tasks.values()))
        sizes = [task.size for task in tasks.values()]
        references = partial(CompliantReferences, [mode], sizes, [0.0] * count, period=PERIOD)
        cases: dict[str, Case] = {f"{count} coordinates, without a block": (None, ""), "  forces": (forces, "")}
        rows = list(tick_rows(cases, partial(_forces, robot), repeats))
        cases = {"  without a block": (None, ""), "  references": (references, "")}
        rows += tick_rows(cases, partial(_references, count), repeats)
        yield from rows
        yield Row("  both", rows[1].value + rows[3].value, "us", required="<= 150" if count == 5 else "")


def _swinging(builder: Any, size: int) -> Any:
    """A port of this size that changes at every tick."""
    import numpy as np
    from pydrake.systems.primitives import LinearSystem

    turn = np.array([[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]])
    rows = 0.3 * np.random.default_rng(1).normal(size=(size, 2))
    source = builder.AddSystem(LinearSystem(turn, np.zeros((2, 0)), rows, np.zeros((size, 0)), PERIOD))
    source.configure_default_state([1.0, 0.0])
    return source.get_output_port()


def _forces(robot: Any, make: Callable[[], Any] | None) -> Callable[[], None]:
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ZeroOrderHold

    builder = DiagramBuilder()
    wrench, position = _swinging(builder, 12), _swinging(builder, robot.num_joints)
    ports = [wrench, position]
    if make is not None:
        block = builder.AddSystem(make())
        builder.Connect(wrench, block.GetInputPort("estimated_wrench"))
        builder.Connect(position, block.GetInputPort("joint_position"))
        ports = [block.GetOutputPort("task_force"), block.GetOutputPort("task_wrench")]
    for port in ports:
        hold = builder.AddSystem(ZeroOrderHold(PERIOD, port.size()))
        builder.Connect(port, hold.get_input_port())
    return ticking(builder.Build())


def _references(count: int, make: Callable[[], Any] | None) -> Callable[[], None]:
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ZeroOrderHold

    builder = DiagramBuilder()
    force = _swinging(builder, count)
    holds = {name: builder.AddSystem(ZeroOrderHold(PERIOD, count)) for name in ("position", "velocity", "acceleration")}
    if make is not None:
        block = builder.AddSystem(make())
        builder.Connect(force, block.GetInputPort("task_force"))
    for name, hold in holds.items():
        source = force if make is None else block.GetOutputPort(f"task_{name}_reference")
        builder.Connect(source, hold.get_input_port())
        if make is not None:
            builder.Connect(hold.get_output_port(), block.GetInputPort(f"start_{name}"))
    return ticking(builder.Build())


if __name__ == "__main__":
    main("Tasks that give way", benchmark)

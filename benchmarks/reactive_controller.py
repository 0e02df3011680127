"""The reactive controller of a robot with two arms, tick by tick: everything from measured joints to references.

What is timed is one `AdvanceTo` of 4 ms from Python of a diagram that holds the generator, the controller and the
momentum observer, the call and Drake's events included. The arms reach for targets that change during the motion;
their joints follow one tick late. Rows: torques of all joints and the tool speeds; in the second case also distances of
the arms from each other and from the torso. The shares are measured in runs of their own, with a clock around each
part: the parts of the controller are within it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

PERIOD, TICKS, SKIPPED = 0.004, 1000, 25


def benchmark(repeats: int) -> Iterator[Row]:
    import numpy as np

    for name, distances in (("two arms", 0), ("with self-collision", 16)):
        spent = np.array([_run(_build(distances)[0]) for _ in range(repeats)])
        p50, p99 = (float(np.median(np.percentile(spent, share, axis=1))) for share in (50, 99))
        diagram, rows = _build(distances)
        note = f"{rows} rows, {TICKS} ticks, median of {repeats} runs"
        # The requirement is for at least 40 rows of any kind; distances of all links are beyond it.
        limits = ("", "") if distances else ("<= 500", "<= 1000")
        yield Row(f"{name}, p50", 1e6 * p50, "us", required=limits[0], note=note)
        yield Row(f"{name}, p99", 1e6 * p99, "us", required=limits[1])
        for part, share in _shares(diagram).items():
            yield Row(f"  {part}", 1e6 * share, "us", note="median of a run with clocks")


def _run(diagram: Any) -> Any:
    """Time of each tick [s]."""
    import numpy as np
    from pydrake.systems.analysis import Simulator

    simulator, spent = Simulator(diagram), np.empty(TICKS)
    simulator.Initialize()
    simulator.AdvanceTo(SKIPPED * PERIOD)
    for k in range(TICKS):
        started = time.perf_counter()
        simulator.AdvanceTo((SKIPPED + k + 1) * PERIOD)
        spent[k] = time.perf_counter() - started
    return spent


def _build(distances: int) -> tuple[Any, int]:
    """The diagram, and how many rows its programs have. distances: rows for those of the links."""
    import numpy as np
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource, ZeroOrderHold

    from forcectl.control.arms_motion import ArmsMotion
    from forcectl.control.collision_shapes import RobotShapes
    from forcectl.control.constraints import Constraint
    from forcectl.control.reactive_controller import ReactiveController
    from forcectl.control.rotation_vector import RotationVector
    from forcectl.control.self_collision import LinkDistance
    from forcectl.control.task_coordinates import ArmTask
    from forcectl.control.task_limits import TaskSpeedLimit
    from forcectl.diagrams.reactive_motion import ReactiveMotion
    from forcectl.estimation.momentum_model import MomentumModel
    from forcectl.estimation.momentum_observer import MomentumObserver
    from forcectl.motion.references import held_trajectory
    from forcectl.robot import RobotModel

    robot = RobotModel.load("yumi", "yumi_gripper")
    start, n = robot.facts.default_posture, robot.num_joints
    context = robot.create_context()

    def motion(q: Any) -> ArmsMotion:
        return ArmsMotion(robot, context, q, np.zeros(n))

    here = motion(start)
    tasks = [ArmTask(arm, orientation=RotationVector(here.arm(arm).rotation)) for arm in here.arm_names]
    constraints: list[Constraint] = [TaskSpeedLimit(task, [1.0] * 3 + [4.0] * 3) for task in tasks]
    if distances:
        constraints.append(LinkDistance(RobotShapes.load("yumi", "yumi_gripper"), 0.005, rows=distances))
    controller = ReactiveController(robot, tasks, constraints=constraints)

    def place(k: int) -> Any:
        posture = start + 0.5 * np.sin(np.arange(n) * (k + 1.0))
        return np.concatenate([task.state(motion(posture)).value for task in tasks])

    times = 0.45 * np.arange(10)
    builder = DiagramBuilder()
    target = TrajectorySource(held_trajectory(times, np.array([place(k) for k in range(len(times))]).T))
    source = builder.AddSystem(target)
    reactive = builder.AddSystem(ReactiveMotion(controller))
    observer = builder.AddSystem(MomentumObserver(MomentumModel(robot.plant, robot.parts.joints), period=PERIOD))
    hold = {name: builder.AddSystem(ZeroOrderHold(PERIOD, n)) for name in ("position", "velocity")}
    torque = builder.AddSystem(ConstantVectorSource(np.ones(n)))
    builder.Connect(source.get_output_port(), reactive.GetInputPort("task_target"))
    builder.Connect(torque.get_output_port(), observer.GetInputPort("motor_torque"))
    for name, block in hold.items():
        builder.Connect(reactive.GetOutputPort(f"joint_{name}_reference"), block.get_input_port())
        for reader in (reactive, observer):
            builder.Connect(block.get_output_port(), reader.GetInputPort(f"joint_{name}"))
    diagram = builder.Build()
    return diagram, controller.num_rows


def _shares(diagram: Any) -> dict[str, float]:
    """Median time of each part per tick [s]."""
    import numpy as np

    from forcectl.control.arms_motion import ArmsMotion
    from forcectl.control.constraints import ConstraintSet
    from forcectl.control.prioritized_program import PrioritizedProgram
    from forcectl.control.reactive_controller import ReactiveController
    from forcectl.estimation.momentum_observer import MomentumObserver
    from forcectl.motion.trajectory_generator import TrajectoryGenerator

    parts: dict[str, tuple[type, str]] = {
        "momentum observer": (MomentumObserver, "step"),
        "generator": (TrajectoryGenerator, "step"),
        "controller": (ReactiveController, "step"),
        "  kinematics": (ArmsMotion, "__init__"),
        "  rows of constraints": (ConstraintSet, "rows"),
        "  quadratic programs": (PrioritizedProgram, "solve"),
    }
    clocks: dict[str, list[float]] = {name: [] for name in parts}
    original = {name: getattr(kind, method) for name, (kind, method) in parts.items()}
    for name, (kind, method) in parts.items():
        setattr(kind, method, _timed(original[name], clocks[name]))
    try:
        _run(diagram)
    finally:
        for name, (kind, method) in parts.items():
            setattr(kind, method, original[name])
    ticks = TICKS + SKIPPED
    return {
        name: float(np.median(np.reshape(found[: len(found) // ticks * ticks], (ticks, -1)).sum(axis=1)))
        for name, found in clocks.items()
    }


def _timed(function: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    def timed(*arguments: Any, **named: Any) -> Any:
        started = time.perf_counter()
        result = function(*arguments, **named)
        spent.append(time.perf_counter() - started)
        return result

    return timed


if __name__ == "__main__":
    main("Reactive controller of two arms, per tick", benchmark, repeats=3)

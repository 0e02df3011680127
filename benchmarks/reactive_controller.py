"""The reactive controller of a robot with two arms, tick by tick: everything from measured joints to references.

What is timed, on the clock of the CPU, is one `AdvanceTo` of 4 ms from Python of a diagram that has the generator, the
controller, the momentum observer and what holds their outputs, the call and Drake's events included. Its inputs are set
before, untimed, to what was recorded in a closed loop: the arms reach for targets that change during the motion, their
joints follow one tick late. Rows: torques of all joints and the tool speeds, which bind in some ticks; in the second
case also distances of the arms from each other and from the torso. The shares are measured in runs of their own, with a
clock around each part: the parts of the controller are within it.
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
INPUTS = ("task_target", "joint_position", "joint_velocity", "motor_torque")


def benchmark(repeats: int) -> Iterator[Row]:
    import numpy as np

    for name, distances in (("two arms", 0), ("with self-collision", 16)):
        inputs, binding = _recorded(distances)
        spent = np.array([_run(_control(distances)[0], inputs) for _ in range(repeats)])
        p50, p99 = (float(np.median(np.percentile(spent, share, axis=1))) for share in (50, 99))
        bound = float(np.median(spent[:, binding]))
        diagram, controller = _control(distances)
        note = f"{controller.num_rows} rows, {TICKS} ticks, median of {repeats} runs"
        # The requirement is for at least 40 rows of any kind; distances of all links are beyond it.
        limits = ("", "") if distances else ("<= 500", "<= 1000")
        yield Row(f"{name}, p50", 1e6 * p50, "us", required=limits[0], note=note)
        yield Row(f"{name}, p99", 1e6 * p99, "us", required=limits[1])
        yield Row(
            f"{name}, ticks in which rows bind, p50", 1e6 * bound, "us", note=f"{100 * binding.mean():.0f} % of all"
        )
        for part, share in _shares(diagram, inputs).items():
            yield Row(f"  {part}", 1e6 * share, "us", note="median of a run with clocks")


def _run(diagram: Any, inputs: Any) -> Any:
    """Time of each tick [s]; inputs: of each tick, in the order of `INPUTS`."""
    import numpy as np
    from pydrake.systems.analysis import Simulator

    simulator, spent = Simulator(diagram), np.empty(len(inputs))
    context = simulator.get_mutable_context()
    ports = [diagram.GetInputPort(name) for name in INPUTS]
    for k, values in enumerate(inputs):
        for port, value in zip(ports, np.split(values, np.cumsum([port.size() for port in ports])[:-1]), strict=True):
            port.FixValue(context, value)
        started = time.process_time()
        simulator.AdvanceTo((k + 1) * PERIOD)  # its first event is tick k
        spent[k] = time.process_time() - started
    return spent[SKIPPED:]


def _control(distances: int) -> tuple[Any, Any]:
    """Observer, generator and controller as one diagram, and the controller. distances: rows for those of the links."""
    import numpy as np
    from pydrake.systems.framework import DiagramBuilder

    from forcectl.collision.distance import LinkDistance
    from forcectl.collision.shapes import RobotShapes
    from forcectl.estimation.momentum_observer import MomentumObserver
    from forcectl.framework.rotation_vector import RotationVector
    from forcectl.plant.drives.joint_friction import JointFriction
    from forcectl.robot.arms_motion import ArmsMotion
    from forcectl.robot.model import RobotModel
    from forcectl.robot.momentum_model import MomentumModel
    from forcectl.tasks.constraints.base import Constraint
    from forcectl.tasks.constraints.task_limits import TaskSpeedLimit
    from forcectl.tasks.coordinates import ArmTask
    from forcectl.tasks.reactive_controller import ReactiveController
    from forcectl.tasks.reactive_motion import ReactiveMotion

    robot = RobotModel.load("yumi", "yumi_gripper")
    start, n = robot.parameters.default_posture, robot.num_joints
    here = ArmsMotion(robot, robot.create_context(), start, np.zeros(n))
    tasks = [ArmTask(arm, orientation=RotationVector(here.arm(arm).rotation)) for arm in here.arm_names]
    constraints: list[Constraint] = [TaskSpeedLimit(task, [0.4] * 3 + [1.6] * 3) for task in tasks]
    if distances:
        constraints.append(LinkDistance(RobotShapes.load("yumi", "yumi_gripper"), 0.005, rows=distances))
    controller = ReactiveController(robot, tasks, constraints=constraints)
    friction = JointFriction.of_parameters(robot.parameters)
    builder = DiagramBuilder()
    reactive = builder.AddSystem(ReactiveMotion(controller))
    observer = builder.AddSystem(
        MomentumObserver(
            MomentumModel(robot.plant, robot.parts.joints),
            friction,
            move=0.5 * friction.coulomb,
            still=0.5 * friction.coulomb,
            velocity_bandwidth=200.0,
            period=PERIOD,
        )
    )
    for name in ("joint_position", "joint_velocity"):
        index = builder.ExportInput(reactive.GetInputPort(name), name)
        builder.ConnectInput(index, observer.GetInputPort(name))
        _held(builder, reactive.GetOutputPort(f"{name}_command"))
    _held(builder, observer.GetOutputPort("external_torque"))
    builder.ExportOutput(reactive.GetOutputPort("active_constraints"), "active_constraints")
    builder.ExportInput(reactive.GetInputPort("task_target"), "task_target")
    builder.ExportInput(observer.GetInputPort("motor_torque"), "motor_torque")
    return builder.Build(), controller


def _held(builder: Any, port: Any) -> None:
    from pydrake.systems.primitives import ZeroOrderHold

    hold = builder.AddNamedSystem(f"held_{port.get_name()}", ZeroOrderHold(PERIOD, port.size()))
    builder.Connect(port, hold.get_input_port())
    builder.ExportOutput(hold.get_output_port(), port.get_name())


def _recorded(distances: int) -> tuple[Any, Any]:
    """The inputs of each tick in a closed loop, (ticks, all inputs one after the other); where rows or bounds bind."""
    import numpy as np
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import (
        ConstantVectorSource,
        LogVectorOutput,
        Multiplexer,
        TrajectorySource,
    )

    from forcectl.motion.references import held_trajectory
    from forcectl.robot.arms_motion import ArmsMotion
    from forcectl.robot.model import RobotModel

    control, controller = _control(distances)
    robot = RobotModel.load("yumi", "yumi_gripper")
    start, n, context = robot.parameters.default_posture, robot.num_joints, robot.create_context()

    def place(k: int) -> Any:
        motion = ArmsMotion(robot, context, start + 0.5 * np.sin(np.arange(n) * (k + 1.0)), np.zeros(n))
        return np.concatenate([task.state(motion).value for task in controller.tasks])

    times = 0.45 * np.arange(10)
    builder = DiagramBuilder()
    builder.AddSystem(control)
    target = TrajectorySource(held_trajectory(times, np.array([place(k) for k in range(len(times))]).T))
    sources = {
        "task_target": builder.AddSystem(target).get_output_port(),
        "motor_torque": builder.AddSystem(ConstantVectorSource(np.ones(n))).get_output_port(),
        "joint_position": control.GetOutputPort("joint_position_command"),
        "joint_velocity": control.GetOutputPort("joint_velocity_command"),
    }
    gathered = builder.AddSystem(Multiplexer([*(sources[name].size() for name in INPUTS), 1]))
    builder.Connect(control.GetOutputPort("active_constraints"), gathered.get_input_port(len(INPUTS)))
    for i, name in enumerate(INPUTS):
        builder.Connect(sources[name], control.GetInputPort(name))
        builder.Connect(sources[name], gathered.get_input_port(i))
    log = LogVectorOutput(gathered.get_output_port(), builder, publish_period=PERIOD)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo((SKIPPED + TICKS - 0.5) * PERIOD)
    *inputs, active = log.FindLog(simulator.get_context()).data()
    return np.transpose(inputs), active[SKIPPED:] > 0


def _shares(diagram: Any, inputs: Any) -> dict[str, float]:
    """Median time of each part per tick [s]."""
    import numpy as np

    from forcectl.estimation.momentum_observer import MomentumObserver
    from forcectl.motion.trajectory_generator import TrajectoryGenerator
    from forcectl.qp.prioritized_program import PrioritizedProgram
    from forcectl.robot.arms_motion import ArmsMotion
    from forcectl.tasks.constraints.base import ConstraintSet
    from forcectl.tasks.reactive_controller import ReactiveController

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
        _run(diagram, inputs)
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
        started = time.process_time()
        result = function(*arguments, **named)
        spent.append(time.process_time() - started)
        return result

    return timed


if __name__ == "__main__":
    main("Reactive controller of two arms, per tick", benchmark, repeats=3)

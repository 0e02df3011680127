"""Examples of the reactive controller: both arms of a shipped robot, bare flanges."""

import math
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.diagrams.model import plant_model
from forcectl.diagrams.workcell import describe
from forcectl.framework.rotation_vector import RotationVector
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.tasks.compliance.motion import CompliantMotion
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, SwingConfig, mode_references
from forcectl.tasks.compliance.references import CompliantReferences, ModeReferences
from forcectl.tasks.compliance.task_force import TaskForce
from forcectl.tasks.constraints.force_band import ForceBand
from forcectl.tasks.controllers.reaching import ReachConfig, ReactiveReaching, ReactiveReachingConfig
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.modes import Mode
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig, ReactiveMotion
from forcectl.testing.runs import Input
from tests.examples.block_example import Example
from tests.examples.stations import free

N, K = 14, 12


@cache
def two_arms() -> RobotModel:
    return RobotModel.load("yumi", None)


def at(q: np.ndarray, v: np.ndarray | None = None) -> ArmsMotion:
    robot = two_arms()
    return ArmsMotion(robot, robot.create_context(), q, np.zeros(N) if v is None else v)


@cache
def arm_tasks() -> tuple[ArmTask, ...]:
    """Position and orientation of both arms, from their orientation in the default posture."""
    motion = at(two_arms().parameters.default_posture)
    return tuple(ArmTask(arm, orientation=RotationVector(motion.arm(arm).rotation)) for arm in motion.arm_names)


def reactive_controller(**changes: Any) -> ReactiveController:
    return ReactiveController(two_arms(), **{"tasks": arm_tasks()} | changes)


def switched_controller() -> ReactiveController:
    """A wide force band and two modes, so that there are all inputs."""
    band = ForceBand(ArmTask("right", ["z"]), [0.0, 1.0], [1e3, 1e3], 0.1)
    return reactive_controller(constraints=[band], modes=[Mode(), Mode(arm_tasks()[:1])])


@cache
def task_start() -> np.ndarray:
    return reactive_controller().task_start


AMPLITUDE = np.array([0.02, -0.01, 0.01, 0.1, -0.1, 0.2, 0.01, 0.01, -0.02, 0.1, 0.1, -0.1])
SWING = 10.0  # [rad/s]

REACTIVE_INPUTS: dict[str, Input] = {
    "task_position_reference": lambda t: task_start() + AMPLITUDE * (1 - math.cos(SWING * t)),
    "task_velocity_reference": lambda t: AMPLITUDE * SWING * math.sin(SWING * t),
    "task_acceleration_reference": lambda t: AMPLITUDE * SWING**2 * math.cos(SWING * t),
    "task_target": lambda t: task_start() + AMPLITUDE,
    "joint_position": lambda t: two_arms().parameters.default_posture + 0.01 * math.sin(30 * t),
    "joint_velocity": lambda t: 0.3 * math.cos(30 * t) * np.ones(N),
}
SWITCHED_INPUTS: dict[str, Input] = REACTIVE_INPUTS | {
    "measured_force": lambda t: [0.5 + 0.01 * math.sin(20 * t)],
    "mode": lambda t: [float(0.05 <= t < 0.1)],
}
FROM_STATE = ("task_position", "task_velocity", "task_acceleration")


MOTION_INPUTS: dict[str, Input] = {
    name: REACTIVE_INPUTS[name] for name in ("task_target", "joint_position", "joint_velocity")
}


READINGS = ("joint_position", "joint_velocity")


def reactive_motion() -> ReactiveMotion:
    return ReactiveMotion(reactive_controller())


def reactive_reaching() -> ReactiveReaching:
    parameters = plant_model(describe(free(tool=None)))
    goal = ReachConfig(arm="right", position=[0.1, -0.2, 0.3], time=0.02)
    made = ReactiveReachingConfig(targets=[goal]).add_to(DiagramBuilder(), parameters)
    assert isinstance(made, ReactiveReaching)
    return made


def references(**said: Any) -> ModeReferences:
    """Of the right arm, in a mode."""
    named = {task.arm: task for task in arm_tasks()}
    limits, gains = MotionLimitsConfig(), AdmittanceGainsConfig()
    right = {name: ReferenceConfig(**each) for name, each in said.items()}
    return mode_references({"right": right}, named, gains=gains, limits=limits, period=0.004)


def compliant_references() -> CompliantReferences:
    swing = SwingConfig(amplitude=0.02, frequency=2.5)
    modes = [references(z={"velocity": -0.05}, x={"comply": True}), references(phi={"swing": swing}, y={"by": 0.1})]
    return CompliantReferences(modes, [6, 6], task_start())


def stiff_references() -> CompliantReferences:
    return CompliantReferences([references(z={"velocity": -0.05})], [6, 6], task_start())


def compliant_motion() -> CompliantMotion:
    """All ports that there are."""
    modes = [references(z={"comply": True}), references(x={"velocity": 0.1})]
    return CompliantMotion(switched_controller(), modes, TaskForce(two_arms(), arm_tasks()))


STARTS: dict[str, Input] = {
    f"start_{name}": REACTIVE_INPUTS[f"task_{name}_reference"] for name in ("position", "velocity", "acceleration")
}
MODE: dict[str, Input] = {"mode": SWITCHED_INPUTS["mode"]}
REFERENCE_INPUTS = STARTS | MODE | {"task_force": lambda t: np.arange(12.0) * t}
COMPLIANT_INPUTS: dict[str, Input] = {
    **{name: SWITCHED_INPUTS[name] for name in (*READINGS, "measured_force", "mode")},
    "estimated_wrench": lambda t: np.arange(12.0) * t,
}
REFERENCE_OUTPUTS = (
    *(f"task_{name}_reference" for name in ("position", "velocity", "acceleration")),
    *("task_target", "task_displacement", "task_force_ok"),
)

FORCE_INPUTS = ("joint_position", "estimated_wrench")


def outputs() -> set[str]:
    block = reactive_controller()
    return {block.get_output_port(i).get_name() for i in range(block.num_output_ports())} - set(FROM_STATE)


def every(names: set[str], inputs: Iterable[str]) -> set[tuple[str, str]]:
    return {(output, name) for output in names for name in inputs}


REACTIVE_EXAMPLES: dict[type[System], list[Example]] = {
    ReactiveController: [
        Example(reactive_controller, every(outputs(), REACTIVE_INPUTS), REACTIVE_INPUTS, periods={"period": 0.004}),
        Example(switched_controller, every(outputs(), SWITCHED_INPUTS), SWITCHED_INPUTS, periods={"period": 0.004}),
    ],
    ReactiveMotion: [
        Example(
            reactive_motion,
            every(outputs(), MOTION_INPUTS) | {("task_position_reference", "task_target")},
            MOTION_INPUTS,
            periods={"period": 0.004},
        )
    ],
    CompliantReferences: [
        Example(
            compliant_references,
            every(set(REFERENCE_OUTPUTS), REFERENCE_INPUTS),
            REFERENCE_INPUTS,
            periods={"period": 0.004},
        ),
        Example(
            stiff_references, every(set(REFERENCE_OUTPUTS), STARTS | MODE), STARTS | MODE, periods={"period": 0.004}
        ),
    ],
    CompliantMotion: [
        Example(
            compliant_motion,
            every(outputs(), COMPLIANT_INPUTS)
            | every({"task_force", "task_wrench"}, FORCE_INPUTS)
            | every({REFERENCE_OUTPUTS[0], *REFERENCE_OUTPUTS[3:]}, (*FORCE_INPUTS, "mode")),
            COMPLIANT_INPUTS,
            periods={"period": 0.004},
        )
    ],
    ReactiveReaching: [
        Example(
            reactive_reaching,
            every(outputs(), READINGS),
            {name: REACTIVE_INPUTS[name] for name in READINGS},
            periods={"period": 0.004},
        )
    ],
}

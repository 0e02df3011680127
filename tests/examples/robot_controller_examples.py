"""Examples of the robot's invariance controller and its diagrams."""

import math
from functools import cache
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.diagrams.force_controller import build_controller
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.force.adaptive_force_law import Adaptation
from forcectl.force.approach import ApproachConfig, ApproachedController
from forcectl.force.invariance.controller import InvarianceController
from forcectl.force.invariance.regulated_output import RegulatedCoordinate
from forcectl.force.invariance.robot import AdaptiveInvarianceController, InvarianceRobotConfig
from forcectl.force.sensor_lag import SensorLag
from forcectl.framework.wiring import Enclosed
from forcectl.plant.plant_model import PlantModel
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.testing.runs import Input
from tests.examples.block_example import Example


@cache
def model() -> PlantModel:
    return plant_model(describe(StationConfig(fidelity="Kinematic")))


def robot() -> PlantModel:
    return model()


def robot_controller(**changes: Any) -> InvarianceController:
    """The invariance controller of the robot, with everything it may have."""
    wall = CartesianWall([1.2, 0.0, 0.0], [-1.0, 0.0, 0.0])
    sideways = RegulatedCoordinate(np.array([0.0, 1.0, 0.0]), 0.002, -0.1)
    arguments = {"compliance": 2e-4, "maximum_force": 40.0, "constraints": [wall], "outputs": [sideways]}
    return InvarianceController(robot(), **arguments | changes)


def joint_controller() -> Enclosed:
    made = build_controller(InvarianceRobotConfig(), model())
    assert isinstance(made, Enclosed)
    return made


def adaptive_robot_controller(**changes: Any) -> AdaptiveInvarianceController:
    controller = robot_controller(compliance=None, **changes)
    return AdaptiveInvarianceController(controller, Adaptation().estimator(model()), model())


MOVED = "approach_displacement"
ROBOT_INPUTS: dict[str, Input] = {
    "desired_force": lambda t: 15 * math.cos(60 * t),
    "measured_force": lambda t: 15 * math.sin(40 * t),
    "unconstrained_reference": lambda t: 0.02 * np.arange(6) * t,
}


def robot_feedthrough(*further: str, shows: tuple[str, ...] = ()) -> set[tuple[str, str]]:
    """Every output of the robot's invariance controller, from every input that it reads."""
    outputs = ("joint_position_command", *InvarianceController.port_units, *shows)
    return {(output, name) for output in outputs for name in (*ROBOT_INPUTS, *further)}


def approached_controller() -> ApproachedController:
    made = ApproachConfig(law=InvarianceRobotConfig(), patience=0.05, timeout=0.05).add_to(DiagramBuilder(), model())
    assert isinstance(made, ApproachedController)
    return made


def moving(t: float) -> np.ndarray:
    return robot().start + 0.05 * np.sin(np.arange(1, 7) * (3 * t + 0.1))


ROBOT_EXAMPLES: dict[type[System], list[Example]] = {
    Enclosed: [Example(joint_controller, robot_feedthrough(), ROBOT_INPUTS, periods={"period": 0.002})],
    InvarianceController: [
        Example(robot_controller, robot_feedthrough(), ROBOT_INPUTS),
        Example(
            lambda: robot_controller(nominal_gain=3.0),
            robot_feedthrough(),
            ROBOT_INPUTS,
        ),
        Example(
            lambda: robot_controller(compliance=None),
            robot_feedthrough("compliance"),
            ROBOT_INPUTS | {"compliance": lambda t: 2e-4 + 1e-3 * t},
        ),
        Example(
            lambda: robot_controller(sensor=SensorLag.of(model())),
            robot_feedthrough("motor_position"),
            ROBOT_INPUTS | {"motor_position": moving},
        ),
        Example(
            lambda: robot_controller(approached=True, sensor=SensorLag.of(model())),
            robot_feedthrough("motor_position", MOVED, shows=(MOVED,)),
            ROBOT_INPUTS | {"motor_position": moving, MOVED: lambda t: 0.002 * math.cos(30 * t) - 0.002},
        ),
    ],
    ApproachedController: [
        Example(
            approached_controller,
            robot_feedthrough(shows=(MOVED,))
            | {("approach_mode", name) for name in ("desired_force", "measured_force")},
            ROBOT_INPUTS,
            periods={"period": 0.002},
        )
    ],
    AdaptiveInvarianceController: [
        Example(
            adaptive_robot_controller,
            robot_feedthrough(),
            ROBOT_INPUTS | {"motor_position": moving},
            periods={"period": 0.002, "posture_period": 0.04},
        ),
        Example(
            lambda: adaptive_robot_controller(approached=True),
            robot_feedthrough("approach_displacement", shows=(MOVED,)),
            ROBOT_INPUTS | {"motor_position": moving, MOVED: lambda t: -0.01 * t},
            periods={"period": 0.002, "posture_period": 0.04},
        ),
    ],
}

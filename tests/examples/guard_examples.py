"""Examples of the guard and of what is wired around it, see `block_examples`."""

import math
from functools import partial

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.diagrams.force_controller import GuardedController, build_controller
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.sensors import FaultySensor, WristForceConfig
from forcectl.force.guard.config import GuardConfig
from forcectl.force.guard.guard import ControllerGuard
from forcectl.force.invariance.robot import InvarianceRobotConfig
from forcectl.plant.sensors.force_fault import KINDS, FaultyForce, ForceFaultConfig
from tests.examples.block_example import Example, each
from tests.examples.block_examples_stations import pressing_workcell, two_tables
from tests.examples.robot_controller_examples import ROBOT_INPUTS, robot_feedthrough

FORCES = ("desired_force", "measured_force")


def guard_of(law: bool, maximum_force: float | None = None) -> ControllerGuard:
    config, model = GuardConfig(maximum_force=maximum_force), plant_model(two_tables())
    return config.of_law(model) if law else config.of_joints(model, 0, rates=True)


def guarded_controller() -> GuardedController:
    made = build_controller(InvarianceRobotConfig(), plant_model(pressing_workcell("Kinematic")), GuardConfig())
    assert isinstance(made, GuardedController)
    return made


_VALUES = {"jitter": 0.02, "value": 2.0, "scale": 2.0, "noise": 2.0}


def every_fault() -> list[ForceFaultConfig]:
    return [
        ForceFaultConfig(kind=kind, value=_VALUES.get(kind, 0.0), start=0.01 * i, duration=0.008)
        for i, kind in enumerate(KINDS)
        if kind not in ("nan", "inf")
    ]


def faulty_sensor() -> Diagram:
    made = WristForceConfig(faults=every_fault()).add_to(DiagramBuilder(), Site(pressing_workcell("Kinematic"), 3))
    assert isinstance(made, FaultySensor)
    return made


GUARD_EXAMPLES: dict[type[System], list[Example]] = {
    ControllerGuard: [
        Example(
            partial(guard_of, True),
            each("forces", *FORCES) | each("guarded", *FORCES, "command"),
            {
                "desired_force": np.array([12.0, 7.0]),
                "measured_force": lambda t: np.array([12.0, 7.0]) * math.sin(5 * t),
                "command": lambda t: np.array([-2e-3, 1e-3]) * math.sin(60 * t),
            },
            periods={"period": 0.004},
        ),
        Example(
            partial(guard_of, False),
            each("guarded", "command", "command_rate"),
            {
                "command_rate": lambda t: 0.6 * np.cos(60 * t) * np.ones(14),
                "command": lambda t: plant_model(two_tables()).start + 0.01 * math.sin(60 * t),
            },
            periods={"period": 0.004},
        ),
        Example(
            partial(guard_of, False, 30.0),
            each("guarded", "command", "command_rate", "estimated_wrench"),
            {
                "command_rate": lambda t: 0.6 * np.cos(60 * t) * np.ones(14),
                "command": lambda t: plant_model(two_tables()).start + 0.01 * math.sin(60 * t),
                "estimated_wrench": lambda t: 40.0 * math.sin(9 * t) * np.ones(12),
            },
            periods={"period": 0.004},
        ),
    ],
    GuardedController: [
        Example(
            guarded_controller,
            robot_feedthrough(),
            ROBOT_INPUTS,
            periods={"period": 0.002},
        )
    ],
    FaultyForce: [
        Example(
            partial(FaultyForce, 2, every_fault()),
            each("measured_force", "reading"),
            {"reading": lambda t: np.array([5.0, 3.0]) * math.sin(9 * t)},
        )
    ],
    FaultySensor: [
        Example(
            faulty_sensor,
            each("measured_wrench", "contact_force", "motor_position") | each("measured_force", "contact_force"),
            {"contact_force": 5.0, "motor_position": np.zeros(6)},
            periods={"period": 0.002},
        )
    ],
}

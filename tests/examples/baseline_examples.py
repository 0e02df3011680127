"""Examples of the force laws of the field, see `block_examples`."""

from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.force.approach import ApproachConfig, ApproachForceLaw, GuardedMove
from forcectl.force.baselines.disturbance_observer import DisturbanceObserverForceLaw
from forcectl.force.baselines.impedance import ImpedanceForceLaw
from forcectl.force.baselines.passive import PassiveConfig, PassiveForceLaw, PassivityController
from forcectl.force.integral import IntegralConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.testing.runs import Input
from tests.examples.block_example import Example, each, force, push

DESIRED = ("desired_force", "measured_force")


def impedance(size: int = 2, **changed: object) -> ImpedanceForceLaw:
    keys = {"inertia": 30.0, "damping": 3e3, "stiffness": 5e3, "adaptation_rate": 0.3, "reference_compliance": 1e-4}
    return ImpedanceForceLaw(size, **{**keys, **changed})


def observer(size: int = 2, **changed: object) -> DisturbanceObserverForceLaw:
    keys = {"observer_bandwidth": 2.0, "reference_bandwidth": 1.5, "compliance": 1e-4}
    return DisturbanceObserverForceLaw(size, **{**keys, **changed})


def passivity(size: int = 2, **changed: object) -> PassivityController:
    return PassivityController(size, **{"energy": 1e-3, **changed})


def guarded_move(size: int = 2, **changed: object) -> GuardedMove:
    keys = {"speed": 0.02, "threshold": 1.0, "touch_speed": 0.003, "step_back": 0.01}
    return GuardedMove(
        size, **{**keys, "patience": 0.01, "timeout": 0.05, "clearance": 0.01, "rise_time": 0.02, **changed}
    )


MODEL = PlantModel(2, 0.002, np.full(2, 3e-5), np.full(2, 2e-4), 12.6, 1.0, 0.0)


def approach(law: Any) -> ApproachForceLaw:
    return ApproachConfig(law=law).add_to(DiagramBuilder(), MODEL)


def passive() -> PassiveForceLaw:
    return PassiveConfig(law=IntegralConfig(), energy=1e-4).add_to(DiagramBuilder(), MODEL)


def feedthrough(inputs: tuple[str, ...], *outputs: str) -> set[tuple[str, str]]:
    return {pair for name in outputs for pair in each(name, *inputs)}


FORCES: dict[str, Input] = {"desired_force": force, "measured_force": force}
MOVE = ("approach_displacement", "approach_mode", "regulated_force", "force_in_contact")
PASSIVE = ("displacement_command", "observed_energy", "passivity_offset")
BASELINE_EXAMPLES: dict[type[System], list[Example]] = {
    ImpedanceForceLaw: [
        Example(impedance, feedthrough(DESIRED, "displacement_command", "adapted_velocity"), FORCES),
    ],
    DisturbanceObserverForceLaw: [
        Example(observer, feedthrough(DESIRED, "displacement_command", "disturbance"), FORCES),
        Example(
            lambda: observer(compliance=None, model_lag=0.1),
            feedthrough((*DESIRED, "compliance"), "displacement_command", "disturbance"),
            FORCES | {"compliance": [1e-4, 2e-4]},
        ),
    ],
    PassivityController: [
        Example(
            passivity,
            feedthrough(("law_command", "measured_force"), *PASSIVE),
            {"law_command": push, "measured_force": force},
        ),
    ],
    GuardedMove: [Example(guarded_move, feedthrough(DESIRED, *MOVE), FORCES)],
    ApproachForceLaw: [
        Example(
            lambda: approach(IntegralConfig()),
            feedthrough(DESIRED, "displacement_command", "approach_displacement", "approach_mode"),
            FORCES,
            periods={"period": 0.002},
        ),
    ],
    PassiveForceLaw: [Example(passive, feedthrough(DESIRED, *PASSIVE), FORCES, periods={"period": 0.002})],
}

"""Examples of controllers around force laws, see `block_examples`."""

from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.diagrams.force_controller import ForceController, build_controller
from forcectl.diagrams.model import plant_model
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.admittance import AdmittanceConfig, AdmittanceFilter, AdmittanceForceLaw
from forcectl.force.integral import IntegralConfig
from forcectl.force.invariance.predictive import PredictiveInvarianceConfig
from forcectl.force.per_arm import PerArm, PerArmConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.testing.runs import Input
from tests.examples.block_example import Example, each, force, push
from tests.examples.block_examples_stations import pressing_workcell, two_tables
from tests.examples.hybrid_examples import HYBRID_EXAMPLES

BOTH_ARMS = {"period": 0.004}
DESIRED = ("desired_force", "measured_force")
COMMANDED = (*DESIRED, "unconstrained_reference")


def one(fidelity: str) -> PlantModel:
    return plant_model(pressing_workcell(fidelity))


@cache
def both() -> PlantModel:
    return plant_model(two_tables())


def laws_of(left: Any, right: Any) -> PerArmConfig:
    return PerArmConfig(laws={"left": left, "right": right})


def per_arm(left: Any, right: Any) -> PerArm:
    made = laws_of(left, right).add_to(DiagramBuilder(), both())
    assert isinstance(made, PerArm)
    return made


def swing(start: np.ndarray, t: float) -> np.ndarray:
    return start + 0.05 * np.sin(np.arange(1, len(start) + 1) * (3 * t + 0.1))


FORCES: dict[str, Input] = {"desired_force": force, "measured_force": force}
ONE_ARM: dict[str, Input] = {"desired_force": 15.0, "motor_position": lambda t: swing(one("Kinematic").start, t)}

GENERATED = ("generated_position", "generated_velocity", "force")
CORRECTED = ("commanded_position", "commanded_velocity")


def admittance(size: int = 2, **changed: Any) -> AdmittanceFilter:
    return AdmittanceFilter(size, **{"inertia": 0.5, "damping": 50.0, **changed})


def admittance_law(arrangement: str, generator: str) -> AdmittanceForceLaw:
    return AdmittanceConfig(arrangement=arrangement, generator=generator).law(both())


CONTROLLER_EXAMPLES: dict[type[System], list[Example]] = {
    AdmittanceFilter: [
        Example(
            partial(admittance, corrected=corrected),
            {pair for name in ("position", "velocity") for pair in each(name, *inputs)},
            dict.fromkeys(inputs, force),
        )
        for corrected, inputs in ((False, GENERATED), (True, (*GENERATED, *CORRECTED)))
    ],
    AdmittanceForceLaw: [
        Example(
            partial(admittance_law, arrangement, generator),
            {
                pair
                for name in ("displacement_command", "displacement_velocity_command")
                for pair in each(name, *DESIRED)
            },
            FORCES,
            periods=BOTH_ARMS,
        )
        for arrangement in ("consistent", "increment")
        for generator in ("velocity", "position")
    ],
    PerArm: [
        Example(
            lambda: per_arm(IntegralConfig(), AdaptiveIntegralConfig()),
            each("displacement_command", *DESIRED),
            FORCES | {"motor_displacement": push},
            periods=BOTH_ARMS,
        ),
        Example(
            lambda: per_arm(IntegralConfig(), PredictiveInvarianceConfig(filter_delay=0.004)),
            {
                pair
                for output in ("displacement_command", "right_surface_offset", "right_drive_offset")
                for pair in each(output, *DESIRED, "motor_displacement")
            }
            | {pair for output in ("right_invariance_function", "right_status") for pair in each(output, *DESIRED)},
            FORCES | {"motor_displacement": push, "path_displacement": push},
            periods=BOTH_ARMS,
        ),
    ],
    ForceController: [
        Example(
            lambda: build_controller(IntegralConfig(), one("Kinematic")),
            each("joint_position_command", *COMMANDED) | each("displacement_command", *DESIRED),
            ONE_ARM,
            periods={"period": 0.002, "posture_period": 0.04},
        ),
        Example(
            lambda: build_controller(PredictiveInvarianceConfig(), one("OneDimensional")),
            each("joint_position_command", *COMMANDED, "motor_position")
            | {
                pair
                for output in ("displacement_command", "surface_offset", "drive_offset")
                for pair in each(output, *DESIRED, "motor_position")
            }
            | {pair for output in ("invariance_function", "status") for pair in each(output, *DESIRED)},
            ONE_ARM,
            periods={"period": 0.002},
        ),
        Example(
            lambda: build_controller(AdmittanceConfig(), one("OneDimensional")),
            each("joint_position_command", *COMMANDED)
            | {
                pair
                for output in ("joint_velocity_command", "displacement_command", "displacement_velocity_command")
                for pair in each(output, *DESIRED)
            },
            ONE_ARM,
            periods={"period": 0.002},
        ),
        Example(
            lambda: build_controller(laws_of(IntegralConfig(), AdaptiveIntegralConfig()), both()),
            each("joint_position_command", *COMMANDED) | each("displacement_command", *DESIRED),
            FORCES | {"motor_position": lambda t: swing(both().start, t)},
            periods=BOTH_ARMS | {"posture_period": 0.04},
        ),
    ],
} | HYBRID_EXAMPLES

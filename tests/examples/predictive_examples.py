"""Examples of the blocks of the predictive law, see `block_examples`."""

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.force.invariance.predictive import (
    PredictiveCorrection,
    PredictiveForceLaw,
    PredictiveInvarianceConfig,
)
from forcectl.plant.plant_model import PlantModel
from tests.examples.block_example import Example, each, force, push


def law() -> PredictiveForceLaw:
    model = PlantModel(2, 0.002, np.array([3e-5, 4e-5]), np.array([1e-5, 1e-4]), 12.6, 1.0, 0.004)
    return PredictiveInvarianceConfig().add_to(DiagramBuilder(), model)


DISPLACEMENTS = ("motor_displacement", "path_displacement", "planned_displacement", "nominal_command")
SEEN = {
    "measured_force": force,
    **dict.fromkeys(DISPLACEMENTS, push),
    "filtered_displacements": lambda t: np.tile(push(t), 2),
}
OFFSETS = ("displacement_command", "surface_offset", "drive_offset")

PREDICTIVE_EXAMPLES: dict[type[System], list[Example]] = {
    PredictiveCorrection: [
        Example(
            lambda: PredictiveCorrection(2, compliance=[1e-4, 2e-4], lead=0.2),
            {pair for output in (*OFFSETS, "planned_command") for pair in each(output, *SEEN)},
            SEEN,
        )
    ],
    PredictiveForceLaw: [
        Example(
            law,
            {
                *(pair for o in OFFSETS for pair in each(o, "desired_force", "measured_force", "motor_displacement")),
                *(
                    pair
                    for o in ("invariance_function", "status")
                    for pair in each(o, "desired_force", "measured_force")
                ),
            },
            {
                "desired_force": force,
                "measured_force": force,
                "motor_displacement": push,
                "path_displacement": push,
            },
            periods={"period": 0.002},
        )
    ],
}

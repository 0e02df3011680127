"""Examples of the command governor and of a law behind it, see `block_examples`."""

from functools import partial

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.force.governor.governor import CommandGovernor, GovernedConfig, GovernedForceLaw
from forcectl.force.governor.scheme import EquivalentScheme
from forcectl.force.integral import IntegralConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.testing.runs import Input
from tests.examples.block_example import Example, each, force


def governed() -> GovernedForceLaw:
    model = PlantModel(2, 0.002, np.full(2, 3e-5), np.full(2, 2e-4), 12.6, 1.0, 0.0)
    return GovernedConfig(law=IntegralConfig()).add_to(DiagramBuilder(), model)


def feedthrough(*outputs: str) -> set[tuple[str, str]]:
    return {pair for name in outputs for pair in each(name, *FORCES)}


FORCES: dict[str, Input] = {"desired_force": force, "measured_force": force}
GOVERNOR_EXAMPLES: dict[type[System], list[Example]] = {
    CommandGovernor: [
        Example(partial(CommandGovernor, 2, delay=0.01, **further), feedthrough("governed_reference", "status"), FORCES)
        for further in ({}, {"upper_limit": 30.0, "rate_limit": 2e3}, {"horizon": 4, "upper_force": 10.0})
    ],
    EquivalentScheme: [
        Example(
            partial(EquivalentScheme, delay_ticks=3, true_delay_ticks=2),
            {("governed_reference", "desired_force")},
            {"desired_force": 12.0},
            periods={"period": 0.002},
        )
    ],
    GovernedForceLaw: [
        Example(
            governed,
            feedthrough("displacement_command", "governed_reference", "governor_status"),
            FORCES,
            periods={"period": 0.002},
        )
    ],
}

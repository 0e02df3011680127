"""Force laws on the ideal plant F[k] = -dx_bar[k-1]/C_T, as blocks, and recorded forces for them."""

from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem

from forcectl.framework.wiring import export_all_outputs
from forcectl.plant.plant_model import PlantModel
from forcectl.testing import Log, run_diagram

PERIOD = 0.002
C_T = 2e-4
FORCE = 15.0


def model(size: int = 1, compliance: float = C_T, period: float = PERIOD) -> PlantModel:
    stiff = np.full(size, compliance)
    return PlantModel(size, period, 0.2 * stiff, 0.8 * stiff, 12.6, 1.0, 0.0)


def pressed(config: Any, ticks: int, compliance: float = C_T, desired: Any = FORCE) -> Log:
    """A law that is designed for C_T on a plant of another compliance [m/N]; its outputs and `contact_force`."""
    builder = DiagramBuilder()
    law = config.add_to(builder, model())
    none, eye = np.zeros((1, 1)), np.eye(1)
    plant = builder.AddNamedSystem("plant", LinearSystem(none, -eye / compliance, eye, none, PERIOD))
    builder.Connect(law.GetOutputPort("displacement_command"), plant.get_input_port())
    builder.Connect(plant.get_output_port(), law.GetInputPort("measured_force"))
    builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
    export_all_outputs(builder, law)
    builder.ExportOutput(plant.get_output_port(), "contact_force")
    return run_diagram(builder.Build(), (ticks - 1) * PERIOD, period=PERIOD, inputs={"desired_force": desired})


def commands(config: Any, forces: np.ndarray, desired: Any = FORCE) -> Log:
    """A law that is given recorded forces."""
    builder = DiagramBuilder()
    law = config.add_to(builder, model())
    builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
    builder.ExportInput(law.GetInputPort("measured_force"), "measured_force")
    export_all_outputs(builder, law)
    last = len(forces) - 1
    inputs = {"desired_force": desired, "measured_force": lambda t: forces[min(round(t / PERIOD), last)]}
    return run_diagram(builder.Build(), last * PERIOD, period=PERIOD, inputs=inputs)


def wandering(ticks: int = 200, seed: int = 1) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(size=ticks))


def assert_holds_a_bad_reading(config: Any) -> None:
    """Readings that are no numbers hold the command, and afterwards it is as if they had not been."""
    forces = wandering()
    command = commands(config, np.insert(forces, 50, [np.nan, np.inf]))["displacement_command"][:, 0]
    assert (command[50:52] == command[49]).all()
    straight = commands(config, forces)["displacement_command"][:, 0]
    np.testing.assert_array_equal(np.delete(command, [50, 51]), straight)


def assert_does_not_wind_up(config: Any, high: float, tick: int) -> None:
    """A lower_limit of -1e-3 m is kept while 15 N are wanted, `high` [s] long, and left before `tick` when 2 N are."""
    log = pressed(config, round(2 * high / PERIOD), desired=lambda t: 15.0 if t < high else 2.0)
    command = log["displacement_command"][:, 0]
    assert command.min() == -1e-3
    assert command[tick] > -1e-3

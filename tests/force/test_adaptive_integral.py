"""The adaptive law: estimator and integral law together, on a filtered spring and in a whole loop."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer

from forcectl.errors import BadInputError
from forcectl.force.adaptive_force_law import AdaptiveForceLaw
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.motion.references import Reference
from forcectl.plant.contact.compliant_contact import CompliantContact
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_sensor import ForceSensor
from forcectl.testing import Log, assert_passes_no_nan, assert_ports, run_diagram
from tests.examples.plant_models import plant_model

PERIOD = 0.002
STIFFNESS, C_R = 5900.0, 3.2e-5


def model(n: int = 1, delay: float = 0.0) -> PlantModel:
    return plant_model(np.full(n, C_R), np.full(n, 1 / STIFFNESS), sensor_delay=delay)


def law(n: int = 1, delay: float = 0.0, **changed: float) -> AdaptiveForceLaw:
    return AdaptiveIntegralConfig(**changed).add_to(DiagramBuilder(), model(n, delay))


def loop(delay: float = 0.0, noise: float = 0.0, **changed: float) -> Diagram:
    """Reference, adaptive law, position loop, one-sided spring, filtered and delayed sensor."""
    builder = DiagramBuilder()
    reference = builder.AddSystem(Reference("desired_force", [15.0]))
    controller = AdaptiveIntegralConfig(**changed).add_to(builder, model(1, delay))
    position = builder.AddSystem(PositionLoop(1, unit="m"))
    parts = builder.AddSystem(Demultiplexer([1, 1]))
    contact = builder.AddSystem(CompliantContact(1, stiffness=STIFFNESS, robot_compliance=C_R))
    sensor = builder.AddSystem(ForceSensor(1, delay=delay, noise_std=noise))
    builder.Connect(reference.GetOutputPort("desired_force"), controller.GetInputPort("desired_force"))
    builder.Connect(controller.GetOutputPort("displacement_command"), position.GetInputPort("command"))
    builder.Connect(position.GetOutputPort("reference"), parts.get_input_port())
    builder.Connect(parts.get_output_port(0), contact.GetInputPort("displacement"))
    builder.Connect(parts.get_output_port(0), controller.GetInputPort("motor_displacement"))
    builder.Connect(contact.GetOutputPort("contact_force"), sensor.GetInputPort("force"))
    builder.Connect(sensor.GetOutputPort("measured_force"), controller.GetInputPort("measured_force"))
    for block, port in (
        (contact, "contact_force"),
        (controller, "environment_compliance"),
        (controller, "displacement_command"),
    ):
        builder.ExportOutput(block.GetOutputPort(port), port)
    return builder.Build()


def run(duration: float = 6.0, **changed: float) -> Log:
    return run_diagram(loop(**changed), duration, period=PERIOD)


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.5, 0.8, 1.5])
@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_converges_to_the_true_compliance(error, delay):
    log = run(compliance_error=error, delay=delay)
    assert log["environment_compliance"][0, 0] == pytest.approx(error / STIFFNESS)
    assert log["environment_compliance"][-1, 0] == pytest.approx(1 / STIFFNESS, rel=1e-3)
    assert log["contact_force"][-1, 0] == pytest.approx(15.0, rel=1e-3)


def test_the_same_filter_on_both_leaves_no_bias_in_the_transient():
    """With a large P_0 the estimate is right from the first samples on: force and displacement lag alike."""
    log = run(1.0, initial_covariance=1e2, compliance_error=0.5, minimum_force=0.05)
    learnt = log.time > 0.2
    np.testing.assert_allclose(log["environment_compliance"][learnt, 0], 1 / STIFFNESS, rtol=1e-3)


def test_with_the_right_compliance_it_is_the_integral_law():
    log = run(3.0, compliance_error=1.0)
    np.testing.assert_allclose(log["environment_compliance"][:, 0], 1 / STIFFNESS, rtol=1e-6)
    model = 15.0 * (1 - np.exp(-1.5 * log.time))
    assert np.max(np.abs(log["contact_force"][:, 0] - model)) < 0.2 * 15.0  # the lag of the loop only


def test_converges_under_noise():
    log = run(noise=0.05, compliance_error=0.8)
    tail = log["environment_compliance"][-500:, 0]
    assert np.mean(tail) == pytest.approx(1 / STIFFNESS, rel=0.01)


def test_command_acts_in_the_tick_of_the_force():
    """No delay from measured_force to displacement_command, held between ticks."""
    inputs = {"desired_force": 15.0, "measured_force": lambda t: 5.0 if t < 0.02 - 1e-9 else 15.0}
    log = run_diagram(law(), 0.04, period=PERIOD / 4, inputs=inputs)
    command = log["displacement_command"][:, 0]
    steps = np.diff(command)
    ticks = np.arange(1, len(command)) % 4 == 0
    assert np.all(steps[~ticks] == 0.0)
    assert np.all(steps[ticks & (log.time[1:] < 0.02 - 1e-9)] < 0.0)
    assert np.all(steps[log.time[1:] >= 0.02 - 1e-9] == 0.0)
    first = -(0.8 / STIFFNESS + C_R) * 1.5 * PERIOD * 10.0
    assert command[0] == pytest.approx(first, rel=1e-12)


def test_passes_no_nan():
    inputs = {"desired_force": 15.0, "measured_force": 10.0, "motor_displacement": -2e-3}
    assert_passes_no_nan(law(2), duration=0.1, period=PERIOD, inputs=inputs)


def test_ports():
    assert_ports(
        law(3),
        {"desired_force": 3, "measured_force": 3, "motor_displacement": 3},
        {"displacement_command": 3, "environment_compliance": 3},
    )


def test_config_tells_its_nominal_bandwidth():
    assert AdaptiveIntegralConfig(integral_gain=2.0).reference_model_bandwidth() == 2.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("integral_gain", -1.0),
        ("compliance_error", 0.0),
        ("forgetting", 0.0),
        ("forgetting", 1.01),
        ("initial_covariance", 0.0),
        ("minimum_force", -1.0),
        ("dead_zone", math.nan),
        ("lower_limit", 0.1),
        ("upper_limit", -0.1),
    ],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        AdaptiveIntegralConfig(**{name: value})

"""Invariance control: it follows the nominal law, stops at the constraint, and the nominal law cannot wind up."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LinearSystem

from forcectl.errors import BadInputError
from forcectl.force.integral import IntegralConfig, IntegralForceLaw
from forcectl.force.invariance.correction import (
    AdaptiveInvarianceControlConfig,
    InvarianceControl,
    InvarianceControlConfig,
    InvarianceCorrection,
)
from forcectl.force.invariance.force_law import AdaptiveInvarianceConfig
from forcectl.framework.yaml_tree import parse
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status
from forcectl.scenario.scenario import load_scenario
from forcectl.testing import assert_passes_no_nan, assert_ports, run_diagram

PERIOD, C_R, C_E = 0.002, 3e-5, 1.7e-4
C_T = C_R + C_E


def model(size: int = 1) -> PlantModel:
    return PlantModel(size, PERIOD, np.full(size, C_R), np.full(size, C_E), 12.6, 1.0, 0.0)


def correction(**changed) -> InvarianceCorrection:
    known = {"gamma": -0.1, "upper_acceleration": 10.0, "compliance": C_T, "period": PERIOD}
    return InvarianceCorrection(1, **{**known, **changed})


def control(size: int = 1, **changed) -> InvarianceControl:
    return InvarianceControlConfig(**changed).add_to(DiagramBuilder(), model(size))


def spring_loop(law, true_compliance: float = C_T) -> Diagram:
    """The law on F = -dx/C with a tick of delay."""
    builder = DiagramBuilder()
    builder.AddSystem(law)
    spring = builder.AddSystem(LinearSystem([[0.0]], [[1.0]], [[-1 / true_compliance]], [[0.0]], PERIOD))
    builder.Connect(law.GetOutputPort("displacement_command"), spring.get_input_port())
    builder.Connect(spring.get_output_port(), law.GetInputPort("measured_force"))
    builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
    builder.ExportOutput(spring.get_output_port(), "force")
    builder.ExportOutput(law.GetOutputPort("displacement_command"), "displacement_command")
    return builder.Build()


@pytest.mark.parametrize(
    "desired", [15.0, lambda t: 100.0 + 5.0 * math.cos(12.0 * t)], ids=["still", "falls and rises"]
)
def test_far_from_the_constraint_it_moves_as_the_nominal_law(desired):
    """(3.18) with no active row: the velocity of the nominal command, tick by tick."""

    def nominal(t):
        return -1e-3 * (1 - math.exp(-3 * t)) + 1e-4 * math.sin(30 * t)

    inputs = {"desired_force": desired, "measured_force": 1.0, "nominal_command": nominal}
    command = run_diagram(correction(), 0.5, period=PERIOD, inputs=inputs)["displacement_command"][:, 0]
    nominal_velocity = np.diff([nominal(k * PERIOD) for k in range(len(command))]) / PERIOD
    velocity = np.zeros(len(command))
    for k in range(1, len(command)):  # exact double integration: x[k] - x[k-1] = Ts (v[k-1] + v[k])/2
        velocity[k] = 2 * (command[k] - command[k - 1]) / PERIOD - velocity[k - 1]
    np.testing.assert_allclose(velocity[1:], nominal_velocity, atol=1e-9)


def test_the_loop_follows_the_integral_law_and_ends_at_the_reference_without_overshoot():
    free = run_diagram(
        spring_loop(IntegralForceLaw(1, integral_gain=3.0, compliance=C_T, period=PERIOD)),
        2.0,
        period=PERIOD,
        inputs={"desired_force": 15.0},
    )["force"][:, 0]
    force = run_diagram(spring_loop(control()), 2.0, period=PERIOD, inputs={"desired_force": 15.0})["force"][:, 0]
    # Half a tick behind: the velocity of the command is a ramp over the tick, that of the law a step.
    assert np.max(np.abs(force - free)) <= 15.0 * 3.0 * PERIOD * 0.51
    assert force.max() <= 15.0 + 1e-9


@pytest.mark.parametrize("pushing", [-0.05, -1.0])
def test_a_law_that_only_pushes_is_stopped_at_the_constraint_within_gamma(pushing):
    inputs = {"desired_force": 15.0, "measured_force": 1.0, "nominal_command": lambda t: pushing * t}
    log = run_diagram(correction(speed_limit=0.05), 1.5, period=PERIOD, inputs=inputs)
    command = np.concatenate([[0.0, 0.0], log["displacement_command"][:, 0]])
    acceleration = np.diff(command, 2) / PERIOD**2
    assert command.min() >= -15.0 * C_T - 1e-15
    assert command[-1] == pytest.approx(-15.0 * C_T, abs=1e-15)
    assert acceleration.min() < -5.0  # the nominal law may accelerate as it likes,
    assert acceleration.max() <= 0.1 * (1 + 1e-6)  # the constraint brakes within gamma
    assert np.all(log["invariance_function"] <= 1e-15)


def test_a_law_that_retreats_is_left_alone_beyond_the_constraint():
    """Only y <= 0 is a constraint: from a step down the command returns with gamma, or faster if the law does."""
    gentle = run_diagram(spring_loop(control()), 3.0, period=PERIOD, inputs={"desired_force": step_down})
    force = gentle["force"][:, 0]
    assert force[-1] == pytest.approx(5.0, abs=0.01)
    fast = np.flatnonzero(force[round(1.5 / PERIOD) :] < 5.5)[0] * PERIOD
    assert fast < 2.5 * 2 * math.sqrt(10.0 * C_T / 0.1)


def step_down(t: float) -> float:
    return 15.0 if t < 1.5 - 1e-9 else 5.0


@pytest.mark.slow
def test_the_nominal_law_does_not_wind_up():
    """Held back for long by a compliance believed 20 % too small, it answers a higher reference at once."""
    law = control(compliance_error=0.8, nominal=IntegralConfig(integral_gain=3.0, lower_limit=-4e-3))
    log = run_diagram(
        spring_loop(law), 12.0, period=PERIOD, inputs={"desired_force": lambda t: 15.0 if t < 10.0 - 1e-9 else 20.0}
    )
    force = log["force"][:, 0]
    assert force[round(9.9 / PERIOD)] == pytest.approx(12.0, abs=1e-6)  # (3.55)
    assert force[-1] == pytest.approx(16.0, abs=1e-3)
    assert force[round(10.3 / PERIOD)] > 14.0


@pytest.mark.parametrize("port", ["measured_force", "desired_force"])
@pytest.mark.parametrize("size", [1, 2])
def test_a_signal_that_is_not_finite_brakes_and_holds(port, size):
    usual = {"desired_force": 15.0, "measured_force": 5.0}
    gap = {**usual, port: lambda t: np.full(size, math.nan if 0.1 < t < 0.5 else usual[port])}
    log = run_diagram(control(size), 1.0, period=PERIOD, inputs=gap)
    command, status = log["displacement_command"][:, -1], log["status"][:, -1]
    first, last = round(0.1 / PERIOD), round(0.5 / PERIOD)
    moving = command[first] - command[first - 1]
    assert np.max(np.abs(np.diff(command[first - 1 : last], 2))) <= 0.1 * PERIOD**2 * (1 + 1e-6)
    assert np.ptp(command[last - 50 : last]) == 0.0
    assert command[last - 1] < command[first] + moving
    assert set(status[first + 1 : last]) == {Status.NOT_FINITE}
    assert status[-1] == 0


def test_never_a_nan():
    usual = {"desired_force": 15.0, "measured_force": 5.0}
    assert_passes_no_nan(control(), duration=0.1, period=PERIOD, inputs=usual)
    adaptive = AdaptiveInvarianceControlConfig().add_to(DiagramBuilder(), model())
    assert_passes_no_nan(adaptive, duration=0.1, period=PERIOD, inputs={**usual, "motor_displacement": -1e-3})


def test_a_nominal_command_that_is_not_a_number_is_no_movement():
    inputs = {"desired_force": 15.0, "measured_force": 1.0}
    lost = {**inputs, "nominal_command": lambda t: math.nan if 0.1 < t < 0.2 else -0.002 * t}
    command = run_diagram(correction(), 0.3, period=PERIOD, inputs=lost)["displacement_command"][:, 0]
    assert np.all(np.isfinite(command))
    assert np.ptp(command[round(0.15 / PERIOD) : round(0.2 / PERIOD)]) == 0.0


# --- adaptive, ports, configuration ----------------------------------------------------------------------------------


@pytest.mark.parametrize("config", [AdaptiveInvarianceControlConfig(), AdaptiveInvarianceConfig()])
def test_adaptive_laws_show_the_estimate_and_share_it(config):
    law = config.add_to(DiagramBuilder(), model(2))
    inputs = ["desired_force", "measured_force", "motor_displacement", "path_displacement", "sliding"]
    outputs = ["displacement_command", "invariance_function", "status", "surface_offset", "environment_compliance"]
    assert_ports(law, dict.fromkeys(inputs, 2), dict.fromkeys(outputs, 2))
    log = run_diagram(law, 0.01, period=PERIOD, inputs={"desired_force": 15.0, "measured_force": 0.0})
    assert log["environment_compliance"][0, 0] == pytest.approx(0.8 * C_E)
    assert log["invariance_function"][0, 0] == pytest.approx(-15.0 * (0.8 * C_E + C_R))


def test_ports():
    outputs = {"displacement_command": 3, "invariance_function": 3, "status": 3}
    assert_ports(control(3), {"desired_force": 3, "measured_force": 3}, outputs)


class Theirs:
    """A law of somebody else's, which happens to be the integral one."""

    def add_to(self, builder, model):
        return IntegralConfig(integral_gain=3.0).add_to(builder, model)


def test_a_nominal_law_of_the_users_own():
    """Any force law will do."""
    inputs = {"desired_force": 15.0}
    theirs = run_diagram(spring_loop(control(nominal=Theirs())), 1.0, period=PERIOD, inputs=inputs)["force"]
    ours = run_diagram(spring_loop(control()), 1.0, period=PERIOD, inputs=inputs)["force"]
    np.testing.assert_array_equal(theirs, ours)


def test_in_a_scenario_the_nominal_law_is_a_slot():
    controller = parse("!InvarianceControl {nominal: !Integral {dead_zone: 0.1}}", "f")
    config = load_scenario({"controller": controller}).controller
    assert config == InvarianceControlConfig(nominal=IntegralConfig(integral_gain=3.0, dead_zone=0.1))
    assert config.reference_model_bandwidth() == 3.0
    with pytest.raises(BadInputError, match=r"controller\.nominal"):
        load_scenario({"controller": parse("!InvarianceControl {nominal: !Nothing {}}", "f")})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma", 0.1),
        ("upper_acceleration", 0.0),
        ("speed_limit", -1.0),
        ("compliance_error", 0.0),
        ("lower_limit", 0.1),
        ("upper_limit", -0.1),
    ],
)
@pytest.mark.parametrize("config", [InvarianceControlConfig, AdaptiveInvarianceControlConfig])
def test_config_checks_itself(config, name, value):
    with pytest.raises(BadInputError, match=name):
        config(**{name: value})


@pytest.mark.parametrize("name", ["forgetting", "initial_covariance", "minimum_force"])
@pytest.mark.parametrize("config", [AdaptiveInvarianceConfig, AdaptiveInvarianceControlConfig])
def test_adaptive_configs_check_the_estimator(config, name):
    with pytest.raises(BadInputError, match=name):
        config(**{name: -1.0})

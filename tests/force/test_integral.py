"""The integral law by its printed recursion, and when its command acts."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.signal import dlsim

from forcectl.errors import BadInputError
from forcectl.force.integral import IntegralConfig, IntegralForceLaw, LinearIntegralForceLaw, dead_zone, integral_step
from forcectl.testing import assert_feedthrough, assert_passes_no_nan, assert_ports, run_diagram
from tests.examples.plant_models import plant_model

PERIOD = 0.002
K_I, C_T = 1.5, 2e-4


def law(**changed: object) -> IntegralForceLaw:
    return IntegralForceLaw(1, **{"integral_gain": K_I, "compliance": C_T, "period": PERIOD, **changed})


def forces(ticks: int = 200) -> np.ndarray:
    return 15.0 + np.cumsum(np.random.default_rng(1).normal(size=ticks))


def commands(
    block: IntegralForceLaw, measured: np.ndarray, desired: float = 15.0, period: float = PERIOD
) -> np.ndarray:
    last = len(measured) - 1
    inputs = {"desired_force": desired, "measured_force": lambda t: measured[min(round(t / period), last)]}
    return run_diagram(block, last * period, period=period, inputs=inputs)["displacement_command"][:, 0]


def test_the_printed_recursion_with_the_force_of_the_same_tick():
    """dx_bar[k] = dx_bar[k-1] - C_T K_I Ts (F_bar - F[k])"""
    measured = forces()
    expected = -np.cumsum(C_T * K_I * PERIOD * (15.0 - measured))
    np.testing.assert_allclose(commands(law(), measured), expected, rtol=1e-12, atol=1e-18)


def test_too_little_force_pushes_further_in():
    assert commands(law(), np.zeros(5))[-1] < 0.0
    assert commands(law(), np.full(5, 30.0))[-1] > 0.0


def test_a_compliance_from_the_port_acts_at_once():
    block = IntegralForceLaw(1, integral_gain=K_I, period=PERIOD)
    inputs = {"desired_force": 15.0, "measured_force": 5.0, "compliance": lambda t: C_T * (1 + t)}
    log = run_diagram(block, 0.1, period=PERIOD, inputs=inputs)
    expected = -np.cumsum(C_T * (1 + log.time) * K_I * PERIOD * 10.0)
    np.testing.assert_allclose(log["displacement_command"][:, 0], expected, rtol=1e-12)


@given(st.floats(-50, 50), st.floats(0, 10))
@settings(max_examples=50)
def test_dead_zone(error, width):
    expected = 0.0 if abs(error) <= width else error - math.copysign(width, error)
    assert float(dead_zone(error, width)) == pytest.approx(expected, abs=1e-12)
    assert float(dead_zone(-error, width)) == -float(dead_zone(error, width))


@given(st.floats(-0.1, 0.1), st.floats(-100, 100), st.floats(0, 1e-3), st.floats(-0.1, 0.0), st.floats(0.0, 0.1))
@settings(max_examples=50)
def test_integral_step(command, error, gain, lower, upper):
    after = float(integral_step(command, error, gain, lower, upper))
    assert lower <= after <= upper
    free = command - gain * error
    if lower <= free <= upper:
        assert after == pytest.approx(free, abs=1e-15)


def test_dead_zone_stops_the_hunting():
    block = law(dead_zone=2.0)
    quiet = 15.0 + 1.9 * np.sin(np.arange(100))
    assert np.all(commands(block, quiet) == 0.0)
    loud = np.full(100, 10.0)  # error 5 N, 3 N of it count
    assert commands(block, loud)[-1] == pytest.approx(-100 * C_T * K_I * PERIOD * 3.0)


def test_limits_are_the_anti_windup():
    """After any time at the limit the first error of the other sign moves the command back at once."""
    block = law(lower_limit=-1e-4, upper_limit=5e-5)
    measured = np.concatenate([np.zeros(500), np.full(300, 30.0)])
    command = commands(block, measured)
    step = C_T * K_I * PERIOD * 15.0
    assert np.min(command) == -1e-4
    assert np.all(command[100:500] == -1e-4)
    np.testing.assert_allclose(command[500:503], -1e-4 + step * np.arange(1, 4), rtol=1e-9)
    assert command[-1] == 5e-5


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("port", ["measured_force", "desired_force", "compliance"])
def test_a_force_that_is_not_a_finite_number_holds_the_last_command(port, bad):
    block = IntegralForceLaw(1, integral_gain=K_I, lower_limit=-0.1, upper_limit=0.1, period=PERIOD)
    usual = {"desired_force": 15.0, "measured_force": 5.0, "compliance": C_T}
    gap = {**usual, port: lambda t: bad if 0.04 < t < 0.08 else usual[port]}
    command = run_diagram(block, 0.16, period=PERIOD, inputs=gap)["displacement_command"][:, 0]
    before = round(0.04 / PERIOD)
    held = round(0.08 / PERIOD) - 1
    assert np.all(command[before : held + 1] == command[before])
    whole = run_diagram(block, 0.16, period=PERIOD, inputs=usual)["displacement_command"][:, 0]
    assert command[held + 3] == pytest.approx(whole[before + 3], rel=1e-12)
    assert_passes_no_nan(block, duration=0.1, period=PERIOD, inputs=usual)


def test_a_nan_from_the_first_tick_on_commands_zero():
    assert np.all(commands(law(), np.full(10, math.nan)) == 0.0)


# --- when the command acts -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("parts", [2, 4, 16])
def test_the_command_is_held_between_ticks(parts):
    """The force changes all the time, the command only at its ticks."""
    fine = PERIOD / parts
    inputs = {"desired_force": 15.0, "measured_force": lambda t: 10.0 * math.sin(300 * t)}
    log = run_diagram(law(), 0.1, period=fine, inputs=inputs)
    command = log["displacement_command"][:, 0]
    ticks = 10.0 * np.sin(300 * PERIOD * np.arange(51))
    expected = np.repeat(-np.cumsum(C_T * K_I * PERIOD * (15.0 - ticks)), parts)[: len(command)]
    np.testing.assert_allclose(command, expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.002, 0.001, 0.0007, 1 / 3000, 0.004, 0.1, 1 / 7])
def test_every_tick_acts_once(period):
    """Round-off in the time neither swallows nor doubles a tick, in long runs and with odd periods."""
    ticks = 20_000
    block = law(period=period)
    log = run_diagram(block, ticks * period, period=ticks * period, inputs={"desired_force": 1.0})
    assert log["displacement_command"][-1, 0] == pytest.approx(-C_T * K_I * period * (ticks + 1), rel=1e-9)


@pytest.mark.parametrize("start", [1234.5, 86_400.002])
def test_a_run_may_start_at_any_time(start):
    block = law()
    context = block.CreateDefaultContext()
    context.SetTime(start)
    log = run_diagram(block, 0.1, period=PERIOD, inputs={"desired_force": 1.0}, context=context)
    steps = np.diff(log["displacement_command"][:, 0]) / (-C_T * K_I * PERIOD)
    assert np.sum(steps) == pytest.approx(50, abs=1.01)
    assert np.all((np.abs(steps) < 1e-6) | (np.abs(steps - 1) < 1e-6)), "a tick acts once or, between ticks, not at all"


def with_plant(block: IntegralForceLaw, plant: System, force: PiecewisePolynomial) -> Diagram:
    """The law reads a force over time and commands a plant."""
    builder = DiagramBuilder()
    builder.AddSystem(block)
    builder.AddSystem(plant)
    measured = builder.AddSystem(TrajectorySource(force))
    desired = builder.AddSystem(ConstantVectorSource([15.0]))
    builder.Connect(measured.get_output_port(), block.GetInputPort("measured_force"))
    builder.Connect(desired.get_output_port(), block.GetInputPort("desired_force"))
    builder.Connect(block.GetOutputPort("displacement_command"), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "plant")
    builder.ExportOutput(block.GetOutputPort("displacement_command"), "displacement_command")
    return builder.Build()


def straight(values: np.ndarray) -> PiecewisePolynomial:
    return PiecewisePolynomial.FirstOrderHold(PERIOD * np.arange(len(values)), values.reshape(1, -1))


def test_a_sampled_plant_sees_the_command_in_its_own_tick():
    """A unit delay at 0.5 ms: the command of t_k is in the plant at t_k + 0.5 ms, not a control tick later."""
    measured = forces(60)
    delay = LinearSystem(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], time_period=PERIOD / 4)
    diagram = with_plant(law(), delay, straight(measured))
    log = run_diagram(diagram, 0.1, period=PERIOD / 4)
    expected = -np.cumsum(C_T * K_I * PERIOD * (15.0 - measured))
    plant = log["plant"][:, 0]
    for k in range(50):
        np.testing.assert_allclose(plant[4 * k + 1 : 4 * k + 5], expected[k], rtol=1e-9, atol=1e-18)


def test_a_plant_of_the_same_rate_sees_the_command_without_delay():
    measured = forces(60)
    accumulate = LinearSystem(A=[[1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], time_period=PERIOD)
    log = run_diagram(with_plant(law(), accumulate, straight(measured)), 0.1, period=PERIOD)
    expected = -np.cumsum(C_T * K_I * PERIOD * (15.0 - measured))[:50]
    np.testing.assert_allclose(log["plant"][1:, 0], np.cumsum(expected), rtol=1e-9, atol=1e-18)


def test_a_continuous_plant_integrates_the_held_command():
    """An integrator gives the sum of the held commands.

    At the end of its step runge_kutta3 sees the command of the next tick, with a weight of one sixth of the step: this
    vanishes with the step.
    """
    measured = forces(60)
    command = -np.cumsum(C_T * K_I * PERIOD * (15.0 - measured))[:51]
    exact = PERIOD * np.cumsum(command[:50])
    weight = PERIOD / 6 * np.cumsum(np.abs(np.diff(command)))
    for parts in (1, 16):
        integrator = LinearSystem(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]])
        log = run_diagram(with_plant(law(), integrator, straight(measured)), 0.1, period=PERIOD / parts)
        assert np.all(np.abs(log["plant"][parts::parts, 0] - exact) <= weight / parts + 1e-15)


def test_the_loop_with_a_spring_is_that_of_the_books():
    """On F = -dx/C with one tick of delay: poles of z - 1 + K_I Ts, no error at rest."""
    builder = DiagramBuilder()
    block = builder.AddSystem(law())
    spring = builder.AddSystem(LinearSystem(A=[[0.0]], B=[[1.0]], C=[[-1 / C_T]], D=[[0.0]], time_period=PERIOD))
    desired = builder.AddSystem(ConstantVectorSource([15.0]))
    builder.Connect(desired.get_output_port(), block.GetInputPort("desired_force"))
    builder.Connect(spring.get_output_port(), block.GetInputPort("measured_force"))
    builder.Connect(block.GetOutputPort("displacement_command"), spring.get_input_port())
    builder.ExportOutput(spring.get_output_port(), "force")
    log = run_diagram(builder.Build(), 4.0, period=PERIOD)
    _, theirs = dlsim(([K_I * PERIOD], [1, K_I * PERIOD - 1], PERIOD), np.full(len(log.time), 15.0))
    np.testing.assert_allclose(log["force"][:, 0], theirs[:, 0], atol=1e-9)
    model = 15.0 * (1 - np.exp(-K_I * log.time))
    np.testing.assert_allclose(log["force"][:, 0], model, atol=15 * K_I * PERIOD)


def test_the_linear_law_gives_the_same_commands():
    measured = forces(100)
    linear = LinearIntegralForceLaw(1, integral_gain=K_I, compliance=C_T, period=PERIOD)
    np.testing.assert_allclose(commands(linear, measured), commands(law(), measured), rtol=1e-9, atol=1e-15)


# --- ports, configuration --------------------------------------------------------------------------------------------


def test_ports():
    assert_ports(law(), {"desired_force": 1, "measured_force": 1}, {"displacement_command": 1})
    block = IntegralForceLaw(3, integral_gain=1.0)
    assert_ports(block, {"desired_force": 3, "measured_force": 3, "compliance": 3}, {"displacement_command": 3})
    assert_feedthrough(block, {("displacement_command", n) for n in ("desired_force", "measured_force", "compliance")})


MODEL = plant_model([3e-5, 2e-5], [1.7e-4, 1e-5])


def test_config_uses_the_compliance_it_is_told_times_its_error():
    block = IntegralConfig(integral_gain=2.0, compliance_error=1.2).add_to(DiagramBuilder(), MODEL)
    command = run_diagram(block, PERIOD, period=PERIOD, inputs={"desired_force": 10.0})["displacement_command"]
    np.testing.assert_allclose(command[0], -1.2 * np.array([2e-4, 3e-5]) * 2.0 * PERIOD * 10.0)
    np.testing.assert_allclose(MODEL.total_compliance, [2e-4, 3e-5])


def test_config_tells_its_nominal_bandwidth():
    assert IntegralConfig(integral_gain=3.0).reference_model_bandwidth() == 3.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("integral_gain", -1.0),
        ("integral_gain", math.nan),
        ("compliance_error", 0.0),
        ("dead_zone", -0.1),
        ("lower_limit", 0.2),
        ("upper_limit", -0.2),
        ("upper_limit", math.nan),
    ],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        IntegralConfig(**{name: value})

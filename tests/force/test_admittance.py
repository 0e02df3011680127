"""The admittance filter by its printed equations, the conditions of stability, and the force law made of it."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem, Multiplexer

from forcectl.errors import BadInputError
from forcectl.force.admittance import (
    ARRANGEMENTS,
    AdmittanceConfig,
    AdmittanceFilter,
    AdmittanceForceLaw,
    admittance_response,
)
from forcectl.plant.plant_model import PlantModel
from forcectl.testing import Log, run_diagram
from tests.examples.plant_models import plant_model
from tests.force.baselines import ideal_plant

TS = 0.004
# Fig. 6.5
K_ENV, D_ENV, H, D, ANGLE = 500.0, 100.0, 0.5, 50.0, 0.2


def model(size: int = 1, period: float = TS) -> PlantModel:
    return plant_model(np.zeros(size), np.full(size, 1e-4), sensor_bandwidth=100.0, period=period)


def law(**changed: Any) -> AdmittanceForceLaw:
    config: dict[str, Any] = {"inertia": H, "damping": D, "lower_limit": -10.0, "upper_limit": 10.0, **changed}
    return AdmittanceConfig(**config).law(model())


def run(block: Any, ticks: int, **inputs: Any) -> Log:
    return run_diagram(block, (ticks - 1) * TS, period=TS, inputs=inputs)


def pressed(block: AdmittanceForceLaw, ticks: int) -> np.ndarray:
    """theta of Fig. 6.5 at t = Ts, 2 Ts, ...: the torque is made of the angle and the speed that are commanded.

    The law presses, so that theta = -dx_bar, and the desired force is the torque at the start.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("law", block)
    state = builder.AddSystem(Multiplexer([1, 1]))
    at_once = LinearSystem(np.zeros((2, 2)), np.eye(2), np.array([[-K_ENV, -D_ENV]]), np.zeros((1, 2)), TS)
    contact = builder.AddNamedSystem("contact", at_once)
    for i in range(2):
        builder.Connect(block.get_output_port(i), state.get_input_port(i))
    builder.Connect(state.get_output_port(), contact.get_input_port())
    builder.Connect(contact.get_output_port(), block.GetInputPort("measured_force"))
    builder.ExportInput(block.GetInputPort("desired_force"), "desired_force")
    builder.ExportOutput(block.GetOutputPort("displacement_command"), "displacement_command")
    log = run(builder.Build(), ticks, desired_force=K_ENV * ANGLE)
    return -log["displacement_command"][:, 0]


@pytest.mark.parametrize(
    ("arrangement", "expected"),
    [("increment", [0.0787, 0.1272, 0.1842, 0.1988]), ("consistent", [0.0566, 0.0976, 0.1628, 0.1931])],
)
def test_fig_6_5_with_the_generator_of_velocities(arrangement, expected):
    angle = pressed(law(arrangement=arrangement), 1000)
    at = [round(t / TS) - 1 for t in (0.1, 0.2, 0.5, 1.0)]
    np.testing.assert_allclose(angle[at], expected, atol=5e-5)
    assert angle.max() <= ANGLE
    assert angle[-1] == pytest.approx(ANGLE, abs=1e-4)


def test_the_generator_of_positions_leaves_an_error_in_the_increment_arrangement_only():
    limits = {"velocity_limit": 1.0, "acceleration_limit": 1000.0, "generator": "position"}
    assert pressed(law(arrangement="consistent", **limits), 1000)[-1] == pytest.approx(ANGLE, abs=1e-4)
    # The value of the design's equations for these limits.
    assert pressed(law(arrangement="increment", **limits), 1000)[-1] == pytest.approx(0.130, abs=5e-4)
    # Limited in acceleration, the state has the speed -a Ts/2, and D_env/2 = D takes all of the error away.
    slow = {**limits, "velocity_limit": 1e3, "acceleration_limit": 100.0}
    assert pressed(law(arrangement="increment", **slow), 1000)[-1] == pytest.approx(ANGLE, abs=1e-4)


def conditions(arrangement: str, K: float, d: float, H: float) -> tuple[float, float]:
    """Both positive: stable, d = D + D_env. (6.7), and the same for the arrangement `consistent`."""
    if arrangement == "increment":
        return d - K * TS, H - TS * (4 * d - K * TS) / 8
    return d - K * TS / 2, H - TS * d / 2


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_the_printed_conditions_are_those_of_the_eigenvalues(arrangement):
    draw = np.random.default_rng(5)
    stable = 0
    for _ in range(1000):
        K, D_env, D, H = 10 ** draw.uniform([2, 0, 0, -2], [5, 3, 3, 1])
        margins = conditions(arrangement, K, D + D_env, H)
        law = admittance_response(H, D, TS, arrangement)
        closed = law.A - law.B @ [[K, D_env]]
        radius = np.abs(np.linalg.eigvals(closed)).max()
        assert (radius < 1) == (min(margins) > 0)
        stable += radius < 1
    assert 200 < stable < 800


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=40))
@settings(max_examples=30, deadline=None)
def test_the_printed_recursion(forces):
    """(6.5) and (6.2) with a generator that stands at 0.3."""
    block = AdmittanceFilter(1, inertia=H, damping=D, initial_position=0.3, period=TS)
    log = run(
        block,
        max(len(forces), 2),
        generated_position=0.3,
        force=lambda t: forces[min(round(t / TS), len(forces) - 1)],
    )
    dx = v = 0.0
    for tick, mu in enumerate(forces):
        dx, v = dx + TS * v + TS**2 / 2 / H * (mu - D * v), v + TS / H * (mu - D * v)
        assert log["position"][tick, 0] == pytest.approx(0.3 + dx, abs=1e-12)
        assert log["velocity"][tick, 0] == pytest.approx(v, abs=1e-12)
        assert log["last_position"][tick, 0] == (log["position"][tick - 1, 0] if tick else 0.3)


def test_the_state_is_what_was_commanded_in_fact():
    """A robot that could not follow: the filter goes on from where the robot is, without a jump back."""
    block = AdmittanceFilter(2, inertia=H, damping=D, corrected=True, period=TS)
    held_x, held_v = 0.002, 0.0
    inputs = {
        "generated_position": lambda t: [0.1 * t, 0.0],
        "generated_velocity": [0.1, 0.0],
        "commanded_position": [held_x, math.nan],
        "commanded_velocity": [held_v, 0.0],
        "force": [5.0, 5.0],
    }
    log = run(block, 200, **inputs)
    t = 199 * TS
    dx, dv = held_x - 0.1 * (t - TS), held_v - 0.1
    a = (5.0 - D * dv) / H
    assert log["position"][-1, 0] == pytest.approx(0.1 * t + dx + TS * dv + TS**2 / 2 * a, abs=1e-12)
    assert log["velocity"][-1, 0] == pytest.approx(0.1 + dv + TS * a, abs=1e-12)
    # What is not a number is no correction: the second one moves as a mass with a damper does, 0.1 m/s.
    assert log["velocity"][-1, 1] == pytest.approx(5.0 / D, rel=1e-6)
    assert log["position"][-1, 1] == pytest.approx(5.0 / D * (200 * TS - H / D), rel=1e-2)


def test_limits_do_not_wind_up():
    log = run(law(lower_limit=-0.01), 400, desired_force=lambda t: 20.0 if t < 0.8 else -20.0)
    command = log["displacement_command"][:, 0]
    assert command.min() == -0.01
    assert log["displacement_velocity_command"][150, 0] == 0.0
    # It leaves the limit in the tick in which the force turns, as from rest.
    assert command[199] == -0.01
    assert command[200] + 0.01 == pytest.approx(TS**2 / 2 / H * 20.0, rel=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("port", ["desired_force", "measured_force"])
def test_a_force_that_is_not_a_number_holds_the_command(bad, port):
    usual = {"desired_force": 20.0, "measured_force": 5.0}
    log = run(law(), 60, **{**usual, port: lambda t: bad if 20 <= round(t / TS) < 40 else usual[port]})
    command, rate = log["displacement_command"][:, 0], log["displacement_velocity_command"][:, 0]
    assert np.all(command[20:40] == command[19])
    assert np.all(rate[20:40] == 0.0)
    assert command[40] - command[39] == pytest.approx(TS**2 / 2 / H * -15.0, rel=1e-9)


def test_as_a_force_law_it_is_an_integral_law_after_h_over_d():
    """dx_bar' = (F - F_bar)/D: with 10 N missing 0.2 m/s into the surface."""
    log = run(law(), 100, desired_force=15.0, measured_force=5.0)
    np.testing.assert_allclose(np.diff(log["displacement_command"][50:, 0]) / TS, -10.0 / D, rtol=1e-9)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@pytest.mark.parametrize("compliance", [ideal_plant.C_T, 0.5 * ideal_plant.C_T])
def test_the_loop_on_the_ideal_plant_is_that_of_the_printed_equations(arrangement, compliance):
    """(6.2), (6.5) and Algorithm 3 with the target velocity 0, around F[k] = -dx_bar[k-1]/C_T."""
    config = AdmittanceConfig(inertia=26.5, damping=2650.0, arrangement=arrangement)
    found = ideal_plant.pressed(config, 1000, compliance)["contact_force"][:, 0]
    Ts = ideal_plant.PERIOD
    x = v = 0.0
    force = [0.0]
    for _ in range(999):
        mu = force[-1] - ideal_plant.FORCE
        # The generator stands, or stops within the tick what the robot moves with.
        stop = -v / Ts if arrangement == "increment" else 0.0
        generated, dx = (x + Ts * v + Ts**2 / 2 * stop, 0.0) if arrangement == "increment" else (0.0, x)
        a = (mu - config.damping * v) / config.inertia
        x, v = generated + dx + Ts * v + Ts**2 / 2 * a, v + Ts * a
        force.append(-x / compliance)
    np.testing.assert_allclose(found, force, rtol=0, atol=1e-9)
    assert force[-1] == pytest.approx(ideal_plant.FORCE, abs=1.0)


def test_parameters_are_in_the_context():
    block = AdmittanceFilter(1, inertia=H, damping=D, period=TS)
    context = block.CreateDefaultContext()
    block.set_parameter(context, "damping", 100.0)
    log = run_diagram(block, 0.4, period=TS, inputs={"force": 10.0}, context=context)
    assert log["velocity"][-1, 0] == pytest.approx(0.1, rel=1e-6)


def test_what_is_not_allowed():
    for size in (0, 7):
        with pytest.raises(BadInputError, match=f"^size = {size}: must be from 1 to 6, the components of a task"):
            AdmittanceFilter(size, inertia=H, damping=D, period=TS)
    with pytest.raises(BadInputError, match=r"^inertia = \[0.1\]: must be above damping times half a tick, \[0.1\]"):
        AdmittanceFilter(1, inertia=0.1, damping=50.0, period=TS)
    with pytest.raises(BadInputError, match="unknown arrangement 'literal': known: consistent, increment"):
        AdmittanceFilter(1, inertia=H, damping=D, arrangement="literal")
    with pytest.raises(BadInputError, match="unknown arrangement 'literal': known: consistent, increment"):
        AdmittanceConfig(arrangement="literal")

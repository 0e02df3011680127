"""The law that is linear in its gains: by its printed transfer functions, at its limits, at a hand-over."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.estimation.recursive_vrft import GAINS
from forcectl.force.linear_law import EXCITE, REGULATE, LinearForceLaw, VrftConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.testing import assert_passes_no_nan, run_diagram

PERIOD = 0.002
PID = (-5.4e-5, -2.5e-4, 2e-7)
C_R = 3.2e-5


def samples(values):
    """An input that takes these values tick by tick, and keeps the last one."""
    return lambda t: values[min(round(t / PERIOD), len(values) - 1)]


def commands(law: LinearForceLaw, measured, output: str = "displacement_command", **inputs: object) -> np.ndarray:
    inputs = {"desired_force": 20.0, "measured_force": samples(measured)} | inputs
    return run_diagram(law, (len(measured) - 1) * PERIOD, period=PERIOD, inputs=inputs)[output][:, 0]


def forces(ticks: int = 300) -> np.ndarray:
    """A force from zero on that wanders."""
    return np.concatenate([[0.0], np.cumsum(np.random.default_rng(2).normal(size=ticks - 1))])


@given(
    st.tuples(*[st.floats(-1e-3, 1e-3)] * 3),
    st.lists(st.floats(-1e-3, 1e-3), max_size=5),
    st.floats(0, 0.02),
    st.floats(0, 1e-4),
)
@settings(max_examples=30, deadline=None)
def test_it_is_the_printed_controller_with_feedback_of_the_robot(gains, fir, filter_time, compliance):
    """(4.13) with the basis (4.20) and, for T_D > 0, the derivative of Sec. 4.3."""
    force = forces(80)
    error = 20.0 - force
    kp, ki, kd = gains
    expected = kp * error + ki * PERIOD * np.cumsum(error) - compliance * force
    expected += lfilter([kd, -kd], [PERIOD + filter_time, -filter_time], error)
    expected += lfilter(fir, [1.0], error) if fir else 0.0
    law = LinearForceLaw(1, gains=gains, fir=fir, derivative_filter=filter_time, robot_compliance=compliance)
    np.testing.assert_allclose(commands(law, force), expected, atol=1e-12, rtol=1e-9)


def test_the_controller_output_is_the_command_without_the_feedback():
    law = LinearForceLaw(1, gains=PID, robot_compliance=C_R, lower_limit=-5e-4)
    force = np.abs(forces())
    u, command = (commands(law, force, output=name) for name in ("controller_output", "displacement_command"))
    assert command.min() == -5e-4
    np.testing.assert_allclose(u - C_R * force, command, atol=1e-15)


def test_it_starts_at_rest_under_the_force_it_finds():
    """With the reference where the force is, nothing moves: not even with a preload."""
    law = LinearForceLaw(1, gains=PID, robot_compliance=C_R)
    np.testing.assert_allclose(commands(law, np.full(50, 7.0), desired_force=7.0), 0.0, atol=1e-18)


def test_at_a_limit_the_integral_stands_still_and_leaves_at_once():
    law = LinearForceLaw(1, gains=(-5e-5, -2.5e-4, 0.0), lower_limit=-2e-3, upper_limit=1e-3)
    force = np.concatenate([np.zeros(2000), np.full(2000, 40.0)])
    command = commands(law, force)
    assert (command >= -2e-3).all()
    assert (command <= 1e-3).all()
    assert command[1999] == -2e-3
    assert command[2000] > -1e-3  # the proportional part turns with the error
    assert command[-1] == 1e-3


@pytest.mark.parametrize("gains", [PID, (-5e-5, 0.0, 0.0)])
def test_without_integral_gain_a_limit_leaves_no_trace(gains):
    free = commands(LinearForceLaw(1, gains=gains), forces())
    if gains[1] == 0.0:
        bound = 0.5 * float(np.abs(free).max())
        limited = commands(LinearForceLaw(1, gains=gains, lower_limit=-bound, upper_limit=bound), forces())
        np.testing.assert_array_equal(limited, np.clip(free, -bound, bound))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_bad_force_holds_the_command_and_is_forgotten(bad):
    law = LinearForceLaw(1, gains=PID, robot_compliance=C_R)
    force = forces(100)
    with_gap = np.insert(force, 50, [bad] * 3)
    command = commands(law, with_gap)
    assert (command[50:53] == command[49]).all()
    np.testing.assert_array_equal(np.delete(command, [50, 51, 52]), commands(law, force))


def test_no_nan_comes_out():
    inputs = {"desired_force": 20.0, "excitation": 1e-3, "mode": REGULATE} | dict(zip(GAINS, PID, strict=True))
    law = LinearForceLaw(1, robot_compliance=C_R, open_loop=True)
    assert_passes_no_nan(law, duration=0.02, period=PERIOD, inputs=inputs)
    two = LinearForceLaw(2, robot_compliance=C_R, open_loop=True)
    assert_passes_no_nan(two, duration=0.02, period=PERIOD, inputs=inputs)


def test_in_open_loop_the_command_is_the_excitation_less_the_robots_part():
    """(4.12)"""
    force, push = forces(), -1e-3 * np.sin(np.arange(300) / 50)
    gains = dict(zip(GAINS, PID, strict=True))
    law = LinearForceLaw(1, robot_compliance=C_R, open_loop=True)
    command = commands(law, force, excitation=samples(push), mode=EXCITE, **gains)
    np.testing.assert_allclose(command, push - C_R * force, atol=1e-18)


@given(st.integers(1, 60), st.floats(0.0, 40.0), st.floats(-3e-3, 3e-3))
@settings(max_examples=25, deadline=None)
def test_the_hand_over_is_bumpless_whatever_the_error(tick, desired, push):
    """In the first tick of regulation the command moves by the integral's own part and the change of the force only."""
    force = 10.0 + 0.1 * np.sin(np.arange(80) / 5)
    law = LinearForceLaw(1, robot_compliance=C_R, open_loop=True)
    command = commands(
        law,
        force,
        desired_force=desired,
        excitation=push,
        mode=lambda t: REGULATE if t > (tick - 0.5) * PERIOD else EXCITE,
        **dict(zip(GAINS, PID, strict=True)),
    )
    change = force[tick] - force[tick - 1]
    before = force[tick - 1] - force[tick - 2] if tick > 1 else force[0] - desired
    expected = PID[1] * PERIOD * (desired - force[tick]) - (PID[0] + C_R) * change
    expected -= PID[2] / PERIOD * (change - before)
    assert command[tick] - command[tick - 1] == pytest.approx(expected, abs=1e-15)


def test_gains_from_ports_may_change_without_a_jump():
    """Constant error: the command goes on with the new integral gain from where it was."""
    law = LinearForceLaw(1)
    gains = {
        "proportional_gain": lambda t: -5e-5 if t < 0.1 else -2e-4,
        "integral_gain": lambda t: -2.5e-4 if t < 0.1 else -1e-4,
        "derivative_gain": 0.0,
    }
    command = commands(law, np.full(100, 15.0), **gains)
    steps = np.diff(command)
    np.testing.assert_allclose(steps[:48], -2.5e-4 * PERIOD * 5.0, rtol=1e-9)
    np.testing.assert_allclose(steps[51:], -1e-4 * PERIOD * 5.0, rtol=1e-9)
    assert np.abs(steps).max() < 3e-6


def test_batch_elements_are_loops_of_their_own():
    gains = [np.array(pair) for pair in ((-5e-5, -1e-5), (-2.5e-4, -1e-4), (0.0, 1e-7))]
    two = LinearForceLaw(2, gains=gains, fir=[[1e-6, 0.0], 2e-6], robot_compliance=[C_R, 0.0], lower_limit=-4e-4)
    force = np.column_stack([forces(), 2 * forces()])
    inputs = {"desired_force": 20.0, "measured_force": samples(force)}
    both = run_diagram(two, 0.5, period=PERIOD, inputs=inputs)["displacement_command"]
    for i in range(2):
        one = LinearForceLaw(
            1,
            gains=[g[i] for g in gains],
            fir=[[1e-6, 0.0][i], 2e-6],
            robot_compliance=[C_R, 0.0][i],
            lower_limit=-4e-4,
        )
        np.testing.assert_array_equal(both[:, i], commands(one, force[:251, i]))


def model() -> PlantModel:
    return PlantModel(1, PERIOD, np.array([C_R]), np.array([1.7e-4]), 12.6, 1.0, 0.0)


def test_the_configuration_gives_the_block_its_gains_and_the_robots_compliance():
    config = VrftConfig(fir=[1e-6], robot_compliance_error=0.5, reference_bandwidth=2.0)
    assert config.reference_model_bandwidth() == 2.0
    law = config.add_to(DiagramBuilder(), model())
    context = law.CreateDefaultContext()
    found = {name: law.parameter(context, name).item() for name in law.parameter_names}
    assert found["proportional_gain"] == -5.37e-5
    assert found["robot_compliance"] == 0.5 * C_R
    assert found["derivative_filter"] == 2 * PERIOD
    assert found["fir_0"] == 1e-6


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("proportional_gain", math.nan),
        ("integral_gain", 1e-4),
        ("derivative_gain", math.inf),
        ("fir", [math.nan]),
        ("derivative_filter", -1.0),
        ("robot_compliance_error", -0.1),
        ("reference_bandwidth", 0.0),
        ("lower_limit", 0.0),
        ("upper_limit", -1.0),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name) as caught:
        VrftConfig(**{name: value})
    assert "\n" not in str(caught.value)


def test_gains_must_be_three():
    with pytest.raises(BadInputError, match="gains has 2 values"):
        LinearForceLaw(1, gains=(-1e-5, -1e-4))

"""Invariance force control of relative degree 2: exact landing, minimum time, moving references and safe behaviour."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.force.invariance.force_law import InvarianceConfig, InvarianceForceLaw, one_step_acceleration
from forcectl.force.invariance.functions import invariance_function
from forcectl.framework.batch import SCALAR_MATH
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status
from forcectl.testing import assert_passes_no_nan, assert_ports, run_diagram

PERIOD = 0.002
brakings = st.floats(1e-3, 1.0)


def minimum_time(force_step, compliance, gamma):
    """From rest to rest over a step [N] at accelerations within gamma."""
    return 2 * np.sqrt(np.abs(force_step) * compliance / -np.asarray(gamma))


def double_integrator(force_step: float, compliance: float, braking: float, start: float = 0.0) -> tuple[float, float]:
    """Overshoot [N] and time [s] until rest of F = -x/C under the one-step acceleration."""
    x, v, rest, highest = -compliance * start, 0.0, 0, 0.0
    ticks = math.ceil(1.5 * minimum_time(force_step, compliance, -braking) / PERIOD) + 20
    final = start + force_step
    for k in range(ticks):
        y = -x - compliance * final
        highest = max(highest, math.copysign(1.0, force_step) * (-x / compliance - final))
        if abs(y) > 1e-9 * abs(force_step) * compliance or abs(v) > 1e-6 * braking * PERIOD:
            rest = k + 1
        a = one_step_acceleration(y, -v, -braking, braking, PERIOD, SCALAR_MATH)
        x, v = x + PERIOD * v - PERIOD**2 * a / 2, v - PERIOD * a
    return highest, rest * PERIOD


@pytest.mark.slow
@given(st.floats(-1e-2, 1e-2), st.floats(-0.1, 0.1), brakings, st.floats(0.1, 10.0))
@settings(max_examples=300)
def test_floats_and_arrays_agree_and_stay_within_the_bounds(y, rate, braking, ratio):
    gamma, upper = -braking, ratio * braking
    a = one_step_acceleration(y, rate, gamma, upper, PERIOD, SCALAR_MATH)
    assert a == one_step_acceleration(np.array([y]), np.array([rate]), gamma, upper, PERIOD).item()
    low, high = (gamma, upper) if y <= 0 else (-upper, -gamma)
    assert low <= a <= high


@pytest.mark.slow
@given(st.floats(-1e-2, 0.0), st.floats(-0.1, 0.1), brakings)
@settings(max_examples=300)
def test_it_is_the_largest_up_to_the_corners_that_keeps_the_constraint_one_step_ahead(y, rate, braking):
    gamma, unit = -braking, braking * PERIOD**2

    def after(a):
        return float(invariance_function([y + PERIOD * rate + PERIOD**2 * a / 2, rate + PERIOD * a], gamma))

    a = one_step_acceleration(y, rate, gamma, braking, PERIOD, SCALAR_MATH)
    if after(gamma) <= 0:
        assert after(a) <= 1e-9 * unit
        if a < braking:
            # The polygon is at most an eighth of a unit smaller than the set itself.
            assert after(a + 1e-6 * braking) > -(1 / 8 + 1e-9) * unit


@given(st.floats(-50.0, 50.0), st.floats(0.0, 50.0), brakings, st.floats(1e3, 1e6))
@settings(max_examples=60, deadline=None)
def test_a_step_from_rest_has_no_overshoot_and_ends_at_rest_in_minimum_time(force_step, start, braking, stiffness):
    overshoot, rest = double_integrator(force_step, 1 / stiffness, braking, start)
    assert overshoot <= 1e-9
    assert rest <= 1.05 * minimum_time(force_step, 1 / stiffness, -braking) + 4 * PERIOD


@pytest.mark.parametrize(
    ("gamma", "at_the_sample", "settling"),
    [(-0.001, 0.054, 0.698), (-0.01, 0.376, 0.222), (-0.05, 0.680, 0.100), (-0.1, 1.000, 0.070)],
)
def test_the_table_of_the_equations(gamma, at_the_sample, settling):
    """15 N at C = 1e-5 m/N: looking one step ahead against testing Phi >= 0 at the sample."""

    def test_at_sample(y, rate):
        return gamma if invariance_function([y, rate], gamma) >= 0 else -gamma

    def one_step(y, rate):
        return one_step_acceleration(y, rate, gamma, -gamma, PERIOD, SCALAR_MATH)

    def force(law):
        x, v, samples = 0.0, 0.0, []
        for _ in range(700):
            samples.append(-x / 1e-5)
            a = law(-x - 15e-5, -v)
            x, v = x + PERIOD * v - PERIOD**2 * a / 2, v - PERIOD * a
        return np.array(samples)

    assert force(test_at_sample)[: round(2 * settling / PERIOD)].max() - 15 == pytest.approx(at_the_sample, abs=0.06)
    ours = force(one_step)
    assert ours.max() - 15 <= 1e-9
    assert np.all(np.abs(ours[-10:] - 15) <= 1e-9), "at rest, no chatter"
    assert np.flatnonzero(np.abs(ours - 15) > 0.3)[-1] * PERIOD == pytest.approx(settling, abs=1.5 * PERIOD)


# --- the block -------------------------------------------------------------------------------------------------------

C_T, GAMMA = 2e-4, -0.1


def law(size: int = 1, **changed) -> InvarianceForceLaw:
    return InvarianceForceLaw(size, **{"gamma": GAMMA, "compliance": C_T, "period": PERIOD, **changed})


def force_of(block: InvarianceForceLaw, desired: Callable | float, duration: float, compliance=C_T, **inputs):
    """Force on the ideal plant, F = -dx_bar/C, shape (ticks, batch elements)."""
    inputs = {"desired_force": desired, "measured_force": 0.0, **inputs}
    command = run_diagram(block, duration, period=PERIOD, inputs=inputs, outputs=["displacement_command"])
    return -command["displacement_command"] / compliance


@pytest.mark.slow
def test_two_hundred_loops_with_steps_up_and_down_have_no_overshoot_and_take_minimum_time():
    rng = np.random.default_rng(3)
    n = 200
    gamma, compliance = -(10 ** rng.uniform(-3, 0, n)), 10 ** rng.uniform(-6, -3, n)
    steps = rng.uniform(0, 50, (3, n))
    longest = [
        minimum_time(b - a, compliance, gamma).max() for a, b in zip([0 * steps[0], *steps[:-1]], steps, strict=True)
    ]
    starts = np.cumsum([0.0, *(np.ceil(1.06 * np.array(longest) / PERIOD) + 6) * PERIOD])

    def desired(t):
        return steps[min(np.searchsorted(starts, t + 1e-9) - 1, 2)]

    force = force_of(law(n, gamma=gamma, compliance=compliance), desired, starts[-1], compliance)
    before = np.zeros(n)
    for i in range(3):
        first, end = round(starts[i] / PERIOD), round(starts[i + 1] / PERIOD)
        part = force[first:end]
        assert np.max((part - steps[i]) * np.sign(steps[i] - before)) <= 1e-9
        late = np.abs(part - steps[i]) > 1e-9
        rest = np.where(late.any(axis=0), (len(part) - np.argmax(late[::-1], axis=0)) * PERIOD, 0.0)
        assert np.all(rest <= 1.05 * minimum_time(steps[i] - before, compliance, gamma) + 4 * PERIOD)
        before = steps[i]


def test_one_batch_element_alone_and_among_others():
    def wave(t):
        return 10 + 8 * math.sin(40 * t) if t > 0.1 else 15.0

    together = force_of(law(3, gamma=[-0.1, -0.2, -0.05], upper_acceleration=0.3), lambda t: np.full(3, wave(t)), 0.5)
    alone = force_of(law(gamma=-0.2, upper_acceleration=0.3), wave, 0.5)
    np.testing.assert_array_equal(together[:, 1], alone[:, 0])


def motion(block: InvarianceForceLaw, duration: float, **inputs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The command, and its velocity and acceleration by differences; zero before the first tick."""
    log = run_diagram(block, duration, period=PERIOD, inputs={"measured_force": 0.0, **inputs})
    command = np.concatenate([[0.0, 0.0], log["displacement_command"][:, 0]])
    velocity = np.diff(command) / PERIOD
    return command, velocity, np.diff(velocity) / PERIOD


GENTLE = -GAMMA * (1 + 1e-6)


def test_a_reference_that_jumps_while_the_command_moves_never_asks_for_more_than_the_accelerations():
    def desired(t):
        return [15.0, 3.0, 25.0, 24.9, 0.0, 10.0][min(int(t / 0.07 + 1e-6), 5)]

    command, velocity, acceleration = motion(law(), 1.2, desired_force=desired)
    assert np.max(np.abs(acceleration)) <= GENTLE
    assert np.max(np.abs(velocity)) > 0.01
    assert -command[-1] / C_T == pytest.approx(10.0, abs=1e-9)


def test_a_changing_compliance_moves_the_set_point_without_jumps():
    block = InvarianceForceLaw(1, gamma=GAMMA, period=PERIOD)
    noise = np.random.default_rng(1).normal(size=200)
    estimates = C_T * np.concatenate([np.full(100, 0.5), 0.9 + 0.01 * noise, np.ones(200)])
    inputs = {"desired_force": 15.0, "compliance": lambda t: estimates[min(round(t / PERIOD), 499)]}
    command, _, acceleration = motion(block, 0.99, **inputs)
    assert np.max(np.abs(acceleration)) <= GENTLE
    assert -command[-1] / C_T == pytest.approx(15.0, abs=1e-9)


def test_a_wrong_compliance_scales_the_force():
    """(3.55): F = (C_T_hat/C_T) F_bar."""
    assert force_of(law(compliance=1.2 * C_T), 15.0, 1.0)[-1, 0] == pytest.approx(18.0, abs=1e-9)


def test_bounds_of_the_motion():
    command, velocity, acceleration = motion(
        law(upper_acceleration=0.3, speed_limit=0.01, lower_limit=-2e-3, upper_limit=1e-3),
        3.0,
        desired_force=lambda t: 15.0 if t < 1.5 else -15.0,
    )
    assert acceleration.min() == pytest.approx(-0.3, rel=1e-6)  # away from rest at the upper acceleration
    assert acceleration.max() <= 0.3 * (1 + 1e-6)
    assert np.max(np.abs(velocity)) == pytest.approx(0.01, rel=1e-6)
    assert command.min() == pytest.approx(-2e-3, abs=1e-15)
    assert command.max() == pytest.approx(1e-3, abs=1e-15)
    braking = acceleration[5 : round(1.5 / PERIOD)]
    assert braking.max() == pytest.approx(-GAMMA, rel=1e-3)


def test_invariance_function_and_status_are_shown():
    log = run_diagram(law(), 0.6, period=PERIOD, inputs={"desired_force": 15.0, "measured_force": 0.0})
    phi, status = log["invariance_function"][:, 0], log["status"][:, 0]
    assert phi[0] == pytest.approx(-15.0 * C_T)
    assert np.all(phi <= 1e-15)
    assert phi[-1] == pytest.approx(0.0, abs=1e-15)
    assert np.all(status == 0)
    down = run_diagram(law(), 0.1, period=PERIOD, inputs={"desired_force": -1.0, "measured_force": 0.0})
    assert down["invariance_function"][0, 0] == pytest.approx(C_T)


# --- references that move --------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.floats(0.02, 0.3), st.floats(0.0, 60.0)), min_size=1, max_size=6),
    st.floats(0.02, 1.0),
    st.floats(1e3, 1e6),
)
@settings(max_examples=40, deadline=None)
def test_a_reference_that_only_rises_is_never_passed(pieces, braking, stiffness):
    """Ramps and rests of any slope, one after the other."""
    times = np.concatenate([[0.0], np.cumsum([duration for duration, _ in pieces])])
    values = np.concatenate([[0.0], np.cumsum([duration * rate for duration, rate in pieces])])

    def desired(t):
        return float(np.interp(t, times, values))

    force = force_of(law(gamma=-braking, compliance=1 / stiffness), desired, times[-1] + 0.02, 1 / stiffness)[:, 0]
    wanted = np.array([desired(k * PERIOD) for k in range(len(force))])
    assert np.max(force - wanted) <= 1e-9


@pytest.mark.parametrize("frequency", [0.2, 1.0, 3.0])
def test_a_sine_is_followed_without_passing_it(frequency):
    """Within the accelerations the force exceeds a smooth reference by less than a thousandth of its amplitude."""
    w, amplitude = 2 * math.pi * frequency, min(5.0, 0.8 * -GAMMA / C_T / (2 * math.pi * frequency) ** 2)

    def desired(t):
        return 15.0 + amplitude * math.sin(w * t)

    force = force_of(law(), desired, 2.0 + 2 / frequency)[:, 0]
    t = PERIOD * np.arange(len(force))
    over = (force - np.array([desired(s) for s in t]))[t > 1.0]
    assert over.max() <= 1e-3 * amplitude
    # Behind it by the distance to stop, which is C F'^2/(-2 gamma) in newtons, and a tick or two.
    assert -over.min() <= C_T * (amplitude * w) ** 2 / (-2 * GAMMA) + 2 * PERIOD * amplitude * w


@pytest.mark.parametrize("rate", [1.0, 5.0, 40.0, 100.0])
def test_a_falling_ramp_is_followed_with_its_speed(rate):
    def desired(t):
        return float(np.interp(t, [1.0, 1.0 + 10.0 / rate], [20.0, 10.0]))

    force = force_of(law(), desired, 2.5 + 10.0 / rate)[:, 0]
    wanted = np.array([desired(k * PERIOD) for k in range(len(force))])
    falls = slice(round(0.9 / PERIOD), None)
    stop = C_T * rate**2 / (-2 * GAMMA)
    assert np.max((force - wanted)[falls]) <= stop + 2 * PERIOD * rate
    assert np.min(force[falls]) >= 10.0 - stop - 2 * PERIOD * rate
    if rate <= 5.0:  # there is time to catch up with it
        middle = round((1.0 + 5.0 / rate) / PERIOD)
        assert force[middle] == pytest.approx(wanted[middle], abs=1e-9 + PERIOD * rate)
    assert force[-1] == pytest.approx(10.0, abs=1e-9)


# --- bad signals and bad input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("port", ["measured_force", "desired_force", "compliance"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("size", [1, 2])
def test_a_signal_that_is_not_finite_brakes_and_holds(port, value, size):
    block = InvarianceForceLaw(size, gamma=GAMMA, period=PERIOD)
    usual = {"desired_force": 15.0, "measured_force": 5.0, "compliance": C_T}
    gap = {**usual, port: lambda t: np.full(size, value if 0.1 < t < 0.5 else usual[port])}
    log = run_diagram(block, 1.5, period=PERIOD, inputs=gap)
    command = np.concatenate([np.zeros(2), log["displacement_command"][:, -1]])
    assert np.max(np.abs(np.diff(command, 2))) <= GENTLE * PERIOD**2
    during = slice(round(0.35 / PERIOD), round(0.5 / PERIOD))
    assert np.ptp(command[during]) == 0.0
    assert -15.0 * C_T < command[during][0] < 0.0
    assert np.all(log["status"][during, -1] == Status.NOT_FINITE)
    assert log["status"][-1, -1] == 0
    assert -command[-1] / C_T == pytest.approx(15.0, abs=1e-9)


def test_never_a_nan():
    usual = {"desired_force": 15.0, "measured_force": 5.0}
    assert_passes_no_nan(law(), duration=0.1, period=PERIOD, inputs=usual)


def test_a_compliance_that_is_not_positive_brakes_and_holds():
    block = InvarianceForceLaw(1, gamma=GAMMA, period=PERIOD)
    log = run_diagram(block, 0.1, period=PERIOD, inputs={"desired_force": 15.0, "compliance": -1e-4})
    assert np.all(log["displacement_command"] == 0.0)
    assert np.all(log["status"] == Status.NOT_FINITE)


def test_ports():
    outputs = {"displacement_command": 3, "invariance_function": 3, "status": 3}
    assert_ports(law(3), {"desired_force": 3, "measured_force": 3}, outputs)
    assert_ports(InvarianceForceLaw(3), {"desired_force": 3, "measured_force": 3, "compliance": 3}, outputs)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma", 0.1),
        ("gamma", 0.0),
        ("gamma", math.inf),
        ("upper_acceleration", 0.0),
        ("speed_limit", 0.0),
        ("speed_limit", math.nan),
        ("compliance_error", -1.0),
        ("lower_limit", 0.1),
        ("upper_limit", -0.1),
    ],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        InvarianceConfig(**{name: value})


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(BadInputError, match="lower_limit"):
        law(lower_limit=0.1, upper_limit=0.0)


def test_config_builds_the_law_with_the_compliance_of_the_loop():
    model = PlantModel(2, PERIOD, np.array([3e-5, 3e-5]), np.array([1e-4, 2e-4]), 12.6, 1.0, 0.0)
    block = InvarianceConfig(gamma=-0.2, compliance_error=1.1).add_to(DiagramBuilder(), model)
    context = block.CreateDefaultContext()
    np.testing.assert_allclose(block.parameter(context, "compliance"), [1.1 * 1.3e-4, 1.1 * 2.3e-4])
    np.testing.assert_array_equal(block.parameter(context, "upper_acceleration"), 0.2)

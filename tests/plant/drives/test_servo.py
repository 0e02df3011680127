"""The drive servo: exact sticking, dead time, and agreement with a fine simulation written independently."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.plant.drives.servo import (
    Servo,
    ServoConfig,
    ServoCore,
    ServoGains,
    servo_gains,
    servo_steps,
    step_coefficients,
)
from forcectl.testing import Log, assert_matches_model, assert_ports, run_diagram, step_response

PERIOD = 0.002
K_V, W_V, W_I, A_C = 25.0, 200.0, 15.0, 1.6
Rates = Callable[[float], tuple[float, float]]


def fine_servo(
    reference: Rates,
    duration: float,
    *,
    a_c: float = A_C,
    b: float = 0.0,
    w_i: float = W_I,
    dt: float = 1e-5,
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at the ticks by explicit Euler with tiny steps; sticking decided by its definition."""
    x = v = integral = 0.0
    per_tick = round(PERIOD / dt)
    positions, velocities = [], []
    for k in range(round(duration / PERIOD) + 1):
        positions.append(x)
        velocities.append(v)
        r, rate = reference(k * PERIOD)
        for j in range(per_tick):
            wanted = K_V * (r + rate * j * dt - x) + rate
            drive = W_V * ((wanted - v) + w_i * integral) - b * v
            if v == 0.0 and abs(drive) <= a_c:
                after = 0.0
            else:
                direction = math.copysign(1.0, v if v != 0.0 else drive)
                after = v + dt * (drive - a_c * direction)
                if v != 0.0 and after * v < 0.0:
                    after = 0.0  # friction stops, it does not reverse
            integral += dt * (wanted - v)
            x += dt * v
            v = after
    return np.array(positions), np.array(velocities)


def drive_servo(reference: Rates, duration: float, **parameters: float) -> Log:
    servo = Servo(ServoCore(1, period=PERIOD, unit="m", **parameters))
    return run_diagram(servo, duration, period=PERIOD, inputs={"reference": reference})


def reversing(t: float) -> tuple[float, float]:
    return 1e-3 * math.sin(8 * t), 8e-3 * math.cos(8 * t)


def small(t: float) -> tuple[float, float]:
    """So small that the friction holds the drive for a while after every reversal."""
    return 3e-4 * math.sin(4 * t), 1.2e-3 * math.cos(4 * t)


def filtered_step(t: float) -> tuple[float, float]:
    return 1e-3 * (1 - (1 + 75.4 * t) * math.exp(-75.4 * t)), 1e-3 * 75.4**2 * t * math.exp(-75.4 * t)


@pytest.mark.parametrize("reference", [reversing, small, filtered_step])
@pytest.mark.parametrize("a_c", [0.0, A_C])
def test_agrees_with_a_fine_simulation(reference, a_c):
    """The design's bound: steps of 0.06 to 0.5 ms give the same within 0.5 %."""
    position, velocity = fine_servo(reference, 0.6, a_c=a_c)
    log = drive_servo(reference, 0.6, coulomb_friction=a_c)
    assert np.max(np.abs(log["position"][:, 0] - position)) < 0.005 * np.max(np.abs(position))
    finer = drive_servo(reference, 0.6, coulomb_friction=a_c, substeps=64)
    assert np.max(np.abs(finer["velocity"][:, 0] - velocity)) < 0.02 * np.max(np.abs(velocity))


def test_agrees_with_a_fine_simulation_with_viscous_friction():
    position, _ = fine_servo(reversing, 0.5, b=30.0)
    log = drive_servo(reversing, 0.5, viscous_friction=30.0)
    assert np.max(np.abs(log["position"][:, 0] - position)) < 0.005 * np.max(np.abs(position))


@pytest.mark.parametrize("reference", [reversing, small, filtered_step])
def test_the_number_of_inner_steps_does_not_matter(reference):
    positions = [drive_servo(reference, 0.8, substeps=n)["position"] for n in (2, 4, 8, 16, 32)]
    for position in positions[:-1]:
        assert np.max(np.abs(position - positions[-1])) < 0.005 * np.max(np.abs(positions[-1]))


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_sticks_exactly_until_the_integral_breaks_it_loose(share):
    """A small offset r: the drive asks for a = w_v K_v r (1 + w_i t), so v = 0.0 until that exceeds a_c."""
    r = share * A_C / (W_V * K_V)
    breakaway = (1 / share - 1) / W_I
    log = drive_servo(lambda t: (r, 0.0), 0.4, substeps=8)
    stuck = log.time < breakaway - PERIOD
    assert np.all(log["velocity"][stuck] == 0.0)
    assert np.all(log["position"][stuck] == 0.0)
    assert log["velocity"][log.time > breakaway + 2 * PERIOD][0] > 0.0


def test_without_integral_it_sticks_for_ever():
    r = 0.999 * A_C / (W_V * K_V)
    log = drive_servo(lambda t: (r, 0.0), 1.0, integral_gain=0.0)
    assert np.all(log["velocity"] == 0.0)
    assert np.all(log["position"] == 0.0)
    moved = drive_servo(lambda t: (1.002 * r, 0.0), 1.0, integral_gain=0.0)
    assert moved["velocity"][1, 0] > 0.0


def test_it_comes_to_a_dead_stop():
    """A drive that would overshoot is stopped by the friction and held: v is exactly zero, x no longer changes."""
    log = drive_servo(lambda t: (1e-3, 0.0), 1.0, integral_gain=0.0, velocity_gain=60.0, position_gain=50.0)
    velocity, position = log["velocity"][:, 0], log["position"][:, 0]
    assert velocity[1] > 0
    still = np.flatnonzero(velocity == 0.0)[1:]
    assert np.all(np.diff(still) == 1)
    assert still[-1] == len(velocity) - 1
    assert np.ptp(position[still]) == 0.0
    assert abs(1e-3 - position[-1]) * 50 * 60 <= A_C


def test_steady_motion_lags_by_what_friction_needs():
    """At constant speed without integral: w_v K_v (r - x) = a_c + b v."""
    speed, b = 0.05, 12.0
    log = drive_servo(lambda t: (speed * t, speed), 1.5, integral_gain=0.0, viscous_friction=b)
    lag = speed * log.time[-1] - log["position"][-1, 0]
    assert lag == pytest.approx((A_C + b * speed) / (W_V * K_V), rel=1e-6)
    assert log["velocity"][-1, 0] == pytest.approx(speed, rel=1e-9)


@pytest.mark.parametrize("b", [0.0, 20.0])
def test_without_coulomb_friction_it_is_linear(b):
    """X/R = w_v K_v (s + w_i)/(s^3 + b s^2 + w_v (s + w_i)(s + K_v)) for a step in the reference without its rate."""
    servo = Servo(ServoCore(1, coulomb_friction=0.0, viscous_friction=b, substeps=64))
    response = step_response(servo, "reference", "position", 1.0, duration=0.6, period=PERIOD, input_index=0, others={})
    numerator = [W_V * K_V, W_V * K_V * W_I]
    denominator = [1, b + W_V, W_V * (K_V + W_I), W_V * K_V * W_I]
    assert_matches_model(response, (numerator, denominator), rtol=0.005)


def test_linear_response_scales_with_its_input():
    one, ten = (drive_servo(lambda t, s=s: (s * 1e-3, 0.0), 0.4, coulomb_friction=0.0) for s in (1.0, 10.0))
    np.testing.assert_allclose(ten["position"], 10 * one["position"], rtol=1e-12, atol=1e-18)


def test_friction_takes_energy_out():
    """The same command with more friction never gives more kinetic energy in the first push."""
    peaks = [
        np.max(drive_servo(filtered_step, 0.2, coulomb_friction=a_c, viscous_friction=b)["velocity"] ** 2)
        for a_c, b in ((0.0, 0.0), (A_C, 0.0), (A_C, 30.0), (4 * A_C, 30.0))
    ]
    assert peaks == sorted(peaks, reverse=True)
    assert len(set(peaks)) == len(peaks)


def test_starts_where_it_is_told_and_stays():
    servo = Servo(ServoCore(2, initial_position=[0.1, -0.2]))
    log = run_diagram(servo, 0.2, period=PERIOD, inputs={"reference": [0.1, -0.2, 0.0, 0.0]})
    assert np.all(log["position"] == [0.1, -0.2])
    assert np.all(log["velocity"] == 0.0)


def test_the_reference_moves_on_with_its_rate_inside_a_tick():
    """A sampled ramp with its rate is followed as the continuous ramp is."""
    position, _ = fine_servo(lambda t: (0.02 * t, 0.02), 0.4, a_c=0.0)
    log = drive_servo(lambda t: (0.02 * t, 0.02), 0.4, coulomb_friction=0.0, substeps=16)
    assert np.max(np.abs(log["position"][:, 0] - position)) < 0.002 * position[-1]


@given(
    st.floats(-1e-2, 1e-2),
    st.floats(-0.5, 0.5),
    st.floats(-1e-2, 1e-2),
    st.floats(-1e-2, 1e-2),
    st.floats(0.0, 5.0),
    st.integers(1, 32),
)
@settings(max_examples=50)
def test_one_step_is_the_soft_threshold(x, v, i, r, coulomb, count):
    """One inner step by its printed form, repeated."""
    dt = PERIOD / count
    gains = step_coefficients(ServoGains(K_V, W_V, W_I), coulomb, 2.0, dt)
    mine = (x, v, i)
    for k in range(count):
        wanted = K_V * (r + 0.3 * k * dt - mine[0]) + 0.3
        # v+ (1 + dt (w_v (1 + w_i dt) + b)) = soft(v + dt w_v ((1 + w_i dt) v_r + w_i i), dt a_c): implicit in v and i
        free = mine[1] + dt * W_V * ((1 + W_I * dt) * wanted + W_I * mine[2])
        free = math.copysign(max(abs(free) - dt * coulomb, 0.0), free)
        after = free / (1 + dt * (W_V * (1 + W_I * dt) + 2.0))
        mine = (mine[0] + dt * after, after, mine[2] + dt * (wanted - after))
    x1, v1, i1 = servo_steps(x, v, i, r, 0.3, 0.0, gains, count)
    reached = np.array([x1, v1, i1], dtype=float)
    np.testing.assert_allclose(reached, mine, rtol=1e-12, atol=1e-15)


@given(st.floats(-1.0, 1.0), st.floats(0.0, 3.0), st.integers(1, 16))
@settings(max_examples=50)
def test_a_push_below_the_friction_moves_nothing(share, coulomb, count):
    """At rest on its reference, a load below a_c leaves v exactly zero; beyond it the drive gives way."""
    dt = PERIOD / count
    gains = step_coefficients(ServoGains(K_V, W_V, W_I), coulomb, 0.0, dt)
    x, v, i = servo_steps(0.0, 0.0, 0.0, 0.0, 0.0, share * coulomb * dt, gains, count)
    assert (x, v, i) == (0.0, 0.0, 0.0)
    *_, pushed, _ = servo_steps(0.0, 0.0, 0.0, 0.0, 0.0, (1.5 * coulomb + 0.1) * dt, gains, 1)
    assert pushed > 0.0


def test_ports_and_units():
    assert_ports(ServoCore(3), {"reference": 6}, {"state": 9})
    servo = Servo(ServoCore(3, unit="m"))
    assert_ports(servo, {"reference": 6}, {"position": 3, "velocity": 3})
    assert servo.port_units == {"reference": "m,m/s", "position": "m", "velocity": "m/s"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"substeps": 0}, "substeps"),
        ({"substeps": -1}, "substeps"),
        ({"substeps": 1.5}, "substeps"),
        ({"position_gain": 0.0}, "position_gain"),
        ({"velocity_gain": [1.0, -1.0]}, "velocity_gain"),
        ({"initial_position": math.nan}, "initial_position"),
        ({"initial_position": [0.0] * 3}, "initial_position"),
    ],
)
def test_bad_arguments_are_refused(arguments, told):
    with pytest.raises(BadInputError, match=told):
        ServoCore(2, **arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("position_gain", 0.0),
        ("velocity_gain", -1.0),
        ("integral_gain", -1.0),
        ("coulomb_friction", -1.0),
        ("coulomb_friction", math.nan),
        ("friction_scale", -0.1),
        ("tuned_for", "motors"),
        ("substeps", 0),
    ],
)
def test_config_checks_itself(name, value):
    with pytest.raises(BadInputError, match=name):
        ServoConfig(**{name: value})


def test_velocity_gain_on_the_rotor_is_that_of_the_inertia_the_loop_is_tuned_for():
    rotors, axes, unknown = np.array([2.0, 0.5]), np.array([6.0, 0.4]), np.zeros(0)
    np.testing.assert_allclose(ServoConfig().gains(rotors, axes).velocity, [600.0, 160.0])
    np.testing.assert_allclose(ServoConfig(tuned_for="rotors").gains(rotors, axes).velocity, [200.0, 200.0])
    np.testing.assert_allclose(ServoConfig(velocity_gain=50.0).gains(rotors, unknown).velocity, [50.0, 50.0])


def test_gains_place_the_poles_of_the_position_loop():
    """s^2 + w_v s + w_v K_v of an axis without friction, integral and feed-forward."""
    gains = servo_gains(80.0, 0.7, 12.0)
    assert gains.velocity == pytest.approx(2 * 0.7 * 80.0)
    assert gains.velocity * gains.position == pytest.approx(80.0**2)
    assert gains.integral == 12.0


def test_config_adds_the_block():
    def lag(config: ServoConfig) -> float:
        servo = config.add_to(DiagramBuilder(), 1, PERIOD)
        log = run_diagram(servo, 1.5, period=PERIOD, inputs={"reference": lambda t: (0.05 * t, 0.05)})
        return 0.05 * log.time[-1] - log["position"][-1, 0]

    one = lag(ServoConfig(integral_gain=0.0))
    assert one == pytest.approx(A_C / (W_V * K_V), rel=1e-6)
    assert lag(ServoConfig(integral_gain=0.0, coulomb_friction=4.0)) == pytest.approx(2.5 * one, rel=1e-6)
    assert lag(ServoConfig(integral_gain=0.0, coulomb_friction=0.0)) == pytest.approx(0.0, abs=1e-12)
    assert lag(ServoConfig(integral_gain=0.0, position_gain=50.0)) == pytest.approx(one / 2, rel=1e-6)

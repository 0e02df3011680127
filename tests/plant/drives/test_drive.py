"""The drives of the elastic robot, C++ blocks, against the equations of the Python servo."""

import math

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.plant.drives.drive import Drive
from forcectl.plant.drives.motors import joint_to_motor
from forcectl.plant.drives.servo import ServoGains, servo_steps, step_coefficients
from forcectl.testing import assert_ports, run_diagram

STEP = 0.0005
GAINS = {"position_gain": 25.0, "velocity_gain": 200.0, "integral_gain": 15.0}
INERTIA = np.array([10.2, 12.3, 9.3, 0.11, 0.27, 0.105])
COULOMB = np.array([37.7, 51.8, 30.2, 4.5, 5.8, 5.3])
VISCOUS = np.array([33.5, 47.1, 42.3, 1.77, 5.13, 1.14])


def make(n: int = 6, **changed: object) -> Drive:
    arguments: dict[str, object] = {
        "inertia": INERTIA[:n],
        "to_motor": np.eye(n),
        "period": STEP,
        "substeps": 1,
        **GAINS,
        "coulomb_friction": COULOMB[:n],
        "viscous_friction": VISCOUS[:n],
        "initial_position": np.zeros(n),
        "initial_torque": np.zeros(n),
        **changed,
    }
    inertia, to_motor = arguments.pop("inertia"), arguments.pop("to_motor")
    gains = ServoGains(*(arguments.pop(f"{name}_gain") for name in ServoGains._fields))
    return Drive(inertia, to_motor, gains, **arguments)


def walk(generator: np.random.Generator, steps: int, n: int, size: float) -> np.ndarray:
    return np.cumsum(generator.normal(size=(steps, n)), axis=0) * size


def held(rows: np.ndarray):
    return lambda t: rows[min(round(t / STEP), len(rows) - 1)]


@pytest.mark.parametrize("substeps", [1, 2, 3, 5])
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_equals_the_servo_equations(seed, coupled, substeps):
    """Sampled reference, rate and spring torque of any size; with a coupling, in motor angles phi = S q."""
    generator = np.random.default_rng(seed)
    n, steps = 6, 300
    S = np.eye(n)
    if coupled:
        S += np.tril(generator.normal(scale=0.1, size=(n, n)), -1)
    q0, tau0 = generator.normal(size=n), generator.normal(size=n) * 20
    r = q0 + walk(generator, steps, n, 1e-3)
    rate = walk(generator, steps, n, 0.05)
    tau = tau0 + walk(generator, steps, n, 5.0)
    w_v = generator.uniform(100.0, 500.0, size=n)
    drive = make(n, to_motor=S, velocity_gain=w_v, substeps=substeps, initial_position=q0, initial_torque=tau0)
    log = run_diagram(
        drive,
        (steps - 1) * STEP,
        period=STEP,
        inputs={"reference": held(np.hstack([r, rate])), "spring_torque": held(tau)},
    )

    gains = step_coefficients(ServoGains(25.0, w_v, 15.0), COULOMB / INERTIA, VISCOUS / INERTIA, STEP / substeps)
    back = np.linalg.inv(S)
    x, v = S @ q0, np.zeros(n)
    i = back.T @ tau0 / INERTIA / (w_v * 15.0)  # the integral carries the load at rest
    stuck = 0
    for k in range(steps):
        scale = max(1.0, float(np.max(np.abs(x))))
        np.testing.assert_allclose(log["motor_position"][k], back @ x, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(log["motor_velocity"][k], back @ v, rtol=0, atol=1e-11 * max(1, np.max(np.abs(v))))
        np.testing.assert_array_equal(
            log["motor_state"][k], np.concatenate([log["motor_position"][k], log["motor_velocity"][k]])
        )
        stuck += int(np.sum(v == 0.0))
        push = -(back.T @ tau[k]) / INERTIA * STEP / substeps
        x, v, i = servo_steps(x, v, i, S @ r[k], S @ rate[k], push, gains, substeps)
    assert 0 < stuck < n * steps, "the case has both sticking and moving drives"


@pytest.mark.parametrize("substeps", [1, 2])
def test_sticks_exactly(substeps):
    """Below the friction nothing moves, although the spring torque changes."""
    drive = make(2, integral_gain=1e-9, substeps=substeps)
    torque = held(0.9 * COULOMB[:2] * np.sin(0.3 * np.arange(400))[:, None])
    log = run_diagram(drive, 399 * STEP, period=STEP, inputs={"spring_torque": torque})
    assert np.all(log["motor_velocity"] == 0.0)
    assert np.all(log["motor_position"] == 0.0)
    broken = held(1.1 * COULOMB[:2] * np.ones((400, 1)))
    log = run_diagram(drive, 20 * STEP, period=STEP, inputs={"spring_torque": broken})
    assert np.all(log["motor_velocity"][1:3] < 0.0), "a torque of the springs on the links turns the motors back"


def test_friction_holds_an_axis_back_by_its_own_velocity_gain():
    """c/(B w_v K_v) while a reference moves on evenly, without integral: each axis by its own w_v."""
    w_v, speed = np.array([200.0, 400.0]), 0.05
    drive = make(2, velocity_gain=w_v, integral_gain=1e-9, viscous_friction=np.zeros(2))
    log = run_diagram(drive, 1.5, period=STEP, inputs={"reference": lambda t: [speed * t, speed * t, speed, speed]})
    lag = speed * log.time[-1] - log["motor_position"][-1]
    np.testing.assert_allclose(lag, COULOMB[:2] / (INERTIA[:2] * w_v * 25.0), rtol=1e-6)


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_rest_with_the_initial_torque_stays_rest(friction):
    q0, tau0 = np.array([0.3, -0.8, 1.2, 0.0, 0.5, -2.0]), np.array([0.0, -333.0, 38.0, 0.7, -0.5, 0.1])
    S = np.eye(6)
    S[5, 4] = -0.02
    drive = make(to_motor=S, coulomb_friction=friction * COULOMB, initial_position=q0, initial_torque=tau0)
    reference = np.concatenate([q0, np.zeros(6)])
    log = run_diagram(drive, 1.0, period=STEP, inputs={"reference": reference, "spring_torque": tau0})
    np.testing.assert_allclose(log["motor_position"], np.tile(q0, (len(log.time), 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(log["motor_velocity"], 0.0, atol=1e-12)


def test_no_friction_and_no_load_is_the_linear_servo():
    """The integral removes a constant load completely."""
    drive = make(1, inertia=[2.0], coulomb_friction=[0.0], viscous_friction=[0.0])
    log = run_diagram(drive, 3.0, period=0.005, inputs={"reference": [0.1, 0.0], "spring_torque": [40.0]})
    assert log["motor_position"][-1, 0] == pytest.approx(0.1, rel=1e-6)


def test_motor_6_turns_with_joint_5(robot):
    """Motor 6 held by its brake: joint 5 moving by dq5 takes joint 6 along by 0.02 dq5, so that motor 6 stands."""
    S = joint_to_motor(robot)
    friction = np.zeros(6)
    friction[5] = 1e6
    drive = make(to_motor=S, coulomb_friction=friction)
    goal = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
    log = run_diagram(drive, 3.0, period=0.01, inputs={"reference": np.concatenate([goal, np.zeros(6)])})
    q = log["motor_position"]
    assert q[-1, 4] == pytest.approx(0.5, rel=1e-4)
    np.testing.assert_allclose(q[:, 5], 0.02 * q[:, 4], atol=1e-12)
    free = make(to_motor=S, coulomb_friction=np.zeros(6))
    log = run_diagram(free, 3.0, period=0.01, inputs={"reference": np.concatenate([goal, np.zeros(6)])})
    np.testing.assert_allclose(log["motor_position"][-1], goal, atol=1e-5)


def test_a_torque_on_joint_6_is_felt_by_motor_5(robot):
    """Power is the same on both sides: tau_phi = S^-T tau_q, so motor 5 carries tau5 + 0.02 tau6."""
    arguments = {"to_motor": joint_to_motor(robot), "coulomb_friction": np.zeros(6), "viscous_friction": np.zeros(6)}
    torque = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 10.0])
    log = run_diagram(make(**arguments), 2 * STEP, period=STEP, inputs={"spring_torque": torque})
    equal = np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.0])
    other = run_diagram(make(**arguments), 2 * STEP, period=STEP, inputs={"spring_torque": equal})
    assert log["motor_velocity"][1, 4] < 0.0
    assert log["motor_velocity"][1, 4] == pytest.approx(other["motor_velocity"][1, 4], rel=1e-12)


def test_ports():
    assert_ports(
        make(),
        {"reference": 12, "spring_torque": 6},
        {"motor_state": 12, "motor_position": 6, "motor_velocity": 6},
    )


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"inertia": [1.0] * 5 + [0.0]}, "inertia"),
        ({"inertia": [1.0] * 5 + [math.nan]}, "inertia"),
        ({"inertia": [math.inf] * 6}, "inertia"),
        ({"period": 0.0}, "period"),
        ({"position_gain": -1.0}, "position_gain"),
        ({"velocity_gain": 0.0}, "velocity_gain"),
        ({"integral_gain": 0.0}, "integral_gain"),
        ({"coulomb_friction": [-1.0] * 6}, "coulomb_friction"),
        ({"coulomb_friction": [1.0] * 5}, "coulomb_friction"),
        ({"viscous_friction": [-1.0] * 6}, "viscous_friction"),
        ({"initial_position": np.zeros(5)}, "initial_position"),
        ({"initial_torque": np.full(6, np.nan)}, "initial_torque"),
        ({"to_motor": np.ones((6, 5))}, "to_motor"),
        ({"substeps": 0}, "substeps"),
        ({"to_motor": np.zeros((6, 6))}, "to_motor"),
    ],
)
def test_bad_arguments_are_refused(changed, told):
    with pytest.raises(BadInputError, match=told):
        make(**changed)

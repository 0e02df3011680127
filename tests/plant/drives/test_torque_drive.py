"""Torque-controlled drives, C++ blocks, against their equations."""

import math

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.plant.drives.torque_drive import TorqueDrive
from forcectl.testing import Log, run_diagram

STEP = 0.001
INERTIA = np.array([10.2, 12.3, 9.3, 0.11, 0.27, 0.105])
COULOMB = np.array([37.7, 51.8, 30.2, 4.5, 5.8, 5.3])
VISCOUS = np.array([33.5, 47.1, 42.3, 1.77, 5.13, 1.14])


def make(n: int = 6, **changed: object) -> TorqueDrive:
    arguments: dict[str, object] = {
        "inertia": INERTIA[:n],
        "to_motor": np.eye(n),
        "period": STEP,
        "torque_gain": 0.0,
        "friction_bandwidth": 0.0,
        "torque_limit": np.inf,
        "coulomb_friction": COULOMB[:n],
        "viscous_friction": VISCOUS[:n],
        "initial_position": np.zeros(n),
        **changed,
    }
    inertia, to_motor = arguments.pop("inertia"), arguments.pop("to_motor")
    return TorqueDrive(inertia, to_motor, **arguments)


def run(drive: TorqueDrive, duration: float, command: object, spring: object = 0.0) -> Log:
    return run_diagram(drive, duration, period=STEP, inputs={"torque_command": command, "spring_torque": spring})


def held(rows: np.ndarray):
    return lambda t: rows[min(round(t / STEP), len(rows) - 1)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize(("gain", "bandwidth"), [(0.0, 0.0), (4.0, 0.0), (0.0, 100.0), (4.0, 300.0)])
def test_equals_its_equations(seed, coupled, gain, bandwidth):
    """Random torques; with a coupling, in motor angles phi = S q."""
    random = np.random.default_rng(seed)
    n, steps = 6, 200
    S = np.eye(n) + coupled * np.tril(random.normal(scale=0.1, size=(n, n)), -1)
    limit = 4 * COULOMB
    q0 = random.normal(size=n)
    told, springs = (np.cumsum(random.normal(size=(steps, n)), axis=0) * COULOMB / 5 for _ in range(2))
    drive = make(to_motor=S, torque_gain=gain, friction_bandwidth=bandwidth, torque_limit=limit, initial_position=q0)
    log = run(drive, (steps - 1) * STEP, held(told), held(springs))
    back = np.linalg.inv(S)
    phi, v, seen = S @ q0, np.zeros(n), np.zeros(n)
    stuck = limited = 0
    for k in range(steps):
        scale = max(1.0, np.abs(phi).max(), np.abs(v).max())
        np.testing.assert_allclose(log["motor_position"][k], back @ phi, atol=1e-11 * scale, rtol=0)
        np.testing.assert_allclose(log["motor_velocity"][k], back @ v, atol=1e-10 * scale, rtol=0)
        load = back.T @ springs[k]
        motor = np.clip(back.T @ (told[k] + gain * (told[k] - springs[k])) + seen, -limit, limit)
        np.testing.assert_allclose(log["motor_torque"][k], motor, atol=1e-8, rtol=0)
        free = v + STEP / INERTIA * (motor - load)
        after = np.copysign(np.maximum(np.abs(free) - STEP * COULOMB / INERTIA, 0), free) / (
            1 + STEP * VISCOUS / INERTIA
        )
        friction = motor - load - INERTIA * (after - v) / STEP
        seen = seen + (1 - math.exp(-STEP * bandwidth)) * (friction - seen)
        stuck, limited = stuck + int((after == 0).sum()), limited + int((np.abs(motor) == limit).sum())
        phi, v = phi + STEP * after, after
    assert 0 < stuck < n * steps
    assert limited > 0


def test_a_torque_below_the_friction_moves_nothing():
    log = run(make(2), 1.0, lambda t: 0.9 * COULOMB[:2] * math.sin(9 * t))
    assert not log["motor_velocity"].any()
    assert not log["motor_position"].any()


def test_the_torque_loop_divides_inertia_and_friction():
    """Four fifths of the torque that breaks the friction loose are the loop's."""
    assert not run(make(1, torque_gain=4.0), 0.5, 0.19 * COULOMB[0])["motor_position"].any()
    assert run(make(1, torque_gain=4.0), 0.5, 0.21 * COULOMB[0])["motor_position"][-1] > 0
    smooth = make(1, torque_gain=4.0, coulomb_friction=0.0, viscous_friction=0.0)
    assert run(smooth, 0.1, 2.0)["motor_velocity"][-1] == pytest.approx(5 * 2.0 * 0.1 / INERTIA[0])


def test_the_observer_makes_up_for_the_friction():
    """As without friction, but for the time that it takes to see it; at rest the springs' torque is the one told."""
    smooth = run(make(1, coulomb_friction=0.0, viscous_friction=0.0), 1.0, 5.0)["motor_velocity"][:, 0]
    seen = run(make(1, friction_bandwidth=200.0), 1.0, 5.0)["motor_velocity"][:, 0]
    assert not run(make(1), 1.0, 5.0)["motor_velocity"].any()
    # Stuck while w_F * 5 Nm per second reach the friction.
    still = COULOMB[0] / (200.0 * 5.0)
    moving = np.flatnonzero(seen)[0] * STEP
    assert moving == pytest.approx(still, abs=2 * STEP)
    assert np.ptp((smooth - seen)[round((moving + 0.05) / STEP) :]) < 0.05 * smooth[-1]


def test_a_motor_on_a_spring_comes_to_carry_the_torque_that_is_told():
    k = 4e4
    drive = make(1, torque_gain=4.0, friction_bandwidth=100.0)
    torques = []
    context = drive.CreateDefaultContext()
    for _ in range(2000):
        q = float(drive.GetOutputPort("motor_position").Eval(context)[0])
        v = float(drive.GetOutputPort("motor_velocity").Eval(context)[0])
        torques.append(k * q)
        drive.GetInputPort("spring_torque").FixValue(context, [k * q])
        drive.GetInputPort("torque_command").FixValue(context, [20.0 - 400.0 * v])
        following = drive.AllocateDiscreteVariables()
        drive.CalcForcedDiscreteVariableUpdate(context, following)
        context.SetDiscreteState(following)
    assert torques[-1] == pytest.approx(20.0, rel=0.01)


def test_motors_give_no_more_than_their_limit():
    log = run(make(1, torque_limit=50.0, torque_gain=4.0), 0.1, 1e4)
    assert (log["motor_torque"] == 50.0).all()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"inertia": [1.0] * 5 + [0.0]}, "inertia"),
        ({"period": 0.0}, "period"),
        ({"torque_gain": -1.0}, "torque_gain"),
        ({"torque_gain": math.nan}, "torque_gain"),
        ({"friction_bandwidth": -1.0}, "friction_bandwidth"),
        ({"torque_limit": [1.0] * 5 + [0.0]}, "torque_limit"),
        ({"coulomb_friction": [-1.0] * 6}, "coulomb_friction"),
        ({"viscous_friction": [1.0] * 5}, "viscous_friction"),
        ({"initial_position": np.full(6, np.nan)}, "initial_position"),
        ({"to_motor": np.zeros((6, 6))}, "to_motor"),
        ({"to_motor": np.ones((6, 5))}, "to_motor"),
    ],
)
def test_bad_arguments_are_refused(changed, told):
    with pytest.raises(BadInputError, match=told):
        make(**changed)

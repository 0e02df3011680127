"""The dither of joints: all of them move, the tool hardly does, and nothing leaves its limits."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from forcectl.errors import BadInputError
from forcectl.motion.joint_dither import JointDither
from forcectl.robot.model import RobotModel

ROBOT = RobotModel.load("yumi", "yumi_gripper")
ARMS = {name: arm.joints for name, arm in ROBOT.parts.arms.items()}
POSTURE = np.radians([15, -107, 122, 25, -35, 29, 36, 0, -125, -126, 35, 24, 21, -15])
# The wrist of the right arm is nearly straight: no self-motion moves its first joints.
STRAIGHT = np.radians([5, -109, 127, -9, 5, 76, -37, -3, -118, -136, -2, 1, 6, -34])
TICK, AMPLITUDE, HALF = 0.004, 1e-3, 16  # ticks in half a period of 8 Hz, 64 ms


def block(**options):
    return JointDither(ROBOT, POSTURE, **{"amplitude": AMPLITUDE, "frequency": 8.0, **options})


def run(dither, ticks, position=POSTURE, speed=None):
    """Positions and speeds with the dither at each tick, for commands that are constant or functions of time."""
    context = dither.CreateDefaultContext()
    found = []
    for tick in range(ticks):
        t = tick * TICK
        q, v = position(t) if callable(position) else (position, speed)
        dither.GetInputPort("joint_position_command").FixValue(context, q)
        if v is not None:
            dither.GetInputPort("joint_velocity_command").FixValue(context, v)
        context.SetTime(t)
        memory = dither.memory(context)
        found.append((memory["dithered_position"], memory["dithered_velocity"]))
        context.SetDiscreteState(dither.EvalUniquePeriodicDiscreteUpdate(context))
    positions, speeds = zip(*found, strict=True)
    return np.array(positions), np.array(speeds)


def tool_motion(arm, posture, change):
    """Rotation, times 0.1 m, and translation of a tool by these changes of the joint positions, (6,) [m]."""
    context = ROBOT.context_at(posture)
    jacobian = ROBOT.jacobian_of(context, ROBOT.parts.arms[arm].tcp_frame)[:, ARMS[arm]]
    return np.array([0.1] * 3 + [1.0] * 3) * (jacobian @ change[ARMS[arm]])


@pytest.mark.parametrize("posture", [POSTURE, STRAIGHT])
def test_all_joints_move_and_the_tool_hardly_does(posture):
    """As little as the best of all signs allows, by bounded least squares of SciPy: 0.25 m times the amplitude."""
    moved = run(block(), 6 * HALF, posture)[0] - posture
    peak = np.abs(moved[2 * HALF :]).max(axis=0)
    assert peak.min() == pytest.approx(AMPLITUDE, rel=0.01)
    assert (peak < 4.01 * AMPLITUDE).all()
    context = ROBOT.context_at(posture)
    for name, joints in ARMS.items():
        jacobian = ROBOT.jacobian_of(context, ROBOT.parts.arms[name].tcp_frame)[:, joints]
        scaled = np.array([0.1] * 3 + [1.0] * 3)[:, None] * jacobian
        rows = np.vstack([scaled, 0.02 * np.eye(7)])
        best = min(
            (lsq_linear(rows * signs, np.zeros(13), (1.0, 4.0)) for signs in product((1.0, -1.0), repeat=7)),
            key=lambda found: found.cost,
        )
        at_peak = moved[2 * HALF + np.argmax(np.abs(moved[2 * HALF :, joints.start]))]
        tool = np.linalg.norm(tool_motion(name, posture, at_peak))
        cost = np.hypot(tool, 0.02 * np.linalg.norm(at_peak[joints]))
        assert cost == pytest.approx(AMPLITUDE * np.sqrt(2 * best.cost), rel=0.02)
        assert tool < 0.25 * AMPLITUDE


def test_the_mean_is_the_command_and_the_speed_its_derivative():
    found, speed = run(block(), 8 * HALF)
    np.testing.assert_allclose(found[4 * HALF : 6 * HALF].mean(axis=0), POSTURE, atol=1e-12)
    np.testing.assert_allclose(0.5 * TICK * (speed[1:] + speed[:-1]), np.diff(found, axis=0), atol=2e-5)
    assert (found[0] == POSTURE).all()
    assert (speed[0] == 0).all()


def test_the_arms_are_never_at_rest_together():
    speed = run(block(), 6 * HALF)[1][2 * HALF :]
    slow = [np.abs(speed[:, joints]).max(axis=1) < 0.01 for joints in ARMS.values()]
    assert slow[0].sum() == slow[1].sum() > 0
    assert not (slow[0] & slow[1]).any()


def test_a_moving_arm_gets_half_of_it_without_a_step_of_speed():
    """The arms travel from 0.4 s to 1.2 s, by 0.2 rad in each joint."""

    def travel(t):
        share = np.clip((t - 0.4) / 0.8, 0.0, 1.0)
        step = 0.2 * np.ones(14)
        inside = 0.0 < share < 1.0
        return POSTURE + step * share**2 * (3 - 2 * share), step * 6 * share * (1 - share) / 0.8 * inside

    found, speed = run(block(), 400, travel)
    commands = [travel(tick * TICK) for tick in range(400)]
    moved = found - np.array([q for q, _ in commands])
    added = speed - np.array([v for _, v in commands])
    times = TICK * np.arange(400)

    def peak(begin, end):
        return np.abs(moved[(times >= begin) & (times < end)]).max(axis=0)

    assert peak(0.2, 0.4).min() == pytest.approx(AMPLITUDE, rel=0.01)
    assert peak(0.7, 0.9).min() == pytest.approx(0.5 * AMPLITUDE, rel=0.05)
    assert peak(1.4, 1.6).min() == pytest.approx(AMPLITUDE, rel=0.01)
    rate = np.pi / (HALF * TICK)
    assert np.abs(np.diff(added, axis=0)).max() < 1.5 * 4 * AMPLITUDE * rate**2 * TICK
    # After the way the signs suit the new posture again.
    for name in ARMS:
        late = moved[times > 1.4]
        most = max(np.linalg.norm(tool_motion(name, commands[-1][0], each)) for each in late)
        assert most < 4e-4


def test_a_joint_at_its_limit_stays_within_it():
    limits = ROBOT.limits
    outside = POSTURE.copy()
    outside[2], outside[8] = limits.position_upper[2], limits.position_lower[8]
    found, _ = run(block(), 6 * HALF, outside, np.zeros(14))
    assert (found <= limits.position_upper + 1e-12).all()
    assert (found >= limits.position_lower - 1e-12).all()
    assert np.ptp(found[2 * HALF :], axis=0).min() > 1.9 * AMPLITUDE


def test_a_joint_that_comes_to_its_limit_slows_down_without_a_step_of_speed():
    """It approaches with the time constant of the reactive controller, 20 ms."""
    upper, room = ROBOT.limits.position_upper[2], 4 * AMPLITUDE

    def approach(t):
        left = 0.5 * np.exp(-t / 0.02)
        q, v = POSTURE.copy(), np.zeros(14)
        q[2], v[2] = upper - left, left / 0.02
        return q, v

    found, speed = run(block(), 150, approach)
    added = speed[:, 2] - [approach(tick * TICK)[1][2] for tick in range(150)]
    fastest = 2 * room / 0.02  # where the joint begins to slow down
    dither = room * (np.pi / (HALF * TICK)) ** 2
    assert np.abs(np.diff(added)).max() < 1.1 * (dither + fastest**2 / (2 * room)) * TICK
    assert (found[:, 2] <= upper).all()
    assert found[-2 * HALF :, 2].mean() == pytest.approx(upper - room, abs=1e-6)


def test_numbers_that_are_none_are_passed_on_and_forgotten():
    def broken(t):
        q = POSTURE.copy()
        if 0.1 < t < 0.2:
            q[3] = np.nan
        return q, np.zeros(14)

    found, speed = run(block(), 100, broken)
    during = np.isnan(found[:, 3])
    assert during.sum() == 24
    assert np.isfinite(np.delete(found, 3, axis=1)).all()
    assert np.isfinite(speed).all()
    assert np.abs(found[-2 * HALF :] - POSTURE).max(axis=0).min() > 0.9 * AMPLITUDE


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"amplitude": 0.0}, "amplitude = 0.0: must be positive"),
        ({"amplitude": 0.02}, "amplitude = 0.02: must be at most 0.00259 rad, for the acceleration limit"),
        ({"frequency": 100.0}, "frequency = 100.0: must be at most 62.5 Hz, with ticks of 0.004 s"),
        ({"largest_share": 0.5}, "largest_share = 0.5: must be at least 1"),
        ({"travel_share": 1.5}, "travel_share = 1.5: must be at most 1"),
    ],
)
def test_bad_input_is_named(options, message):
    with pytest.raises(BadInputError, match=message):
        block(**options)

"""Servo loops by themselves: references between ticks, the law, its limit, and motors that stick."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.drives.joint_servo import JointServo
from forcectl.plant.drives.motor_motion import MotorMotion
from forcectl.plant.drives.servo import servo_gains

TICK, STEP = 0.004, 0.0005
GAINS, INERTIA = servo_gains(100.0, 0.8, 12.0), np.array([0.3, 0.1])
STIFFNESS, DAMPING = INERTIA * 100.0**2, INERTIA * 2 * 0.8 * 100.0
INPUTS = ("joint_position_command", "joint_velocity_command", "joint_torque_feedforward", "position", "velocity")


def servo(limit=np.inf, **options):
    return JointServo(GAINS, INERTIA, np.full(2, limit), period=TICK, time_step=STEP, start=[0.1, -0.2], **options)


def fix(block, context, **values):
    for name, value in values.items():
        block.GetInputPort(name).FixValue(context, value)


def test_references_go_on_with_their_speed_between_ticks():
    """With K_d and K_i aside, the torque is K_p (r + v_r (t - t_k) - q), felt one step after the tick."""
    block = servo()
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    rng = np.random.default_rng(3)
    q, v = np.zeros(2), np.zeros(2)
    fix(block, context, position=q, velocity=v, joint_torque_feedforward=np.zeros(2))
    impulse, z = np.zeros(2), np.zeros(2)
    held, taken_at = (np.array([0.1, -0.2]), np.zeros(2)), 0.0
    for tick in range(6):
        r, rate = rng.uniform(-1, 1, (2, 2))
        fix(block, context, joint_position_command=r, joint_velocity_command=rate)
        if tick == 0:
            simulator.Initialize()
        for step in range(8):
            time = (8 * tick + step) * STEP
            if step == 1:
                held, taken_at = (r, rate), tick * TICK
            error = held[0] + held[1] * (time - taken_at) - q
            torque = STIFFNESS * error + DAMPING * held[1] + z
            np.testing.assert_allclose(block.GetOutputPort("motor_torque").Eval(context), torque, rtol=1e-9)
            np.testing.assert_allclose(block.GetOutputPort("torque_integral").Eval(context), impulse, rtol=1e-9)
            impulse, z = impulse + STEP * torque, z + STEP * 12.0 * STIFFNESS * error
            simulator.AdvanceTo((8 * tick + step + 1) * STEP)


def test_friction_compensation_acts_in_the_direction_of_the_speed_command():
    """From 2 mrad/s on as a whole, below in proportion, and beside a feed-forward."""
    plain, compensated = servo(), servo(compensation=[1.5, 0.5])
    for rate, share in ((0.0, 0.0), (1e-3, 0.5), (-5e-4, -0.25), (0.3, 1.0), (-2e-3, -1.0)):
        torques = []
        for block in (plain, compensated):
            simulator = Simulator(block)
            context = simulator.get_mutable_context()
            speeds = np.array([rate, -rate])
            fix(block, context, position=np.zeros(2), velocity=np.zeros(2), joint_torque_feedforward=[0.2, 0.1])
            fix(block, context, joint_position_command=np.zeros(2), joint_velocity_command=speeds)
            simulator.AdvanceTo(1.5 * STEP)
            torques.append(block.GetOutputPort("motor_torque").Eval(context))
        np.testing.assert_allclose(torques[1] - torques[0], share * np.array([1.5, -0.5]), atol=1e-12)


def test_loops_within_a_step_act_by_their_mean():
    """Two loops in a step: the second one where the motion has gone on for half of it."""
    blocks = [servo(substeps=count) for count in (1, 2)]
    q, v, r, rate = np.array([0.2, 0.1]), np.array([0.5, -1.0]), np.array([0.3, 0.0]), np.array([0.4, 0.2])
    torques = []
    for block in blocks:
        simulator = Simulator(block)
        context = simulator.get_mutable_context()
        fix(block, context, position=q, velocity=v, joint_torque_feedforward=np.zeros(2))
        fix(block, context, joint_position_command=r, joint_velocity_command=rate)
        simulator.AdvanceTo(STEP)
        torques.append(block.GetOutputPort("motor_torque").Eval(context))
    h = 0.25 * STEP  # the speed has not changed since the last step
    np.testing.assert_allclose(torques[1] - torques[0], STIFFNESS * (rate - v) * h, rtol=1e-6)


def test_the_torque_stops_at_its_limit_and_the_integral_gives_way():
    block = servo(limit=5.0)
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, **dict.fromkeys(INPUTS, np.zeros(2)))
    fix(block, context, joint_position_command=np.array([1.0, -1.0]))
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(block.GetOutputPort("motor_torque").Eval(context), [5.0, -5.0])
    # As soon as the error is gone, so is the torque: nothing was wound up beyond the limit.
    fix(block, context, joint_position_command=np.zeros(2))
    simulator.AdvanceTo(1.1)
    assert np.abs(block.GetOutputPort("motor_torque").Eval(context)).max() <= 5.0
    torques = []
    for k in range(100):
        simulator.AdvanceTo(1.1 + k * TICK)
        torques.append(block.GetOutputPort("motor_torque").Eval(context))
    assert (np.abs(torques).max(axis=0) <= 5.0 + 1e-9).all()


def test_the_position_it_starts_with_holds_before_the_first_reference():
    block = servo(torque=[2.0, 3.0])
    context = block.CreateDefaultContext()
    fix(block, context, position=np.array([0.1, -0.2]), velocity=np.zeros(2))
    np.testing.assert_allclose(block.GetOutputPort("motor_torque").Eval(context), [2.0, 3.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period": 0.0}, "period"),
        ({"time_step": 0.003}, "whole multiple"),
        ({"limit": [-1.0, 1.0]}, "limit"),
        ({"inertia": [0.3, -0.1]}, "inertia"),
    ],
)
def test_what_cannot_be_is_refused(options, message):
    known = {"inertia": INERTIA, "limit": np.ones(2), "period": TICK, "time_step": STEP, "start": 0.0}
    with pytest.raises(BadInputError, match=message):
        JointServo(GAINS, **{**known, **options})


def test_of_one_joint_all_may_be_numbers_and_what_may_stay_open_is_said():
    block = JointServo(GAINS, 0.3, np.inf, period=TICK, time_step=STEP, start=0.1)
    context = block.CreateDefaultContext()
    fix(block, context, position=[0.0], velocity=[0.0])
    np.testing.assert_allclose(block.GetOutputPort("motor_torque").Eval(context), [0.1 * STIFFNESS[0]])
    assert set(block.optional_inputs) == {"joint_velocity_command", "joint_torque_feedforward"}


def test_motors_move_as_their_friction_says():
    """B (v+ - v)/dt = tau - tau_s - tau_O - tau_C sign(v+) - D v+, or v+ = 0 while the Coulomb torque can hold."""
    friction = JointFriction(2, offset=[0.1, 0.0], coulomb=[1.0, 0.5], viscous_forward=2.0, viscous_backward=[1.0, 3.0])
    inertia, step = np.array([0.2, 0.05]), 0.001
    block = MotorMotion(inertia, friction, time_step=step, start=[0.3, 0.4])
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    q, v = np.array([0.3, 0.4]), np.zeros(2)
    directions = set()
    for k in range(200):
        torque, spring = np.array([3.0 * np.sin(0.1 * k), 0.4]), np.array([0.5, -0.05])
        fix(block, context, motor_torque=torque, spring_torque=spring)
        if k == 0:
            simulator.Initialize()
        push = torque - spring - friction.offset + inertia * v / step
        simulator.AdvanceTo((k + 1) * step)
        # The update of an instant is made when time goes on from it.
        reached, v = np.split(block.GetOutputPort("motor_state").Eval(context), 2)
        np.testing.assert_allclose(reached, q + step * v, rtol=1e-12)
        q = reached
        holding = np.abs(push) <= friction.coulomb
        np.testing.assert_array_equal(v == 0.0, holding)
        viscous = np.where(v > 0, friction.viscous_forward, friction.viscous_backward)
        balance = push - friction.coulomb * np.sign(v) - viscous * v - inertia * v / step
        np.testing.assert_allclose(balance[~holding], 0.0, atol=1e-9)
        directions |= set(np.sign(v).tolist())
    assert directions == {-1.0, 0.0, 1.0}
    # The second one stays below its Coulomb friction throughout, exactly where it was.
    assert block.GetOutputPort("motor_position").Eval(context)[1] == 0.4

"""Joint impedance control and the torque that carries the weight, block by block."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcectl.diagrams.drives.position_drive import JointImpedanceDriveConfig
from forcectl.errors import BadInputError
from forcectl.plant.drives.joint_impedance import GravityCompensation, JointImpedance
from forcectl.robot.model import RobotModel
from forcectl.testing import run_diagram

PERIOD = 0.002
START = np.deg2rad([20.0, -10.0, -80.0, 30.0, 70.0, 40.0])
joints = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array)
gains = st.lists(st.floats(0.0, 1e5), min_size=3, max_size=3).map(np.array)


def gravity_at(robot: RobotModel, links: np.ndarray) -> np.ndarray:
    context = robot.create_context()
    robot.set_positions(context, links)
    return robot.gravity_torque(context)


def torque(block: JointImpedance, reference: object, state: object, gravity: object) -> np.ndarray:
    context = block.CreateDefaultContext()
    for name, value in (("reference", reference), ("motor_state", state), ("gravity_torque", gravity)):
        block.GetInputPort(name).FixValue(context, value)
    return block.GetOutputPort("torque_command").Eval(context)


@pytest.mark.slow
@given(joints, joints, joints, joints, joints, gains, gains)
def test_it_is_a_spring_and_a_damper_between_reference_and_motor(wanted, rate, q, speed, gravity, stiffness, damping):
    block = JointImpedance(3, stiffness=stiffness, damping=damping)
    found = torque(block, np.concatenate([wanted, rate]), np.concatenate([q, speed]), gravity)
    expected = np.diag(stiffness) @ (wanted - q) + np.diag(damping) @ (rate - speed) + gravity
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)


def test_gains_are_those_of_the_context():
    block = JointImpedance(2, stiffness=[1e4, 2e4], damping=0.0)
    context = block.CreateDefaultContext()
    block.set_parameter(context, "stiffness", [100.0, 200.0])
    for name, value in (("reference", [0.1, 0.1, 0.0, 0.0]), ("motor_state", np.zeros(4)), ("gravity_torque", [1, 2])):
        block.GetInputPort(name).FixValue(context, value)
    np.testing.assert_allclose(block.GetOutputPort("torque_command").Eval(context), [11.0, 22.0])


def test_the_torque_is_that_of_the_tick_and_held_over_it():
    block = JointImpedance(1, stiffness=1e3, damping=0.0, initial_torque=7.0, period=PERIOD)
    inputs = {"reference": lambda t: [t, 0.0], "motor_state": [0.0, 0.0], "gravity_torque": [2.0]}
    log = run_diagram(block, 0.02, period=PERIOD / 4, inputs=inputs)
    tick = np.floor(log.time / PERIOD + 1e-6) * PERIOD
    np.testing.assert_allclose(log["torque_command"][:, 0], 1e3 * tick + 2.0, atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_reference_that_is_not_a_number_leaves_its_joint_where_it_was_told_to_be(bad):
    block = JointImpedance(2, stiffness=1e3, damping=10.0, initial_reference=[0.1, 0.2], period=PERIOD)
    good = np.array([0.3, 0.4, 1.0, 1.0])

    def reference(t: float) -> np.ndarray:
        return good if t < 0.0095 else np.where(np.arange(4) == (0 if t < 0.0195 else 2), bad, good)

    log = run_diagram(block, 0.03, period=PERIOD, inputs={"reference": reference, "motor_state": [0.05, 0.1, 0.0, 0.5]})
    moved = [1e3 * 0.25 + 10.0, 1e3 * 0.3 + 10.0 * 0.5]
    np.testing.assert_allclose(log["torque_command"][:5], np.tile(moved, (5, 1)))
    # Held, and standing still: the rate counts no more.
    np.testing.assert_allclose(log["torque_command"][5:], np.tile([moved[0] - 10.0, moved[1]], (11, 1)))


@pytest.mark.parametrize("port", ["motor_state", "gravity_torque"])
def test_a_reading_that_is_not_a_number_keeps_the_torque_of_its_joint(port):
    size = 4 if port == "motor_state" else 2
    fine = np.full(size, 0.1)

    def reading(t: float) -> np.ndarray:
        return np.where(np.arange(size) == 1, math.nan, 2 * fine) if t > 0.0095 else fine

    inputs = {"reference": [1.0, 1.0, 0.0, 0.0], port: reading}
    log = run_diagram(JointImpedance(2, stiffness=1e3, damping=0.0), 0.02, period=PERIOD, inputs=inputs)[
        "torque_command"
    ]
    assert np.isfinite(log).all()
    assert (log[5:, 1] == log[4, 1]).all()
    assert (log[5:, 0] != log[4, 0]).all()


def test_batch_elements_do_not_know_of_each_other():
    numbers = np.random.default_rng(3).normal(size=(5, 3))
    stiffness = np.array([1e4, 3e3, 50.0])
    one = torque(
        JointImpedance(3, stiffness=stiffness, damping=20.0), numbers[:2].ravel(), numbers[2:4].ravel(), numbers[4]
    )
    for element in range(3):
        alone = JointImpedance(1, stiffness=stiffness[element], damping=20.0)
        assert torque(alone, numbers[:2, element], numbers[2:4, element], numbers[4:, element]).item() == one[element]


def test_gravity_is_that_of_the_links_not_of_the_motors(robot):
    """The motors stand where they do because the springs carry the weight; the links hang below."""
    springs = robot.joint_stiffness / 50
    block = GravityCompensation(robot, START, springs)
    start = gravity_at(robot, START)
    links = START + np.array([0.1, 0.3, -0.2, 0.1, 0.2, 0.0])
    end = gravity_at(robot, links)
    motors = lambda t: START + start / springs if t < 0.01 else links + end / springs  # noqa: E731
    log = run_diagram(block, 0.05, period=PERIOD, inputs={"motor_position": motors})["gravity_torque"]
    np.testing.assert_allclose(log[:5], np.tile(start, (5, 1)), atol=1e-9)
    # Rigid springs would be 1 Nm off here.
    assert np.abs(gravity_at(robot, links + end / springs) - end).max() > 1.0
    # 1e-4 rad of posture are not followed, at up to 500 Nm/rad.
    assert np.abs(log[-1] - end).max() < 0.06


def test_gravity_is_kept_while_a_position_is_not_a_number(robot):
    positions = lambda t: START + (0.1 if t < 0.01 else math.nan)  # noqa: E731
    block = GravityCompensation(robot, START, np.full(6, np.inf))
    log = run_diagram(block, 0.02, period=PERIOD, inputs={"motor_position": positions})["gravity_torque"]
    np.testing.assert_allclose(log[-1], gravity_at(robot, START + 0.1), atol=1e-9)


def test_default_stiffness_and_damping_follow_the_inertias():
    config = JointImpedanceDriveConfig(bandwidth=50.0, damping_ratio=0.5)
    inertia = np.array([10.0, 0.1])
    stiffness = config.joint_stiffness(inertia)
    np.testing.assert_allclose(np.sqrt(stiffness / inertia), 50.0)
    np.testing.assert_allclose(config.joint_damping(stiffness, 4 * inertia), 2 * 0.5 * 50.0 * 2 * inertia)
    np.testing.assert_array_equal(JointImpedanceDriveConfig(stiffness=[3e4, 2.0]).joint_stiffness(inertia), [3e4, 2.0])


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"stiffness": [1e4, -1.0]}, "stiffness"),
        ({"stiffness": [1e4, 0.0]}, "stiffness"),
        ({"stiffness": [math.inf]}, "stiffness"),
        ({"stiffness": [math.nan]}, "stiffness"),
        ({"bandwidth": 0.0}, "bandwidth"),
        ({"bandwidth": math.inf}, "bandwidth"),
        ({"damping_ratio": -0.1}, "damping_ratio"),
        ({"torque_gain": -1.0}, "torque_gain"),
        ({"friction_bandwidth": math.nan}, "friction_bandwidth"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(changed, told):
    with pytest.raises(BadInputError, match=told):
        JointImpedanceDriveConfig(**changed)


def test_as_many_stiffnesses_as_joints():
    with pytest.raises(BadInputError, match="stiffness has 5 values: must have 6"):
        JointImpedanceDriveConfig(stiffness=[1e4] * 5).joint_stiffness(np.ones(6))

"""Leader and follower against Drake's relative quantities, finite differences and random postures of two arms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from forcectl.errors import BadInputError
from forcectl.framework.euler_angles import EulerAngles, angles_of, rotation_of
from forcectl.framework.rotation_vector import RotationVector
from forcectl.models import models_folder
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.tasks.relative_task import RelativeMotion, RelativePose, RelativeTask
from tests.examples.motion_examples import frame_motion, two_arms
from tests.examples.pinocchio_model import PinocchioModel

H = 1e-5


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return two_arms()


def tips(robot: RobotModel) -> tuple[Frame, Frame]:
    left, right = (arm.tcp_frame for arm in robot.parts.arms.values())
    return left, right


def random_states(robot: RobotModel, count: int, seed: int = 3):
    """Postures within the joint limits, with speeds and accelerations."""
    rng, limits = np.random.default_rng(seed), robot.limits
    for _ in range(count):
        q = rng.uniform(limits.position_lower, limits.position_upper)
        yield q, rng.uniform(-1, 1, robot.num_joints) * limits.velocity, rng.normal(size=robot.num_joints)


def put(robot: RobotModel, context: Context, q: np.ndarray, v: np.ndarray) -> None:
    robot.set_positions(context, q)
    robot.set_velocities(context, v)


def relative(robot: RobotModel, context: Context, q: np.ndarray, v: np.ndarray, frames: tuple[Frame, Frame]):
    put(robot, context, q, v)
    return RelativeMotion(*(frame_motion(robot, context, frame, v) for frame in frames))


def test_pose_jacobian_and_bias_are_those_of_drake(robot):
    context, plant = robot.create_context(), robot.plant
    other = plant.GetFrameByName("left_link_4")  # not only TCPs
    origin = np.zeros(3)
    for q, v, _ in random_states(robot, 20):
        for leader, follower in (tips(robot), tips(robot)[::-1], (other, tips(robot)[1]), tips(robot)[:1] * 2):
            motion = relative(robot, context, q, v, (leader, follower))
            X = plant.CalcRelativeTransform(context, leader, follower)
            np.testing.assert_allclose(motion.position, X.translation(), atol=1e-12)
            np.testing.assert_allclose(motion.rotation, X.rotation().matrix(), atol=1e-12)
            with_respect_to = (JacobianWrtVariable.kV, follower, origin, leader, leader)
            J = plant.CalcJacobianSpatialVelocity(context, *with_respect_to)
            np.testing.assert_allclose(motion.jacobian, J, atol=1e-12)
            np.testing.assert_allclose(motion.velocity, J @ v, atol=1e-11)
            bias = plant.CalcBiasSpatialAcceleration(context, *with_respect_to).get_coeffs()
            np.testing.assert_allclose(motion.bias, bias, rtol=1e-9, atol=1e-9)


def test_bias_is_the_derivative_of_the_velocity_along_the_motion(robot):
    context, frames = robot.create_context(), tips(robot)
    for q, v, u in random_states(robot, 20):
        motion = relative(robot, context, q, v, frames)
        J, bias = motion.jacobian, motion.bias
        ahead, back = (relative(robot, context, q + h * v + h**2 / 2 * u, v + h * u, frames).velocity for h in (H, -H))
        np.testing.assert_allclose(J @ u + bias, (ahead - back) / (2 * H), rtol=1e-6, atol=1e-6)


def test_velocity_is_the_derivative_of_the_pose(robot):
    context, frames = robot.create_context(), tips(robot)
    for q, v, _ in random_states(robot, 20):
        here, ahead, back = (relative(robot, context, q + h * v, v, frames) for h in (0.0, H, -H))
        np.testing.assert_allclose(here.velocity[3:], (ahead.position - back.position) / (2 * H), rtol=1e-6, atol=1e-7)
        R = (ahead.rotation - back.rotation) / (2 * H) @ here.rotation.T
        np.testing.assert_allclose(here.velocity[:3], [R[2, 1], R[0, 2], R[1, 0]], rtol=1e-6, atol=1e-7)


@pytest.fixture(scope="module")
def reference(robot) -> PinocchioModel:
    return PinocchioModel(models_folder() / "yumi" / "yumi.urdf", robot.parameters.arm_joints)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_pose_and_jacobian_are_those_of_another_library(robot, reference, seed):
    """By adjoints of body velocities, [translation; rotation] in the follower's axes; not by the equations of ours."""
    q, v, _ = next(random_states(robot, 1, seed))
    links = ("left_link_6", "right_link_6")  # the flanges are frames for Drake only
    motion = relative(robot, robot.create_context(), q, v, tuple(map(robot.plant.GetFrameByName, links)))
    (X_WL, J_L), (X_WF, J_F) = (reference.frame(q, link) for link in links)
    X_LF = X_WL.actInv(X_WF)
    np.testing.assert_allclose(motion.position, X_LF.translation, atol=1e-9)
    np.testing.assert_allclose(motion.rotation, X_LF.rotation, atol=1e-9)
    body = J_F - X_LF.inverse().action @ J_L
    expected = np.concatenate([X_LF.rotation @ body[3:], X_LF.rotation @ body[:3]])
    np.testing.assert_allclose(motion.jacobian, expected, atol=1e-9)


def test_it_does_not_matter_how_both_move_together(robot):
    """A common rigid motion of both frames is no relative motion."""
    rng, context = np.random.default_rng(5), robot.create_context()
    q, v, _ = next(random_states(robot, 1))
    put(robot, context, q, v)

    class Carried:
        """A frame on a body that turns and moves, and does so ever faster."""

        def __init__(self, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray, gain: np.ndarray):
            w, a = twist[:3], gain[:3]
            self.position, self.rotation, self.jacobian = position, rotation, np.zeros((6, 1))
            self.velocity = np.concatenate([w, twist[3:] + np.cross(w, position)])
            centripetal = np.cross(a, position) + np.cross(w, self.velocity[3:])
            self.bias = np.concatenate([a, gain[3:] + centripetal])

    for _ in range(10):
        twist, gain = rng.normal(size=(2, 6))
        pair = [Carried(rng.normal(size=3), rotation_of(rng.normal(size=3)), twist, gain) for _ in range(2)]
        motion = RelativeMotion(*pair)
        np.testing.assert_allclose(motion.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(motion.bias, 0.0, atol=1e-11)


@pytest.mark.parametrize("orientation", [EulerAngles(), RotationVector()])
@pytest.mark.parametrize("count", [3, 5, 6])
def test_the_task_of_a_follower_moves_as_it_says(robot, orientation, count):
    names = tuple(robot.parts.arms)
    task = RelativeTask(*names, ("x", "y", "z", "phi", "theta", "psi")[:count], orientation)
    context = robot.create_context()
    checked = 0
    for q, v, u in random_states(robot, 30, seed=7):
        v = 0.2 * v
        state = task.state(ArmsMotion(robot, context, q, v))
        assert state.jacobian.shape == (count, robot.num_joints)
        ahead, back = (task.state(ArmsMotion(robot, context, q + h * v + h**2 / 2 * u, v + h * u)) for h in (H, -H))
        if np.abs(ahead.value - back.value).max() > 1e-2 or np.abs(state.bias).max() > 100:
            continue  # a whole turn apart, or beside a singularity
        checked += 1
        np.testing.assert_allclose(state.rate, (ahead.value - back.value) / (2 * H), rtol=1e-5, atol=1e-6)
        total = state.jacobian @ u + state.bias
        np.testing.assert_allclose(total, (ahead.rate - back.rate) / (2 * H), rtol=1e-5, atol=1e-5)
    assert checked >= 20


def test_leader_and_follower_are_two_arms():
    with pytest.raises(BadInputError, match="follower = 'left': must be another arm than the leader"):
        RelativeTask("left", "left")


# --- the block -------------------------------------------------------------------------------------------------------


def test_the_block_puts_out_the_relative_motion(robot):
    block = RelativePose(robot, *tips(robot))
    context, scratch = block.CreateDefaultContext(), robot.create_context()
    for q, v, _ in random_states(robot, 5):
        block.GetInputPort("joint_position").FixValue(context, q)
        block.GetInputPort("joint_velocity").FixValue(context, v)
        expected = relative(robot, scratch, q, v, tips(robot))
        np.testing.assert_allclose(block.GetOutputPort("relative_position").Eval(context), expected.position)
        np.testing.assert_allclose(block.GetOutputPort("relative_velocity").Eval(context), expected.velocity)
        angles = block.GetOutputPort("relative_angles").Eval(context)
        np.testing.assert_allclose(rotation_of(angles), expected.rotation, atol=1e-12)


def test_bad_readings_hold_the_last_tick(robot):
    block = RelativePose(robot, *tips(robot), period=0.004)
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    names = ("relative_position", "relative_angles", "relative_velocity")
    q, v, _ = next(random_states(robot, 1))
    block.GetInputPort("joint_position").FixValue(context, q)
    block.GetInputPort("joint_velocity").FixValue(context, v)
    simulator.AdvanceTo(0.01)
    before = [block.GetOutputPort(name).Eval(context) for name in names]
    for spoilt_q, spoilt_v in ((np.where(np.arange(len(q)) == 3, math.nan, q), v), (q, np.full_like(v, math.inf))):
        block.GetInputPort("joint_position").FixValue(context, spoilt_q)
        block.GetInputPort("joint_velocity").FixValue(context, spoilt_v)
        simulator.AdvanceTo(context.get_time() + 0.02)
        for name, value in zip(names, before, strict=True):
            np.testing.assert_array_equal(block.GetOutputPort(name).Eval(context), value)


def test_angles_go_on_beyond_half_a_turn(robot):
    block = RelativePose(robot, *tips(robot))
    simulator, n = Simulator(block), robot.num_joints
    context = simulator.get_mutable_context()
    q = robot.parameters.default_posture.copy()
    block.GetInputPort("joint_velocity").FixValue(context, np.zeros(n))
    before, jumps = None, []
    for k in range(120):
        q[-1] = -3.9 + 7.8 * k / 120  # the follower's last axis
        block.GetInputPort("joint_position").FixValue(context, q)
        simulator.AdvanceTo(0.004 * (k + 1))
        angles = block.GetOutputPort("relative_angles").Eval(context)
        if before is not None:
            jumps.append(np.abs(angles - before).max())
        before = angles
    assert max(jumps) < 0.2
    assert np.abs(angles_of(rotation_of(angles)) - angles).max() > 1.0


def test_a_frame_of_another_plant_is_refused(robot):
    stranger = RobotModel.load("comau_smart_six", tool=None)
    with pytest.raises(BadInputError, match="must be of the plant of the robot"):
        RelativePose(robot, tips(robot)[0], stranger.tcp_frame)

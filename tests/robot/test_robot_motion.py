"""Kinematics of the commanded motion against finite differences and rotations by hand."""

import numpy as np
import pytest
from pydrake.math import RotationMatrix

from forcectl.robot.robot_motion import ConstantJacobianMotion, RobotMotion, orientation_error
from tests.examples.robot_controller_runs import N, robot_plant_model

RNG = np.random.default_rng(3)
V, U = RNG.normal(size=N), RNG.normal(size=N)


def at(q: np.ndarray, v: np.ndarray) -> RobotMotion:
    robot = robot_plant_model().robot
    return RobotMotion(robot, robot.create_context(), q, v)


def test_velocity_and_bias_are_the_derivatives_of_the_pose() -> None:
    q, h = robot_plant_model().start + 0.1, 1e-4
    before, now, after = (at(q + t * V + 0.5 * t * t * U, V + t * U) for t in (-h, 0.0, h))
    np.testing.assert_allclose(now.velocity[3:], (after.position - before.position) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(
        now.velocity[:3], orientation_error(before.rotation, after.rotation) / (2 * h), atol=1e-6
    )
    np.testing.assert_allclose(now.jacobian @ U + now.bias, (after.velocity - before.velocity) / (2 * h), atol=1e-5)


def test_torque_of_a_motion_is_that_of_the_inverse_dynamics() -> None:
    motion = at(robot_plant_model().start + 0.1, V)
    np.testing.assert_allclose(motion.inertia @ U + motion.load, motion.torque(U), rtol=1e-12)


@pytest.mark.parametrize("angle", [1e-6, 0.3, 3.0])
def test_turn_is_the_sine_of_the_angle_about_the_axis(angle: float) -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3
    first = RotationMatrix.MakeXRotation(0.7)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    np.testing.assert_allclose(
        orientation_error(first.matrix(), rotation @ first.matrix()), np.sin(angle) * axis, atol=1e-12
    )


def test_constant_jacobian_motion_has_the_jacobian_of_its_origin_and_agrees_with_the_robot_near_it() -> None:
    origin = at(robot_plant_model().start, np.zeros(N))
    q = origin.q + 1e-4 * V
    constant, robot = ConstantJacobianMotion(origin, q, V), at(q, V)
    np.testing.assert_array_equal(constant.jacobian, origin.jacobian)
    np.testing.assert_array_equal(constant.bias, np.zeros(6))
    np.testing.assert_allclose(constant.velocity, origin.jacobian @ V)
    np.testing.assert_allclose(constant.position, robot.position, atol=1e-7)
    np.testing.assert_allclose(orientation_error(constant.rotation, robot.rotation), 0.0, atol=1e-7)
    far = ConstantJacobianMotion(origin, origin.q + V, V)
    np.testing.assert_allclose(far.position - origin.position, origin.jacobian[3:] @ V)

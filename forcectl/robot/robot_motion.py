"""The commanded motion (q, q') of a controller in joint accelerations: pose, J, J'q', and M on demand.

    x' = J q',    x'' = J u + J'q',    u = q''

Computed once per tick and handed to every constraint.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from forcectl.arrays import Vector
from forcectl.framework.kernels import cross_matrix
from forcectl.robot.model import RobotModel


class ContactMotion(NamedTuple):
    """The contact at one tick, from the controller's model and the measured force.

    Attributes:
        displacement: dx_bar along n [m], into the surface when negative.
        rate: its rate [m/s]; its second derivative is row u + bias, with row (n,) [m/rad], bias [m/s^2].
        compliance: C_T_hat [m/N].
        measured_force: [N].
        sensor_lag_lead: displacement that the lag of the force sensor still hides [m], see `SensorLag`.
    """

    displacement: float
    rate: float
    row: Vector
    bias: float
    compliance: float
    measured_force: float
    sensor_lag_lead: float = 0.0


class RobotMotion:
    """The commanded motion at one tick; spatial vectors are [rotation; translation] in W.

    Attributes:
        q, v: joint positions and speeds, (n,) [rad, rad/s].
        position, rotation: of the TCP, (3,) [m] and (3, 3).
        jacobian: J_WT, (6, n) [1; m].
        velocity: J v, (6,) [rad/s; m/s].
        bias: J'v, (6,) [rad/s^2; m/s^2].
        contact: filled in by the controller.
    """

    contact: ContactMotion

    def __init__(self, robot: RobotModel, context: Context, q: Vector, v: Vector):
        """`context`: of `robot.plant`, overwritten; must stay in this posture while the motion is in use."""
        self._robot, self._context = robot, context
        self.q, self.v = q, v
        self.position, self.rotation = tip_pose(robot, context, q)
        robot.set_velocities(context, v)
        self.jacobian: Vector = robot.jacobian(context)
        self.velocity: Vector = self.jacobian.dot(v)
        self.bias: Vector = robot.bias_acceleration_of(context, robot.tcp_frame)

    @cached_property
    def inertia(self) -> Vector:
        """M(q) with the rotors' share, joint side, (n, n) [kg m2]."""
        return self._robot.mass_matrix(self._context) + self._robot.motor_inertia

    @cached_property
    def load(self) -> Vector:
        """c(q, v) + g(q): joint torque of the motion at u = 0, (n,) [Nm]."""
        return self._robot.load_torque(self._context)

    def torque(self, u: Vector) -> Vector:
        """M(q) u + c(q, v) + g(q), (n,) [Nm], in one call: half the cost of `inertia` and `load`."""
        return self._robot.torque(self._context, u)


class ConstantJacobianMotion(RobotMotion):
    """A `RobotMotion` with the constant Jacobian of a posture q_0, as in the one-dimensional station.

    Args:
        origin: the motion at rest in q_0.
    """

    def __init__(self, origin: RobotMotion, q: Vector, v: Vector):
        self._robot, self._context = origin._robot, origin._context
        self.q, self.v = q, v
        self.jacobian, self.velocity, self.bias = origin.jacobian, origin.jacobian @ v, origin.bias
        self.position, self.rotation = constant_jacobian_pose(origin, q)


class TipPose(NamedTuple):
    """Position (3,) [m] and rotation (3, 3) of the TCP in W."""

    position: Vector
    rotation: Vector


def tip_pose(robot: RobotModel, context: Context, q: Vector) -> TipPose:
    """Pose of the TCP in posture q, (n,) [rad]; `context` is overwritten."""
    robot.set_positions(context, q)
    return pose_parts(robot.pose(context))


def pose_parts(pose: RigidTransform) -> TipPose:
    """Position and rotation of a pose, from one call to Drake."""
    matrix = pose.GetAsMatrix34()
    return TipPose(matrix[:, 3], matrix[:, :3])


def constant_jacobian_pose(origin: RobotMotion, q: Vector) -> TipPose:
    """Pose of the TCP of a `ConstantJacobianMotion` in posture q, (n,) [rad]."""
    moved = origin.jacobian @ (q - origin.q)
    # Rotation to first order: `orientation_error` of two of them is the difference of the rotation vectors.
    rotation = (np.eye(3) + cross_matrix(moved[:3])) @ origin.rotation
    return TipPose(origin.position + moved[3:], rotation)


def orientation_error(start: Vector, end: Vector) -> Vector:
    """Rotation vector from one orientation to another, exact for small angles and of the right sign below pi.

    Args:
        start, end: rotation matrices (3, 3).

    Returns:
        sin(angle) * axis in W, (3,) [rad].
    """
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = (end @ start.T).tolist()
    return np.array([0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])

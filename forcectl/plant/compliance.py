"""Compliance of the robot along the constrained direction.

    C_T(q) = n'(C_J(q) + C_L(q)) n + C_E,   C_J = J diag(1/k) J',   C_L = sum_i Ad_i C_i Ad_i'        (2.7)

J is the Jacobian of the TCP in the world W, k the joint stiffness; C_i is the compliance of link i at its distal frame,
diagonal in that frame's axes, and Ad_i carries small motions of that frame to the TCP.

Order of six-vectors: the thesis writes (translation, rotation), n = [n_t; 0]; Drake and this file write
[rotation; translation], so the same direction is [0; n_t]. Arguments called `n` are the three-vector n_t in W.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.errors import BadInputError, invalid
from forcectl.robot.model import RobotModel, posture_cache

Array = NDArray[np.float64]


def joint_compliance(J: Array, stiffness: Array) -> Array:
    """C_J = J diag(1/k) J', shape (6, 6) [rad/Nm, m/N and mixed].

    Args:
        J: J_WT, shape (6, n), rotations above translations.
        stiffness: k, shape (n,) [Nm/rad], > 0; infinite is rigid.
    """
    return (J / stiffness) @ J.T


def motion_to_tcp(X_WD: RigidTransform, p_WT: Array) -> Array:
    """Ad: small motion of frame D, in D's axes, to that of the TCP fixed to D, in W; both [rotation; translation].

    Args:
        X_WD: pose of D in W.
        p_WT: position of the TCP in W [m].
    """
    R = X_WD.rotation().matrix()
    x, y, z = p_WT - X_WD.translation()
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, np.zeros((3, 3))], [-lever @ R, R]])


def link_compliance(X_WD: Sequence[RigidTransform], p_WT: Array, diagonals: Sequence[Array]) -> Array:
    """C_L = sum_i Ad_i diag(c_i) Ad_i', shape (6, 6) [rad/Nm, m/N and mixed].

    Args:
        X_WD: pose in W of each link's distal frame.
        p_WT: position of the TCP in W [m].
        diagonals: per link three rotations [rad/Nm] and three translations [m/N] in the distal frame's axes.
    """
    total = np.zeros((6, 6))
    for pose, diagonal in zip(X_WD, diagonals, strict=True):
        Ad = motion_to_tcp(pose, p_WT)
        total += (Ad * diagonal) @ Ad.T
    return total


def total_compliance(n: Array, C_J: Array, C_L: Array, C_E: float) -> float:
    """C_T = n'(C_J + C_L) n + C_E [m/N] (2.7).

    Args:
        n: unit vector in W, shape (3,).
        C_J, C_L: shape (6, 6).
        C_E: compliance of the environment along n [m/N].
    """
    along = (C_J + C_L)[3:, 3:]
    return float(n @ along @ n) + C_E


def robot_compliance(robot: RobotModel, context: Context, stiffness: Array) -> Array:
    """C_J + C_L of a robot in the posture of `context` (of `robot.plant`), shape (6, 6).

    Args:
        stiffness: joint stiffness, shape (n,) [Nm/rad].
    """
    compliance = joint_compliance(robot.jacobian(context), stiffness)
    if robot.parameters.link_compliance:
        poses = robot.link_poses(context)
        diagonals = [robot.parameters.link_compliance[frame] for frame in poses]
        compliance += link_compliance(list(poses.values()), robot.pose(context).translation(), diagonals)
    return compliance


class RobotCompliance(LeafSystem):
    """Compliance of the robot along n in its present posture, C_R(q) = n'(C_J(q) + C_L(q)) n.

    ```
    name: RobotCompliance
    input_ports: [motor_position]
    output_ports: [robot_compliance]
    parameters: [joint_stiffness]
    ```

    motor_position: shape (n_q,) [rad]. Must be connected.
    robot_compliance: shape (1,), C_R [m/N], > 0. Feedthrough of motor_position.
    joint_stiffness: numeric parameter, shape (n_q,) [Nm/rad], > 0; starts as `robot.joint_stiffness`.

    Sampling: none; evaluated when read, from the posture of the motors (the deflection is small).
    """

    parameter_names = ("joint_stiffness",)
    parameter_units = {"joint_stiffness": "Nm/rad"}

    def __init__(self, robot: RobotModel, n: ArrayLike):
        """`n`: unit vector of the constrained direction in W, shape (3,).

        Raises:
            BadInputError: `n` is not a unit vector.
        """
        super().__init__()
        self._robot = robot
        self._n = np.asarray(n, dtype=float)
        if self._n.shape != (3,) or not abs(np.linalg.norm(self._n) - 1) < 1e-9:
            raise invalid("RobotCompliance.n", self._n.tolist(), "three numbers of unit length")
        self._stiffness = self.DeclareNumericParameter(BasicVector(robot.joint_stiffness))
        self._motor_position = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        self._posture = posture_cache(self, robot, self._motor_position)
        self.DeclareVectorOutputPort(
            "robot_compliance",
            1,
            self._calc_compliance,
            prerequisites_of_calc={self._posture.ticket(), self.all_parameters_ticket()},
        )

    def set_joint_stiffness(self, context: Context, stiffness: ArrayLike) -> None:
        """Set the joint stiffness, shape (n_q,) [Nm/rad], in this block's context.

        Raises:
            BadInputError: wrong length, or an entry that is not positive.
        """
        values = np.asarray(stiffness, dtype=float)
        expected = (self._robot.num_joints,)
        if values.shape != expected:
            raise BadInputError(f"joint_stiffness has shape {values.shape}: must be {expected}")
        if not (values > 0).all():
            raise invalid("joint_stiffness", values.tolist(), "positive")
        context.get_mutable_numeric_parameter(self._stiffness).SetFromVector(values)

    def _calc_compliance(self, context: Context, output: BasicVector) -> None:
        stiffness = context.get_numeric_parameter(self._stiffness).value()
        compliance = robot_compliance(self._robot, self._posture.Eval(context), stiffness)
        output.SetAtIndex(0, float(self._n @ compliance[3:, 3:] @ self._n))

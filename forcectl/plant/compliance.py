"""Compliance of the robot along the constrained direction.

    C_T(q) = n'(C_J(q) + C_L(q)) n + C_E,   C_J = J diag(1/k) J',   C_L = sum_i Ad_i C_i Ad_i'        (2.7)

J is the Jacobian of the TCP in the world W, k the joint stiffness; C_i is the compliance of link i at a frame of it,
diagonal in that frame's axes, and Ad_i maps small motions of that frame to the TCP. The compliance of a uniform beam is
diagonal at its middle: rotations L/EI and L/GJ, translations L^3/(12 EI) and L/EA.

Order of six-vectors: the thesis writes (translation, rotation), n = [n_t; 0]; Drake and this file write
[rotation; translation], so the same direction is [0; n_t]. Arguments called `n` are the three-vector n_t in W.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.framework.kernels import cross_matrix
from forcectl.robot.model import RobotModel


def joint_compliance(J: Array, stiffness: Array) -> Array:
    """C_J = J diag(1/k) J', shape (6, 6) [rad/Nm, m/N and mixed].

    Args:
        J: J_WT, shape (6, n), rotations above translations.
        stiffness: k, shape (n,) [Nm/rad], > 0; infinite for rigid joints.
    """
    return (J / stiffness) @ J.T


def motion_to_tcp(X_WD: RigidTransform, p_WT: Array) -> Array:
    """Ad: from a small motion of frame D, in D's axes, to that of the TCP fixed to D, in W; [rotation; translation].

    Args:
        X_WD: pose of D in W.
        p_WT: position of the TCP in W [m].
    """
    R = X_WD.rotation().matrix()
    lever = cross_matrix(p_WT - X_WD.translation())
    return np.block([[R, np.zeros((3, 3))], [-lever @ R, R]])


def link_compliance(X_WD: Sequence[RigidTransform], p_WT: Array, diagonals: Sequence[Array]) -> Array:
    """C_L = sum_i Ad_i diag(c_i) Ad_i', shape (6, 6) [rad/Nm, m/N and mixed].

    Args:
        X_WD: pose in W of a frame D of each link.
        p_WT: position of the TCP in W [m].
        diagonals: per link three rotations [rad/Nm] and three translations [m/N] in that frame's axes.
    """
    total = np.zeros((6, 6))
    for pose, diagonal in zip(X_WD, diagonals, strict=True):
        Ad = motion_to_tcp(pose, p_WT)
        total += (Ad * diagonal) @ Ad.T
    return total


def compliance_along(n: Array, compliance: Array) -> float:
    """n'C n [m/N] (2.7).

    Args:
        n: unit vector in W, shape (3,).
        compliance: C, shape (6, 6).
    """
    return float(n @ compliance[3:, 3:] @ n)


def robot_compliance(robot: RobotModel, context: Context, stiffness: Array) -> Array:
    """C_J + C_L of a robot in the posture of `context` (of `robot.plant`), shape (6, 6).

    Args:
        stiffness: joint stiffness, shape (n,) [Nm/rad].
    """
    compliance = joint_compliance(robot.jacobian(context), stiffness)
    if robot.link_compliance:
        poses = robot.link_poses(context)
        diagonals = [robot.link_compliance[frame] for frame in poses]
        compliance += link_compliance(list(poses.values()), robot.pose(context).translation(), diagonals)
    return compliance

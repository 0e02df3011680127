"""The wrench between two arms that touch each other, of what each of them estimates.

    F = (F_b - X F_a)/2,    X: the wrench at a moved to b

Both arms feel the same wrench with opposite signs, and each makes errors of its own: their mean is better than either.
It is the wrench between the arms as long as neither touches anything else.

Where the covariances P_a and P_b of both are known, each counts as well as it is known (information form), forces by
those of the forces and torques by those of the torques::

    F = P (P_b^-1 F_b - P_a^-1 X F_a),    P = (P_a^-1 + P_b^-1)^-1,    P_a that of X F_a

An arm that feels a direction badly in its posture, or in which no joint moves that feels it, then counts little there.
All six components together would take torques at two hands half a metre apart for forces: quieter while nothing
touches, but torques follow a contact more slowly than their covariance says, and the force with them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context

from forcectl.errors import invalid, unknown
from forcectl.framework.block import PythonBlock
from forcectl.framework.kernels import cross, cross_matrix
from forcectl.robot.model import RobotModel, posture_cache
from forcectl.robot.robot_motion import pose_parts

Array = NDArray[np.float64]


def moved_wrench(wrench: Array, by: Array) -> Array:
    """The same wrench (6,) at a point that is `by` (3,) [m] from that of its own, all in the same axes [Nm, N]."""
    return np.concatenate([wrench[:3] - cross(by, wrench[3:]), wrench[3:]])


def opposite_mean(on_a: Array, on_b: Array) -> Array:
    """The wrench of a on b (6,) of what both feel, at one point and in the same axes [Nm, N]."""
    return 0.5 * (on_b - on_a)


def opposite_weighted(on_a: Array, on_b: Array, P_a: Array, P_b: Array) -> Array:
    """The same with the least variance of forces and of torques.

    Args:
        on_a, on_b: what both feel, (6,) [Nm, N].
        P_a, P_b: their covariances, (6, 6); of what both know exactly that of b counts.
    """
    found, apart = on_b.copy(), on_a + on_b
    for part in (slice(0, 3), slice(3, 6)):
        own, other = P_b[part, part], P_a[part, part]
        # P_b (P_a + P_b)^-1 is the share of a: no inverse of a covariance that may be singular.
        found[part] -= own @ np.linalg.pinv(own + other, hermitian=True) @ apart[part]
    return found


def moved_covariance(covariance: Array, rotation: Array, by: Array) -> Array:
    """That of a wrench, (6, 6), turned by `rotation` (3, 3) and then moved by `by` (3,) [m], see `moved_wrench`."""
    move = np.zeros((6, 6))
    move[:3, :3] = move[3:, 3:] = rotation
    move[:3, 3:] = -cross_matrix(by) @ rotation
    moved: Array = move @ covariance @ move.T
    return moved


class WrenchBetween(PythonBlock):
    """Wrench of arm a on arm b.

    ```
    name: WrenchBetween
    input_ports: [estimated_wrench, joint_position, wrench_covariance (optional)]
    output_ports: [wrench]
    ```

    estimated_wrench: shape (6a,), of the environment on each arm at its TCP, in the world or in the axes of the TCP if
    `local`, [torque; force] [Nm, N].
    joint_position: shape (n,) [rad].
    wrench_covariance: shape (36a,), of the wrenches in the axes of each TCP, row by row, products of [Nm, N]; the port
    exists if `weighted`.
    wrench: shape (6,), of arm a on arm b, at the TCP of b in `expressed_in` [Nm, N].
    Feedthrough of all inputs.

    Sampling: none; evaluated when read.

    Args:
        robot: with both arms.
        between: names of a and b.
        expressed_in: a frame of the robot; the world when None.
        local: whether the estimates are in the axes of the TCPs.
        weighted: by covariances; else both arms count alike.

    Raises:
        BadInputError: not two different arms of the robot.
    """

    port_units = {"wrench": "Nm,N", "wrench_covariance": ""}
    port_components = {"wrench": "6"}

    def __init__(
        self,
        robot: RobotModel,
        between: tuple[str, str],
        expressed_in: Frame | None = None,
        *,
        local: bool = False,
        weighted: bool = False,
    ):
        super().__init__()
        arms = list(robot.parts.arms)
        for name in between:
            if name not in arms:
                raise unknown("between", name, arms)
        if len(set(between)) != 2:
            raise invalid("between", list(between), "two different arms")
        self._which = [arms.index(name) for name in between]
        self._tips = [robot.parts.arms[name].tcp_frame for name in between]
        self._axes, self._plant, self._local = expressed_in, robot.plant, local
        self._wrenches = self.DeclareVectorInputPort("estimated_wrench", 6 * len(arms))
        position = self.DeclareVectorInputPort("joint_position", robot.num_joints)
        self._posture = posture_cache(self, robot, position)
        reads = {self._wrenches.ticket(), self._posture.ticket()}
        self._covariances = None
        if weighted:
            self._covariances = self.DeclareVectorInputPort("wrench_covariance", 36 * len(arms))
            reads.add(self._covariances.ticket())
        self.DeclareVectorOutputPort("wrench", 6, self._between, prerequisites_of_calc=reads)

    def _between(self, context: Context, output: BasicVector) -> None:
        posture, wrenches = self._posture.Eval(context), self._wrenches.Eval(context).reshape(-1, 2, 3)
        (p_a, R_a), (p_b, R_b) = (pose_parts(tip.CalcPoseInWorld(posture)) for tip in self._tips)
        by, (a, b) = p_b - p_a, self._which
        on_a, on_b = (
            (wrenches[arm] @ R.T if self._local else wrenches[arm]).ravel() for arm, R in ((a, R_a), (b, R_b))
        )
        on_a = moved_wrench(on_a, by)
        if self._covariances is None:
            wrench = opposite_mean(on_a, on_b)
        else:
            P = self._covariances.Eval(context).reshape(-1, 6, 6)
            P_a, P_b = moved_covariance(P[a], R_a, by), moved_covariance(P[b], R_b, np.zeros(3))
            wrench = opposite_weighted(on_a, on_b, P_a, P_b)
        if self._axes is not None:
            wrench = (wrench.reshape(2, 3) @ self._axes.CalcRotationMatrixInWorld(posture).matrix()).ravel()
        output.SetFromVector(wrench)

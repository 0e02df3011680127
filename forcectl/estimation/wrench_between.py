"""The wrench between two arms that touch each other, from the estimate of each arm.

    F = (F_b - X F_a)/2,    X: the wrench at a moved to b

The same wrench acts on both arms with opposite signs. The errors of the two estimates are independent, so their mean
has a smaller error. It is the wrench between the arms as long as neither touches anything else.

`WrenchBetweenFilter` is one filter for the joints of both arms, and responds faster to a contact.
"""

from __future__ import annotations

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.errors import invalid, unknown
from forcectl.framework.block import PythonBlock
from forcectl.framework.kernels import cross
from forcectl.robot.model import RobotModel, posture_cache
from forcectl.robot.robot_motion import pose_parts


def moved_wrench(wrench: Array, by: Array) -> Array:
    """The wrench (6,) with its reference point moved by `by` (3,) [m], all in the same axes [Nm, N]."""
    return np.concatenate([wrench[:3] - cross(by, wrench[3:]), wrench[3:]])


def opposite_mean(on_a: Array, on_b: Array) -> Array:
    """The wrench of a on b (6,) from those on a and on b, at one point and in the same axes [Nm, N]."""
    return 0.5 * (on_b - on_a)


class WrenchBetween(PythonBlock):
    """Wrench of arm a on arm b.

    ```
    name: WrenchBetween
    input_ports: [estimated_wrench, joint_position]
    output_ports: [wrench]
    ```

    estimated_wrench: shape (6a,), of the environment on each arm at its TCP, in the world or in the axes of the TCP if
    `local`, [torque; force] [Nm, N].
    joint_position: shape (n,) [rad].
    wrench: shape (6,), of arm a on arm b, at the TCP of b in `expressed_in` [Nm, N].
    Feedthrough of all inputs.

    Sampling: none; evaluated when read.

    Args:
        robot: with both arms.
        between: names of a and b.
        expressed_in: a frame of the robot; the world when None.
        local: whether the estimates are in the axes of the TCPs.

    Raises:
        BadInputError: not two different arms of the robot.
    """

    port_components = {"wrench": "6"}

    def __init__(
        self,
        robot: RobotModel,
        between: tuple[str, str],
        expressed_in: Frame | None = None,
        *,
        local: bool = False,
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
        self.DeclareVectorOutputPort("wrench", 6, self._between, prerequisites_of_calc=reads)

    def _between(self, context: Context, output: BasicVector) -> None:
        posture, wrenches = self._posture.Eval(context), self._wrenches.Eval(context).reshape(-1, 2, 3)
        (p_a, R_a), (p_b, R_b) = (pose_parts(tip.CalcPoseInWorld(posture)) for tip in self._tips)
        by, (a, b) = p_b - p_a, self._which
        on_a, on_b = (
            (wrenches[arm] @ R.T if self._local else wrenches[arm]).ravel() for arm, R in ((a, R_a), (b, R_b))
        )
        wrench = opposite_mean(moved_wrench(on_a, by), on_b)
        if self._axes is not None:
            wrench = (wrench.reshape(2, 3) @ self._axes.CalcRotationMatrixInWorld(posture).matrix()).ravel()
        output.SetFromVector(wrench)

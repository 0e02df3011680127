"""The wrench between two arms that touch each other, of what each of them estimates.

    F = (F_b - X F_a)/2,    X: the wrench at a moved to b

Both arms feel the same wrench with opposite signs, and each makes errors of its own: their mean is better than either.
It is the wrench between the arms as long as neither touches anything else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.errors import invalid, unknown
from forcectl.framework.kernels import cross
from forcectl.robot.model import RobotModel, posture_cache

Array = NDArray[np.float64]


def moved_wrench(wrench: Array, by: Array) -> Array:
    """The same wrench (6,) at a point that is `by` (3,) [m] from that of its own, all in the same axes [Nm, N]."""
    return np.concatenate([wrench[:3] - cross(by, wrench[3:]), wrench[3:]])


def opposite_mean(on_a: Array, on_b: Array) -> Array:
    """The wrench of a on b (6,) of what both feel, at one point and in the same axes [Nm, N]."""
    return 0.5 * (on_b - on_a)


class WrenchBetween(LeafSystem):
    """Wrench of arm a on arm b.

    ```
    name: WrenchBetween
    input_ports: [estimated_wrench, joint_position]
    output_ports: [wrench]
    ```

    estimated_wrench: shape (6a,), of the environment on each arm at its TCP in the world, [torque; force] [Nm, N].
    joint_position: shape (n,) [rad].
    wrench: shape (6,), of arm a on arm b, at the TCP of b in `expressed_in` [Nm, N].
    Feedthrough of both inputs.

    Sampling: none; evaluated when read.

    Args:
        robot: with both arms.
        between: names of a and b.
        expressed_in: a frame of the robot; the world when None.

    Raises:
        BadInputError: not two different arms of the robot.
    """

    def __init__(self, robot: RobotModel, between: tuple[str, str], expressed_in: Frame | None = None):
        super().__init__()
        arms = list(robot.parts.arms)
        for name in between:
            if name not in arms:
                raise unknown("between", name, arms)
        if len(set(between)) != 2:
            raise invalid("between", list(between), "two different arms")
        self._rows = [slice(6 * arms.index(name), 6 * arms.index(name) + 6) for name in between]
        self._tips = [robot.parts.arms[name].tcp_frame for name in between]
        self._axes = robot.plant.world_frame() if expressed_in is None else expressed_in
        self._plant = robot.plant
        self._wrenches = self.DeclareVectorInputPort("estimated_wrench", 6 * len(arms))
        position = self.DeclareVectorInputPort("joint_position", robot.num_joints)
        self._posture = posture_cache(self, robot, position)
        self.port_units = {"wrench": "Nm,N"}
        self.DeclareVectorOutputPort(
            "wrench",
            6,
            self._between,
            prerequisites_of_calc={self._wrenches.ticket(), self._posture.ticket()},
        )

    def _between(self, context: Context, output: BasicVector) -> None:
        posture, world = self._posture.Eval(context), self._plant.world_frame()
        on_a, on_b = (self._wrenches.Eval(context)[rows] for rows in self._rows)
        p_a, p_b = (self._plant.CalcPointsPositions(posture, tip, np.zeros(3), world).ravel() for tip in self._tips)
        wrench = opposite_mean(moved_wrench(on_a, p_b - p_a), on_b)
        rotation = self._plant.CalcRelativeRotationMatrix(posture, self._axes, world).matrix()
        output.SetFromVector(np.concatenate([rotation @ wrench[:3], rotation @ wrench[3:]]))

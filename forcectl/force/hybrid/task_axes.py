"""The task frame K of hybrid control, and the wrench of a wrist sensor in it.

    tau_K = R_KS (tau_S - p_ST x f_S),    f_K = R_KS f_S

K has its origin at the TCP. Its axes are those of the TCP frame T turned by a constant rotation, R_WK = R_WT R_TK, and
move with the tool; or they stay in the world as they are at the start. Axes that follow a surface are those that move
with the tool, turned by the smallest rotation that makes z the normal of the surface. S is the frame of the sensor.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.framework.block import PythonBlock
from forcectl.framework.kernels import cross, cross_matrix
from forcectl.robot.model import RobotModel, posture_cache

DIRECTIONS = ("rx", "ry", "rz", "x", "y", "z")  # in the order of spatial vectors


class TaskAxes:
    """The axes of the task frame.

    Args:
        robot: kinematics, with the TCP.
        start: joint positions at the start, shape (n,) [rad].
        rotation: R_TK at the start, shape (3, 3).
        fixed_in_world: whether the axes stay as at the start; else they move with the tool.
        follow: whether z follows the normal of the surface.
    """

    def __init__(
        self, robot: RobotModel, start: Array, rotation: Array, *, fixed_in_world: bool = False, follow: bool = False
    ):
        self.robot, self.fixed_in_world, self.follow = robot, fixed_in_world, follow
        self._in_tool = rotation
        self._in_world = robot.pose(robot.context_at(start)).rotation().matrix() @ rotation

    @property
    def start(self) -> Array:
        """R_WK at the start, shape (3, 3)."""
        return self._in_world

    def rotation(self, plant_context: Context, normal: Array | None = None) -> Array:
        """R_WK in the posture of a context of `robot.plant`, shape (3, 3).

        Args:
            normal: unit normal of the surface that z follows, in the world, shape (3,); None: it follows none.
        """
        if self.fixed_in_world:
            return self._in_world
        moved: Array = self.robot.pose(plant_context).rotation().matrix() @ self._in_tool
        return moved if normal is None else shortest_turn(moved[:, 2], normal) @ moved


def shortest_turn(start: Array, end: Array) -> Array:
    """The rotation from one unit vector to another about the axis perpendicular to both, shape (3, 3)."""
    across = cross_matrix(cross(start, end))
    return np.eye(3) + across + across @ across / (1.0 + start @ end)


class TaskWrench(PythonBlock):
    """Transforms the wrench of the wrist sensor to the TCP and the task frame.

    ```
    name: TaskWrench
    input_ports: [measured_wrench, motor_position, task_normal (optional)]
    output_ports: [task_wrench]
    ```

    measured_wrench: shape (6,), of the environment on the tool, at S in S, [torque; force] [Nm, N].
    motor_position: shape (n,), posture for which the axes are computed [rad].
    task_normal: shape (3,), see `SurfaceNormal` [1]; the port exists where the axes follow a surface.
    task_wrench: shape (6,), the same wrench at the TCP in the task frame K [Nm, N]. Feedthrough of all inputs.

    Sampling: none; evaluated when read.

    Args:
        axes: of the task frame.
    """

    port_units = {"task_wrench": "Nm,N", "task_normal": "1"}

    def __init__(self, axes: TaskAxes):
        super().__init__()
        self._axes, robot = axes, axes.robot
        self._sensor = robot.arm.sensor_frame or robot.arm.flange_frame
        self._wrench = self.DeclareVectorInputPort("measured_wrench", 6)
        position = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        self._posture = posture_cache(self, robot, position)
        self._normal = self.DeclareVectorInputPort("task_normal", 3) if axes.follow else None
        reads = {self._wrench.ticket(), self._posture.ticket()}
        reads |= {self._normal.ticket()} if self._normal is not None else set()
        self.DeclareVectorOutputPort("task_wrench", 6, self._show, prerequisites_of_calc=reads)

    def _show(self, context: Context, output: BasicVector) -> None:
        torque, force = self._wrench.Eval(context).reshape(2, 3)
        plant_context = self._posture.Eval(context)
        X_WS = self._sensor.CalcPoseInWorld(plant_context)
        p_ST = X_WS.inverse().multiply(self._axes.robot.tip_position(plant_context))
        normal = None if self._normal is None else self._normal.Eval(context)
        R_SK = X_WS.rotation().matrix().T @ self._axes.rotation(plant_context, normal)
        output.SetFromVector(np.concatenate([(torque - cross(p_ST, force)) @ R_SK, force @ R_SK]))

"""Force along task coordinates, from estimated wrenches, for admittance control and guards of state machines.

    F = J_x^T W,    V = J_x x'

with the wrench W at the origin of the task's frame and the velocity V of that frame. In every motion of the coordinates
the generalized force F has the same power as W. Along positions it is the force, along angles the torque about the axes
of their rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context

from forcectl.errors import invalid, unknown
from forcectl.framework.block import BlockCache, PythonBlock
from forcectl.framework.kernels import all_finite
from forcectl.robot.model import RobotModel, posture_cache
from forcectl.robot.robot_motion import pose_parts
from forcectl.tasks.coordinates import ArmTask


class TaskForce(PythonBlock):
    """Force of the environment on the follower along its task coordinates, from the estimated wrenches of all arms.

    ```
    name: TaskForce
    input_ports: [estimated_wrench, joint_position]
    output_ports: [task_force, task_wrench]
    ```

    estimated_wrench: shape (6a,), of the environment on each arm at its TCP in the world, [torque; force] [Nm, N].
    joint_position: shape (n,) [rad].
    task_force: shape (k,), along the coordinates of all tasks one after the other, positive towards larger values
    [N or Nm].
    task_wrench: shape (6t,), of each of t tasks, [torque; force] [Nm, N]. Its reference point is the origin of the task
    frame. Its axes are those of the coordinates: for an `ArmTask` the world's, for a `RelativeTask` the leader frame's.
    All outputs are feedthrough of all inputs.

    For a `RelativeTask` the wrench is the mean of the estimates of follower and leader, see
    `forcectl.estimation.wrench_between`. Inputs that are not finite give NaN: a wrench in the tasks of its arm, a joint
    position in all.

    Sampling: none; evaluated when read.

    Args:
        robot: with the arms of the tasks.
        tasks: in the order of the coordinates.
        of_both: whether wrenches of relative tasks are that mean; False: the estimate of the follower only.

    Raises:
        BadInputError: no task, or a task of an unknown arm.
    """

    port_units = {"task_force": "", "task_wrench": "Nm,N"}

    def __init__(
        self,
        robot: RobotModel,
        tasks: Sequence[ArmTask],
        *,
        of_both: bool = True,
    ):
        super().__init__()
        if not tasks:
            raise invalid("tasks", list(tasks), "at least one")
        self._tasks, self._of_both = tuple(tasks), of_both
        self._tips = {name: arm.tcp_frame for name, arm in robot.parts.arms.items()}
        for task in tasks:
            for name in (task.arm, getattr(task, "leader", task.arm)):
                if name not in self._tips:
                    raise unknown("arm", name, self._tips)
        self._size = sum(task.size for task in tasks)
        wrenches = self.DeclareVectorInputPort("estimated_wrench", 6 * len(self._tips))
        position = self.DeclareVectorInputPort("joint_position", robot.num_joints)
        self._wrenches, self._position = wrenches, position
        self._posture = posture_cache(self, robot, position)
        now: Any = BlockCache(
            self,
            "wrenches of the tasks",
            lambda: Value[object](()),
            lambda block, context, value: block._compute(context, value),
            {wrenches.ticket(), self._posture.ticket()},
        )

        def put(element: int) -> Any:
            return lambda context, output: output.SetFromVector(now.Eval(context)[element])

        for element, (name, size) in enumerate((("task_force", self._size), ("task_wrench", 6 * len(tasks)))):
            self.DeclareVectorOutputPort(name, size, put(element), prerequisites_of_calc={now.ticket()})

    def _compute(self, context: Context, value: AbstractValue) -> None:
        readings = self._wrenches.Eval(context).reshape(-1, 6)
        if not all_finite(self._position.Eval(context)):
            value.set_value((np.full(self._size, np.nan), np.full(6 * len(self._tasks), np.nan)))
            return
        posture = self._posture.Eval(context)
        tips = {name: pose_parts(frame.CalcPoseInWorld(posture)) for name, frame in self._tips.items()}
        wrenches = dict(zip(tips, readings, strict=True))
        external = [task.external_wrench(tips, wrenches, of_both=self._of_both) for task in self._tasks]
        forces = [task.forces(*each) for task, each in zip(self._tasks, external, strict=True)]
        value.set_value((np.concatenate(forces), np.concatenate([each[1] for each in external])))

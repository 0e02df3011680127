"""Estimate of the normal of a surface that curves along the path, from the measured contact force::

    n += (1 - exp(-w Ts)) (F/|F| - n),    n = n/|n|                       while n'F is above a least force

Without friction the force of a surface is along its normal. Coulomb friction turns the estimate by atan(mu) at most,
against the motion. The estimate lags by the lag of the force sensor plus 1/w.
"""

from __future__ import annotations

import math

import numpy as np
from pydrake.systems.framework import Context

from forcectl.force.hybrid.task_axes import TaskAxes
from forcectl.framework.batch import check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite
from forcectl.framework.sampled_block import Memory, SampledBlock


class SurfaceNormal(SampledBlock):
    """Estimates the outward normal of the surface that a tool presses on, from the wrench of its wrist sensor.

    ```
    name: SurfaceNormal
    input_ports: [measured_wrench, motor_position]
    output_ports: [task_normal]
    ```

    measured_wrench: shape (6,), of the environment on the tool, at S in S, [torque; force] [Nm, N].
    motor_position: shape (n,) [rad].
    task_normal: shape (3,), n in the world [1]; at the start the z axis of the task frame. Feedthrough of all inputs at
    the tick, and held.

    Where the force along n is below `least_force`, or not a number, n is held. It turns no further than `largest_turn`
    from the start.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        axes: of the task frame.
        bandwidth: w [rad/s].
        least_force: force along n below which the estimate is held [N].
        largest_turn: largest angle between n and its start [rad].
    """

    port_units = {"task_normal": "1"}

    def __init__(
        self,
        axes: TaskAxes,
        *,
        bandwidth: float = 10.0,
        least_force: float = 2.0,
        largest_turn: float = 1.0,
        period: float = 0.002,
    ):
        super().__init__()
        robot = axes.robot
        self._robot, self._start = robot, axes.start[:, 2].copy()
        self._sensor = robot.arm.sensor_frame or robot.arm.flange_frame
        self._share = 1.0 - math.exp(-check("bandwidth", bandwidth, "positive") * period)
        self._least = check("least_force", least_force, "positive")
        self._largest = math.cos(check("largest_turn", largest_turn, "positive"))
        self._place = scratch(self, "robot posture", robot.create_context)
        wrench = self.DeclareVectorInputPort("measured_wrench", 6)
        motors = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        self.declare_memory({"task_normal": self._start}, [wrench, motors], period)
        self.show("task_normal")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, object]:
        """One tick."""
        wrench, q, n = inputs["measured_wrench"], inputs["motor_position"], memory["task_normal"]
        if not all_finite(wrench, q):
            return dict(memory)
        plant_context = self._place.Eval(context)
        self._robot.set_positions(plant_context, q)
        force = self._sensor.CalcPoseInWorld(plant_context).rotation().matrix() @ wrench[3:]
        if n @ force < self._least:
            return dict(memory)
        turned = n + self._share * (force / np.linalg.norm(force) - n)
        turned /= np.linalg.norm(turned)
        return {"task_normal": turned if turned @ self._start >= self._largest else n}

"""Joint commands of hybrid control: displacements of force laws in selected directions, a reference in the others::

    V = R_K (S d + (I - S) R_K' J(q_uc) dq_uc),    q_bar = q_bar + J(q_bar)^+ V                    per tick

S selects directions, d are the changes of the displacements dx_bar that the force laws command, dq_uc those of the
reference in the unconstrained directions, q_uc = q_0 plus that reference. J is always that of commanded postures, so
that directions without a reference stay as at the start, whatever the tracking errors of the drives.

Near singularities, singular values s of J (translations divided by `length`) below a limit e are inverted as s/e^2,
which is continuous and never larger than 1/e.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from forcectl.arrays import Array
from forcectl.force.hybrid.task_axes import TaskAxes
from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite
from forcectl.framework.sampled_block import Memory, SampledBlock


def joint_motion(jacobian: Array, motion: Array, *, smallest: float, length: float) -> tuple[Array, bool]:
    """Least-squares joint motion of a small motion of the tool.

    Args:
        jacobian: J_WT, shape (6, n), rotations above translations [1; m].
        motion: of the TCP in the world, [rotation; translation], shape (6,) [rad, m].
        smallest: e, singular value below which the inverse is damped [1].
        length: by which translations are divided [m].

    Returns:
        joint motion, shape (n,) [rad], and whether the inverse was damped.
    """
    scale = np.repeat([1.0, 1.0 / length], 3)
    U, s, Vt = np.linalg.svd(scale[:, None] * jacobian, full_matrices=False)
    joints: Array = Vt.T @ (s / np.maximum(s, smallest) ** 2 * (U.T @ (scale * motion)))
    return joints, bool(s[-1] < smallest)


class HybridMotion(SampledBlock):
    """Joint command for displacements in selected directions of a task frame, and for a reference motion in the others.

    ```
    name: HybridMotion
    input_ports: [displacement_command, motor_position, unconstrained_reference, task_normal (optional)]
    output_ports: [joint_position_command, near_singular, motor_displacement]
    ```

    displacement_command: shape (m,), dx_bar in the selected directions, from the start [m, rad].
    motor_position: shape (n,) [rad].
    unconstrained_reference: shape (n,), joint motion dq_uc, from the start [rad]. Its components in selected directions
    are ignored.
    task_normal: shape (3,), see `SurfaceNormal` [1]; the port exists where the axes follow a surface.
    joint_position_command: shape (n,), q_bar [rad]. Feedthrough of displacement_command, unconstrained_reference and
    task_normal at the tick, and held.
    near_singular: shape (1,), 1 while the inverse is damped, else 0 [1]. Feedthrough of displacement_command,
    unconstrained_reference and task_normal at the tick, and held.
    motor_displacement: shape (m,), actual displacement of the motors along the selected directions [m, rad]: the
    command of the last tick minus the tracking error of the motors. Feedthrough of motor_position and task_normal.

    A command or reference that is not a number holds the joint command; the next valid one makes up for it.

    Sampling: every `period` [s]; no delay from displacement_command to joint_position_command, see `SampledBlock`.

    Args:
        axes: of the task frame.
        selected: indices of the m directions, in the order of spatial vectors.
        start: q_0, shape (n,) [rad].
        smallest: e, singular value of J below which the inverse is damped [1].
    """

    port_units = {
        "displacement_command": "m,rad",
        "motor_displacement": "m,rad",
        "near_singular": "1",
        "task_normal": "1",
    }

    def __init__(
        self, axes: TaskAxes, selected: Sequence[int], start: Array, *, smallest: float = 0.02, period: float = 0.002
    ):
        super().__init__()
        robot, size = axes.robot, len(selected)
        self._axes, self._selected = axes, list(selected)
        self._start = batch_values("start", start, robot.num_joints)
        self._smallest = check("smallest", smallest, "positive")
        self._length = robot.parameters.characteristic_length
        command = self.DeclareVectorInputPort("displacement_command", size)
        self._motors = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        unconstrained = self.DeclareVectorInputPort("unconstrained_reference", robot.num_joints)
        self._normal = self.DeclareVectorInputPort("task_normal", 3) if axes.follow else None
        turning = [] if self._normal is None else [self._normal]
        self._place = scratch(self, "robot posture", robot.create_context)
        memory = {
            "joint_position_command": self._start,
            "near_singular": 0.0,
            "displacement": np.zeros(size),
            "unconstrained": np.zeros(robot.num_joints),
        }
        self.declare_memory(memory, [command, unconstrained, *turning], period)
        self.show("joint_position_command", "near_singular")
        reads = {self._motors.ticket(), self.discrete_state_ticket(self._state), *(port.ticket() for port in turning)}
        self.DeclareVectorOutputPort("motor_displacement", size, self._show_motors, prerequisites_of_calc=reads)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, object]:
        """One tick."""
        command, unconstrained = inputs["displacement_command"], inputs["unconstrained_reference"]
        if not all_finite(command, unconstrained):
            return dict(memory)
        plant_context, robot = self._place.Eval(context), self._axes.robot
        moved = np.zeros(6)
        if (unconstrained != memory["unconstrained"]).any():
            robot.set_positions(plant_context, self._start + unconstrained)
            moved = robot.jacobian(plant_context) @ (unconstrained - memory["unconstrained"])
        q = memory["joint_position_command"]
        robot.set_positions(plant_context, q)
        R = self._axes.rotation(plant_context, inputs.get("task_normal"))
        in_task = (moved.reshape(2, 3) @ R).ravel()
        in_task[self._selected] = command - memory["displacement"]
        motion = (in_task.reshape(2, 3) @ R.T).ravel()
        joints, damped = joint_motion(
            robot.jacobian(plant_context), motion, smallest=self._smallest, length=self._length
        )
        return {
            "joint_position_command": q + joints,
            "near_singular": float(damped),
            "displacement": command,
            "unconstrained": unconstrained,
        }

    def _show_motors(self, context: Context, output: BasicVector) -> None:
        held, plant_context, robot = self.held(context), self._place.Eval(context), self._axes.robot
        q = held["joint_position_command"]
        robot.set_positions(plant_context, q)
        behind = robot.jacobian(plant_context) @ (self._motors.Eval(context) - q)
        normal = None if self._normal is None else self._normal.Eval(context)
        in_task = (behind.reshape(2, 3) @ self._axes.rotation(plant_context, normal)).ravel()
        output.SetFromVector(held["displacement"] + in_task[self._selected])

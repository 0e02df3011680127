"""Motion of compliant tasks, mode by mode (Figs. 6.3, 6.4 and 5.3)::

    estimated wrenches -> task forces -> references (x~, x~', x~'') -> reactive controller -> joint references
                                         references <- commanded motion of the tasks (state of the controller) <-

The references of each coordinate in a mode are configured as in `forcectl.tasks.compliance.parts`.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import export_all_outputs
from forcectl.tasks.compliance.references import CompliantReferences, ModeReferences
from forcectl.tasks.compliance.task_force import TaskForce
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import wire_motion


class CompliantMotion(PythonDiagram):
    """Reactive controller whose references follow a generator, comply with forces, or both, by modes.

    ```
    name: CompliantMotion
    input_ports: [joint_position, joint_velocity, measured_force (optional), mode (optional), estimated_wrench
    (optional)]
    output_ports: [joint_position_command, joint_velocity_command, task_position_reference, task_position,
    task_velocity, task_acceleration, status, active_constraints, slack, constraint_violation, tracking_error,
    near_singular, levels_solved, holding, reached, stalled, reading_ok, stage_costs, task_target,
    task_displacement, task_force_ok, task_force (optional), task_wrench (optional)]
    ```

    joint_position: shape (n,), as measured [rad]; may be left unconnected without `forces`.
    mode: shape (1,), number of the mode from 0 on [1]. The port exists only if the controller has modes.
    estimated_wrench: see `TaskForce`. The port exists only with `forces`.
    task_force, task_wrench: see `TaskForce`. The ports exist only with `forces`. Feedthrough of joint_position and
    estimated_wrench.
    task_position_reference: shape (k,), at the next tick [m or rad]. Feedthrough of joint_position, mode and
    estimated_wrench.
    task_position, task_velocity, task_acceleration: shape (k,), commanded motion of the tasks [m or rad, m/s or rad/s,
    m/s^2 or rad/s^2]. State.
    task_target, task_displacement, task_force_ok: see `CompliantReferences`. Feedthrough of joint_position, mode and
    estimated_wrench.
    The other ports: see `ReactiveController`. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the controller; no delay from the forces or the measurements to the joint
    references.

    Args:
        controller: becomes a part of this diagram.
        references: one for each of its modes.
        forces: along the coordinates of its tasks; may be None if no coordinate complies.

    Raises:
        BadInputError: another number of modes than the controller has, or a coordinate complies without forces.
    """

    optional_inputs = ("joint_velocity",)

    def __init__(
        self, controller: ReactiveController, references: Sequence[ModeReferences], forces: TaskForce | None = None
    ):
        super().__init__()
        if len(references) != controller.num_modes:
            wanted = f"{controller.num_modes}, one for each mode of the controller"
            raise BadInputError(f"references: {len(references)} of them: must be {wanted}")
        builder = DiagramBuilder()
        builder.AddNamedSystem("controller", controller)
        sizes = [task.size for task in controller.tasks]
        block = CompliantReferences(references, sizes, controller.task_start, period=controller.period)
        if block.complies and forces is None:
            raise BadInputError("comply: must be false unless the forces along the tasks are given")
        builder.AddNamedSystem("references", block)
        made = {
            name: block.GetOutputPort(f"task_{name}_reference") for name in ("position", "velocity", "acceleration")
        }
        exported = wire_motion(builder, controller, block, made)
        builder.Connect(block.GetOutputPort("task_target"), controller.GetInputPort("task_target"))
        if "mode" in exported:
            builder.ConnectInput(exported["mode"], block.GetInputPort("mode"))
        export_all_outputs(builder, block, but=[port.get_name() for port in made.values()])
        if forces is not None:
            builder.AddNamedSystem("forces", forces)
            builder.ConnectInput(exported["joint_position"], forces.GetInputPort("joint_position"))
            builder.ExportInput(forces.GetInputPort("estimated_wrench"), "estimated_wrench")
            if block.complies:
                builder.Connect(forces.GetOutputPort("task_force"), block.GetInputPort("task_force"))
            export_all_outputs(builder, forces)
        builder.BuildInto(self)

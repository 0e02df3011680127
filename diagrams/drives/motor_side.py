"""The motor side of a robot without dynamics: joint filters, and the servo with friction along the constrained
direction.

Joint motion along J^-1 n goes through the scalar servo, everything else follows the filtered joint reference:

    q_m = q_f + J^-1 n (x - n'J (q_f - q_0)),    x = servo(n'J (q_f - q_0))           with J of the start posture

The friction is calibrated along n only, so it acts along n only.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import MatrixGain

from forcectl.diagrams.workcell import Workcell
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import affine, export_outputs, split, stacked, through
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig


class MotorSide(PythonDiagram):
    """Position loop and servo along n.

    ```
    name: MotorSide
    input_ports: [joint_position_command]
    output_ports: [motor_position, motor_velocity, displacement]
    ```

    joint_position_command, motor_position: shape (n_q,) [rad]. motor_velocity: shape (n_q,) [rad/s].
    displacement: shape (1,), x along n by the constant Jacobian [m]. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the workcell; a command moves the motors one tick later.

    Args:
        workcell: the workcell, with one surface.
        loop: its position loops.
        servo: along the normal.
    """

    def __init__(self, workcell: Workcell, loop: PositionLoopConfig, servo: ServoConfig):
        super().__init__()
        contact, n_q, q_0 = workcell.contact, workcell.num_joints, workcell.motor_start
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        # Relative to the start, so that the only rounding errors in a force loop are those of the command.
        motion = add("joint_motion", affine(np.eye(n_q), -q_0))
        builder.ExportInput(motion.get_input_port(), "joint_position_command")
        filter_ = loop.add_to(builder, n_q, workcell.period)
        connect(motion.get_output_port(), filter_.GetInputPort("command"))
        reference = filter_.GetOutputPort("reference")

        row, column, nothing = contact.row, contact.direction.reshape(-1, 1), np.zeros(n_q)
        normal = MatrixGain(np.block([[row, nothing], [nothing, row]]))
        along = through(builder, "along_normal", normal, reference)
        if servo.ideal:
            x, rate = split(builder, "displacement_and_rate", [1, 1], along)
        else:
            axis = servo.add_to(builder, 1, workcell.period)
            connect(along, axis.GetInputPort("reference"))
            x, rate = axis.GetOutputPort("position"), axis.GetOutputPort("velocity")

        across, zero = np.eye(n_q) - column @ row.reshape(1, -1), np.zeros((n_q, n_q))
        position = add("motor_position", affine(np.hstack([across, zero, column]), q_0))
        velocity = add("motor_velocity", MatrixGain(np.hstack([zero, across, column])))
        for block, scalar in ((position, x), (velocity, rate)):
            connect(stacked(builder, f"{block.get_name()}_inputs", [reference, scalar]), block.get_input_port())
        export_outputs(
            builder,
            {
                "motor_position": position.get_output_port(),
                "motor_velocity": velocity.get_output_port(),
                "displacement": x,
            },
        )
        builder.BuildInto(self)

"""The torque interface of a robot: joint impedance control on drives that take torques.

Has the ports of `forcectl.plant.drives.drive.Drive` and takes its place in the multibody station.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from forcectl.arrays import Vector
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import export_outputs
from forcectl.plant.drives.joint_impedance import GravityCompensation, JointImpedance, JointImpedanceConfig
from forcectl.plant.drives.motors import MOTOR_PORTS, joint_to_motor
from forcectl.plant.drives.torque_drive import TorqueDrive

_MOST_TAKEN = 1.7  # largest share of a motor's speed that is removed per tick; from 2 on the speed grows


class TorqueInterface(PythonDiagram):
    """Joint impedance control, gravity compensation and torque-controlled drives of a workcell's robot.

    ```
    name: TorqueInterface
    input_ports: [reference, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity, torque_command, motor_torque]
    ```

    reference: shape (2n,), q_bar and its rate [rad, rad/s].
    torque_command: shape (n,), of the impedance control [Nm]. Feedthrough of reference at the tick.
    motor_torque: shape (n,) [Nm]. Feedthrough of all inputs.
    The others: see `TorqueDrive`. All outputs are state, no direct feedthrough.

    Sampling: every `time_step` [s] of the workcell the drives; every `period` [s] impedance and gravity compensation.

    Args:
        workcell: the workcell.
        interface: gains of impedance and torque control.
        friction_scale: factor on the joint friction of the control parameters [1].

    Raises:
        BadInputError: gains that are not stable with this sampling.
    """

    def __init__(self, workcell: Workcell, interface: JointImpedanceConfig, friction_scale: float):
        super().__init__()
        step, robot, n = workcell.config.time_step, workcell.robot, workcell.num_joints
        parameters, springs = robot.parameters, workcell.spring_stiffness
        inertia = robot.parameters.reflected_inertia
        stiffness = workcell.drive_stiffness
        links = np.diag(robot.mass_matrix(workcell.start_context()))
        damping = interface.joint_damping(stiffness, inertia + links)
        _check_sampling(workcell.period, step, stiffness, damping, inertia / (1 + interface.torque_gain), springs)
        self.port_units = {"reference": "rad,rad/s", "torque_command": "Nm"}
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        gravity = add(
            "gravity_compensation", GravityCompensation(robot, workcell.start, springs, period=workcell.period)
        )
        impedance = add(
            "joint_impedance",
            JointImpedance(
                n,
                stiffness=stiffness,
                damping=damping,
                initial_reference=workcell.motor_start,
                initial_torque=workcell.gravity_torque,
                period=workcell.period,
            ),
        )
        drive = add(
            "drive",
            TorqueDrive(
                inertia,
                joint_to_motor(robot),
                period=step,
                torque_gain=interface.torque_gain,
                friction_bandwidth=interface.friction_bandwidth,
                torque_limit=robot.limits.torque,
                coulomb_friction=friction_scale * parameters.coulomb_friction,
                viscous_friction=friction_scale * parameters.viscous_friction,
                initial_position=workcell.motor_start,
            ),
        )
        connect(drive.GetOutputPort("motor_position"), gravity.GetInputPort("motor_position"))
        connect(drive.GetOutputPort("motor_state"), impedance.GetInputPort("motor_state"))
        connect(gravity.GetOutputPort("gravity_torque"), impedance.GetInputPort("gravity_torque"))
        connect(impedance.GetOutputPort("torque_command"), drive.GetInputPort("torque_command"))
        builder.ExportInput(impedance.GetInputPort("reference"), "reference")
        builder.ExportInput(drive.GetInputPort("spring_torque"), "spring_torque")
        export_outputs(builder, {name: drive.GetOutputPort(name) for name in MOTOR_PORTS})
        builder.ExportOutput(impedance.GetOutputPort("torque_command"), "torque_command")
        builder.ExportOutput(drive.GetOutputPort("motor_torque"), "motor_torque")
        builder.BuildInto(self)


def _check_sampling(
    tick: float, step: float, stiffness: Vector, damping: Vector, inertia: Vector, springs: Vector
) -> None:
    """Raise BadInputError for gains that are unstable when sampled every `tick`, and every `step` of the plant.

    Of 300 random gains, postures, surfaces and sampling periods within these bounds none was unstable; well beyond them
    nearly all are. `inertia` is that of the motors as reduced by the torque loop.
    """
    taken = (damping * tick + springs * step**2) / inertia
    worst = int(np.argmax(taken))
    if taken[worst] > _MOST_TAKEN:
        raise BadInputError(
            f"damping and torque loop of joint {worst + 1} take {taken[worst]:.3g} of its motor's speed per "
            f"tick: must be at most {_MOST_TAKEN} (lower stiffness, damping_ratio or torque_gain, or a shorter period "
            "or time_step)",
            key="drive",
        )
    worst = int(np.argmax(stiffness * tick / damping))
    if stiffness[worst] * tick > damping[worst]:
        raise BadInputError(
            f"damping of joint {worst + 1}, {damping[worst]:.3g} Nms/rad: must be at least its stiffness "
            f"times the period, {stiffness[worst] * tick:.3g} Nms/rad (higher damping_ratio, or a shorter period)",
            key="drive",
        )

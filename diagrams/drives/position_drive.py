"""The drives of a position-controlled robot: `drive: !PositionLoop`.

Without dynamics the joint filters and a servo with friction along the normal, see
`forcectl.diagrams.drives.motor_side`; in a multibody station, per joint,

    joint_position_command -> hold -> position loop -> servo with motor inertia and friction -> motor side

Delays beside the configured one: the command delay is at least one plant step, and the motor state reaches the springs
one plant step late, because simultaneous events read the state before them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import LinearSystem

from forcectl.arrays import Vector
from forcectl.diagrams.drives.motor_side import MotorSide
from forcectl.diagrams.drives.torque_interface import TorqueInterface
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_outputs
from forcectl.plant.drives.drive import Drive
from forcectl.plant.drives.joint_impedance import JointImpedanceConfig
from forcectl.plant.drives.motors import MOTOR_PORTS, export_motion, joint_to_motor, loop_inertia
from forcectl.plant.drives.position_loop import PositionLoopConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.robot.model import RobotModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_LARGEST_DRIVE_STEP = 0.5e-3  # [s] longer steps do not resolve how friction sticks and slips


@dataclass(kw_only=True)
class PositionDriveConfig(Config, in_batches=True):
    """Scenario part `drive: !PositionLoop`: the drives take positions, which their servos follow."""

    position_loop: PositionLoopConfig = key(PositionLoopConfig, "filter and delay of the joint references")
    servo: ServoConfig = key(ServoConfig, "position loops of the motors")
    encoders: bool = key(
        False,
        "true: controllers read motor positions from the encoders of a sensor !JointReadings, with its resolution; "
        "false: exact motor positions",
    )

    @property
    def readings(self) -> dict[str, str]:
        """Names of measured signals that replace true signals of the simulation, by the name of the true one."""
        return {"motor_position": "joint_position"} if self.encoders else {}

    def delays(self) -> dict[str, float]:
        """Delays [s] by key of the station."""
        return {"drive.position_loop.delay": self.position_loop.delay}

    def pressing(self, workcell: Workcell, contact: Contact, stiffness: float) -> StateSpace:
        """Response from [dx_bar, its rate] to the contact force for this K_E [N/m], per tick, without friction.

        The stiffness on the link side is that at rest; the inertia of the links is left out. With dynamics the command
        has a delay of at least one plant step, see `PositionDrive`.
        """
        step = workcell.config.time_step if workcell.has_dynamics else 0.0
        reference = self.position_loop.sampled_response(workcell.period, step)
        moved = self.servo.sampled_response(workcell.period) * reference
        return contact.sampled_response(stiffness, workcell.period) * moved

    def needed_torque(self, workcell: Workcell, springs: Vector, speeds: Vector) -> Vector:
        """Largest torque that the motors may need for a motion, shape (k, n) [Nm]; the drives have no limit.

        It balances inertia, joint springs and friction; a motor that sticks may need up to its Coulomb friction.

        Args:
            workcell: the workcell.
            springs: torques of the joint springs on the links at the ticks (k, n) [Nm].
            speeds: of the motors (k, n) [rad/s].
        """
        robot = workcell.robot
        to_motor, parameters = joint_to_motor(robot), robot.parameters
        axes = speeds @ to_motor.T
        bends = np.diff(axes, axis=0, prepend=axes[:1]) / workcell.period
        moved = springs @ np.linalg.inv(to_motor) + parameters.reflected_inertia * bends
        moved += self.servo.friction_scale * parameters.viscous_friction * axes
        rubbing = self.servo.friction_scale * parameters.coulomb_friction
        return np.where(axes == 0.0, np.abs(moved) + rubbing, np.abs(moved + rubbing * np.sign(axes)))

    def add_to(self, builder: DiagramBuilder, site: Site) -> System:
        """Add the block `drive`."""
        if not site.workcell.has_dynamics:
            return builder.AddNamedSystem("drive", MotorSide(site.workcell, self.position_loop, self.servo))
        servo = None if self.servo.ideal else self._servo(site.workcell)
        return builder.AddNamedSystem("drive", PositionDrive(site.workcell, self.position_loop, servo))

    def _servo(self, workcell: Workcell) -> System:
        robot, servo, step = workcell.robot, self.servo, workcell.config.time_step
        parameters, rotors = robot.parameters, robot.parameters.reflected_inertia
        return Drive(
            rotors,
            joint_to_motor(robot),
            servo.gains(rotors, loop_inertia(robot)),
            period=step,
            substeps=max(1, math.ceil(step / _LARGEST_DRIVE_STEP - 1e-9)),
            coulomb_friction=servo.friction_scale * parameters.coulomb_friction,
            viscous_friction=servo.friction_scale * parameters.viscous_friction,
            initial_position=workcell.motor_start,
            initial_torque=workcell.gravity_torque * workcell.config.elastic_joints,
        )


@dataclass(kw_only=True)
class JointImpedanceDriveConfig(JointImpedanceConfig, PositionDriveConfig):
    """Scenario part `drive: !JointImpedance`: the drives take torques, and impedance control holds the joints.

    With dynamics the drives are torque-controlled. Without, the joint stiffness of impedance control is in series with
    the joint springs.
    """

    def holding_stiffness(self, robot: RobotModel) -> Vector:
        """K_q, shape (n,) [Nm/rad]."""
        return self.joint_stiffness(robot.parameters.reflected_inertia)

    def _servo(self, workcell: Workcell) -> System:
        return TorqueInterface(workcell, self, self.servo.friction_scale)

    def add_to(self, builder: DiagramBuilder, site: Site) -> System:
        """Add the block `drive`.

        Raises:
            BadInputError: rigid joints or an ideal servo, where torques are controlled.
        """
        if site.workcell.has_dynamics:
            because = "with drive = !JointImpedance"
            if not site.workcell.config.elastic_joints:
                raise invalid("elastic_joints", False, f"true {because}: the torques in the joints are controlled")
            if self.servo.ideal:
                raise invalid("drive.servo.ideal", True, f"false {because}")
        return super().add_to(builder, site)


class PositionDrive(PythonDiagram):
    """Command hold, position loops and servos of a robot with dynamics.

    ```
    name: PositionDrive
    input_ports: [joint_position_command, spring_torque (optional)]
    output_ports: [motor_state, motor_position, motor_velocity]
    ```

    joint_position_command: shape (n,) [rad]. spring_torque: shape (n,), of the joint springs on the links [Nm]; not
    with an ideal servo.
    motor_state: shape (2n,), position and speed of the motors, joint side [rad, rad/s].
    motor_position, motor_velocity: shape (n,), its halves [rad, rad/s]. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the workcell the command; every `time_step` [s] of the workcell the rest.

    Args:
        workcell: the workcell.
        loop: its position loops.
        servo: with the ports of `Drive`; None: the motors follow the filtered command exactly.
    """

    def __init__(self, workcell: Workcell, loop: PositionLoopConfig, servo: System | None):
        super().__init__()
        n, q_0, step = workcell.num_joints, workcell.motor_start, workcell.config.time_step
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        # The command is held for a tick, then everything runs on at the plant's rate. Reading the hold takes one plant
        # step, which counts towards the command delay. A ZeroOrderHold would begin with zero.
        eye, nothing = np.eye(n), np.zeros((n, n))
        hold = add("command_hold", LinearSystem(nothing, eye, eye, nothing, workcell.period))
        hold.configure_default_state(q_0)
        builder.ExportInput(hold.get_input_port(), "joint_position_command")
        late = replace(loop, delay=max(0.0, loop.delay - step))
        filter_ = late.add_to(builder, n, step, initial_command=q_0)
        connect(hold.get_output_port(), filter_.GetInputPort("command"))
        reference = filter_.GetOutputPort("reference")
        if servo is None:
            export_motion(builder, reference)
        else:
            add("servo", servo)
            connect(reference, servo.GetInputPort("reference"))
            builder.ExportInput(servo.GetInputPort("spring_torque"), "spring_torque")
            export_outputs(builder, {name: servo.GetOutputPort(name) for name in MOTOR_PORTS})
        builder.BuildInto(self)

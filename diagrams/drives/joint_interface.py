"""The drives of a robot behind a joint interface: `drive: !JointInterface`.

References of position, speed and torque are sampled every control tick. Servo loops run at 2 kHz; the mean of their
torque acts on the plant, at 1 kHz: see `forcectl.plant.drives.joint_servo`. Friction (5.2) sticks.

Rigid joints    servo torque -> links with their rotors; friction is part of the plant's implicit step.
Elastic joints  servo torque -> rotors with friction -> springs -> links.

A command moves the motors one `time_step` after its tick, then with the lag of the servo: with a consistent speed
command an error of 1/w^2 times the acceleration, without one a delay of 2 zeta/w.

Simplifications: motors are torque sources, limited with `servo.torque_limits`; couplings between the rotors of
different joints are left out; friction does not depend on load or temperature.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from forcectl.arrays import Array
from forcectl.diagrams.mechanics.site import Site
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.errors import BadInputError, about, invalid
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.framework.wiring import export_outputs
from forcectl.motion.joint_dither import JointDither, JointDitherConfig
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.drives.joint_servo import JointServo
from forcectl.plant.drives.motor_motion import MotorMotion
from forcectl.plant.drives.motors import MOTOR_PORTS
from forcectl.plant.drives.position_loop import zero_order_hold
from forcectl.plant.drives.servo import ServoGains, servo_gains
from forcectl.robot.model import RobotModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace

LARGEST_STEP = 0.002  # [s] of the plant, for the servo loops
COMMANDS = ("joint_position_command", "joint_velocity_command", "joint_torque_feedforward")
DITHERED = ("dithered_position", "dithered_velocity")  # the first two of them, with a dither


@dataclass(kw_only=True)
class JointServoConfig(Config):
    """Scenario part `servo`: the position loops of the joints, see `forcectl.plant.drives.joint_servo`."""

    bandwidth: float | None = key(
        None,
        "bandwidth w of the position loops; null: that of the control parameters",
        unit="rad/s",
        bounds="from 0.1 to 10000",
    )
    damping_ratio: float | None = key(
        None,
        "damping ratio zeta of the position loops; null: that of the control parameters",
        unit="1",
        bounds="from 0.01 to 10",
    )
    integral_gain: float = key(
        15.0, "integral gain w_i of the position loops; 0: none", unit="1/s", bounds="from 0 to 10000"
    )
    rate: float = key(
        2000.0,
        "sampling rate of the servo loops, rounded to whole samples in a time step of the plant, at least one",
        unit="1/s",
        bounds="from 1 to 100000",
    )
    friction_compensation: float = key(
        0.0,
        "torque fed forward in the direction of the speed command / Coulomb friction of the joint; 0: none",
        bounds="from 0 to 1",
    )
    torque_limits: bool = key(True, "whether motor torques are limited; false: motors without torque limits")


@dataclass(kw_only=True)
class JointFrictionConfig(Config):
    """Scenario part `friction`: joint friction (5.2) with the numbers of the control parameters."""

    scale: float = key(1.0, "factor on all numbers of the joint friction", bounds="from 0 to 20")
    sticks: bool = key(
        True, "whether joints at rest stick; false: sat(130 q') for the sign of q', which creeps at rest as (5.2) does"
    )


@dataclass(kw_only=True)
class JointInterfaceConfig(Config):
    """Scenario part `drive: !JointInterface`: servo loops of all joints, with friction and torque limits."""

    servo: JointServoConfig = key(JointServoConfig, "position loops of the joints")
    friction: JointFrictionConfig = key(JointFrictionConfig, "friction of the joints")
    dither: JointDitherConfig = key(
        JointDitherConfig, "small oscillation of all joints, against static friction, that hardly moves the tools"
    )

    moves_links = True  # rigid joints get their torque directly
    # Exact, so true signals of the simulation; blocks that need them get the readings of the interface instead.
    readings: ClassVar[dict[str, str]] = {"motor_position": "joint_position", "motor_velocity": "joint_velocity"}

    def true_friction(self, robot: RobotModel) -> JointFriction:
        """Friction of the joints."""
        return JointFriction.of_parameters(robot.parameters).scaled(self.friction.scale)

    def resting_torque(self, workcell: Workcell) -> Array:
        """Motor torque at the start, shape (n,) [Nm]."""
        return workcell.gravity_torque + self.true_friction(workcell.robot).offset

    def sticking_travel(self, workcell: Workcell) -> Array:
        """Largest motion of the command of a joint that friction keeps at rest, shape (n,) [rad].

        From one end of the Coulomb friction to the other, in slow motion and with the integral at rest; and from one
        end of the dither to the other, which may cancel a motion.
        """
        gains, inertia = _gains(workcell, self.servo), np.diag(_mass_matrix(workcell))
        by_friction = 2 * self.true_friction(workcell.robot).coulomb / (gains.position * gains.velocity * inertia)
        by_dither = 2 * self.dither.amplitude * self.dither.largest_share
        return np.asarray(by_friction + by_dither, dtype=np.float64)

    def pressing(self, workcell: Workcell, contact: Contact, stiffness: float) -> StateSpace:
        """Response from [dx_bar, its rate] to the contact force for this K_E [N/m], per tick, without friction.

        Links, rotors, servo loops and contact are one linear system between ticks: the contact deflects the servos.
        The rate is not used, as a force law commands positions. Joint springs are in series with the contact.
        """
        n, mass = workcell.num_joints, _mass_matrix(workcell)
        gains, inertia = _gains(workcell, self.servo), np.diag(np.diag(mass))
        series = 1 + contact.robot_compliance * stiffness
        damping = getattr(contact.environment, "damping", 0.0)
        force = -np.concatenate([stiffness * contact.row, damping * contact.row, np.zeros(n)]) / series
        speed, holding = gains.velocity * inertia, gains.velocity * gains.position * inertia
        eye, zero = np.eye(n), np.zeros((n, n))
        # [q, q', integral of the torque]
        servo = np.hstack([-holding, -speed, eye]) + np.outer(contact.row, force)
        a = np.vstack(
            [
                np.hstack([zero, eye, zero]),
                np.linalg.solve(mass, servo),
                -gains.integral * np.hstack([holding, zero, zero]),
            ]
        )
        command_torque = holding @ contact.direction
        b = np.concatenate(
            [np.zeros(n), np.linalg.solve(mass, command_torque), gains.integral * command_torque]
        ).reshape(-1, 1)
        # A command takes effect one step after its tick.
        step = workcell.config.time_step
        _, old = zero_order_hold(a, b, step)
        later, new = zero_order_hold(a, b, workcell.period - step)
        whole, _ = zero_order_hold(a, b, workcell.period)
        state = np.block([[whole, later @ old], [np.zeros((1, 3 * n + 1))]])
        command = np.hstack([np.vstack([new, [[1.0]]]), np.zeros((3 * n + 1, 1))])
        shown = np.append(force, 0.0).reshape(1, -1)
        return state_space(state, command, shown, np.zeros((1, 2)), workcell.period)

    def add_to(self, builder: DiagramBuilder, site: Site) -> JointInterface:
        """Add the block `drive`.

        Raises:
            BadInputError: a fidelity without dynamics, a step too long for the servo loops, or elastic joints whose
                friction does not stick.
        """
        config = site.workcell.config
        if not site.workcell.has_dynamics:
            raise BadInputError(
                " = !JointInterface: must have a fidelity with dynamics, such as Multibody", key="drive"
            )
        if config.time_step > LARGEST_STEP:
            raise invalid("time_step", config.time_step, f"at most {LARGEST_STEP:g} s, for the servo loops")
        if config.elastic_joints and not self.friction.sticks:
            raise invalid("drive.friction.sticks", False, "true with elastic joints, whose motors stick exactly")
        return builder.AddNamedSystem("drive", JointInterface(site.workcell, self))


class JointInterface(PythonDiagram):
    """Servo loops of all joints and, with elastic joints, their rotors.

    ```
    name: JointInterface
    input_ports: [joint_position_command, joint_velocity_command, joint_torque_feedforward, link_position (optional),
    link_velocity (optional), spring_torque (optional)]
    output_ports: [joint_torque (optional), motor_state (optional), motor_position (optional),
    motor_velocity (optional), torque_integral, dithered_position (optional), dithered_velocity (optional)]
    ```

    joint_position_command, joint_velocity_command, joint_torque_feedforward: shape (n,) [rad, rad/s, Nm], see
    `ReferenceHold`; the last two may be left unconnected.
    link_position, link_velocity: shape (n,) [rad, rad/s]; of rigid joints.
    spring_torque: shape (n,), of the springs on the links [Nm]; of elastic joints.
    torque_integral: shape (n,), integral of the motor torque over time [Nms]. State.
    joint_torque: shape (n,), motor torque on the links of rigid joints [Nm]. Feedthrough of link_position and
    link_velocity.
    motor_state: shape (2n,), position and speed of the motors of elastic joints [rad, rad/s]. State.
    motor_position, motor_velocity: shape (n,), its halves [rad, rad/s]. State.
    dithered_position, dithered_velocity: shape (n,), the commands that the servo loops get with a dither, see
    `JointDither` [rad, rad/s].

    Sampling: every `period` [s] of the workcell the commands, which act on the motors one step later; every
    `time_step` [s] of the workcell the rest.

    Args:
        workcell: the workcell.
        config: of the drives.
    """

    optional_inputs = COMMANDS[1:]

    def __init__(self, workcell: Workcell, config: JointInterfaceConfig):
        super().__init__()
        builder = DiagramBuilder()
        servo = builder.AddNamedSystem("servo", _servo(workcell, config))
        taken = {name: servo.GetInputPort(name) for name in COMMANDS}
        if config.dither.amplitude > 0:
            dither = builder.AddNamedSystem("dither", _dither(workcell, config.dither))
            for name, dithered in zip(COMMANDS[:2], DITHERED, strict=True):
                builder.Connect(dither.GetOutputPort(dithered), servo.GetInputPort(name))
                taken[name] = dither.GetInputPort(name)
            export_outputs(builder, {name: dither.GetOutputPort(name) for name in DITHERED})
        for name, port in taken.items():
            builder.ExportInput(port, name)
        if workcell.config.elastic_joints:
            motors = builder.AddNamedSystem(
                "motors",
                MotorMotion(
                    workcell.rotor_inertia,
                    config.true_friction(workcell.robot),
                    time_step=workcell.config.time_step,
                    start=workcell.motor_start,
                ),
            )
            builder.Connect(servo.GetOutputPort("motor_torque"), motors.GetInputPort("motor_torque"))
            builder.Connect(motors.GetOutputPort("motor_position"), servo.GetInputPort("position"))
            builder.Connect(motors.GetOutputPort("motor_velocity"), servo.GetInputPort("velocity"))
            builder.ExportInput(motors.GetInputPort("spring_torque"), "spring_torque")
            export_outputs(builder, {name: motors.GetOutputPort(name) for name in MOTOR_PORTS})
        else:
            builder.ExportInput(servo.GetInputPort("position"), "link_position")
            builder.ExportInput(servo.GetInputPort("velocity"), "link_velocity")
            builder.ExportOutput(servo.GetOutputPort("motor_torque"), "joint_torque")
        builder.ExportOutput(servo.GetOutputPort("torque_integral"), "torque_integral")
        builder.BuildInto(self)


def _gains(workcell: Workcell, own: JointServoConfig) -> ServoGains:
    filter_ = workcell.robot.parameters.reference_filter
    bandwidth = filter_.natural_frequency if own.bandwidth is None else own.bandwidth
    damping_ratio = filter_.damping_ratio if own.damping_ratio is None else own.damping_ratio
    return servo_gains(bandwidth, damping_ratio, own.integral_gain)


def _mass_matrix(workcell: Workcell) -> Array:
    """Of links and rotors at the start, shape (n, n) [kg m2]; the servos are tuned for its diagonal."""
    return workcell.robot.mass_matrix(workcell.start_context()) + np.diag(workcell.rotor_inertia)


def _servo(workcell: Workcell, config: JointInterfaceConfig) -> JointServo:
    own = config.servo
    limit = workcell.robot.limits.torque if own.torque_limits else np.full(workcell.num_joints, np.inf)
    return JointServo(
        _gains(workcell, own),
        np.diag(_mass_matrix(workcell)),
        limit,
        period=workcell.period,
        time_step=workcell.config.time_step,
        start=workcell.motor_start,
        torque=config.resting_torque(workcell),
        substeps=max(1, round(own.rate * workcell.config.time_step)),
        compensation=own.friction_compensation * config.true_friction(workcell.robot).coulomb,
    )


def _dither(workcell: Workcell, config: JointDitherConfig) -> JointDither:
    with about(config):
        return JointDither(
            workcell.robot,
            workcell.motor_start,
            amplitude=config.amplitude,
            frequency=config.frequency,
            largest_share=config.largest_share,
            travel_share=config.travel_share,
            period=workcell.period,
        )

"""The motors of a robot with elastic joints, shared by drives with position and with torque commands.

phi = S q_m are the motor angles divided by the gear ratios: S is the identity but for the couplings between motors, and
B = diag(J_m N^2) is the inertia of the rotors at the joints. Friction sticks in a step of dt with

    soft(s, c) = s - sat(s, -c, c),    v+ = soft(s, dt c/B) / (1 + ...)

where s is the speed that the step would reach without friction. A sticking axis is exactly at rest: s and sat(s) are
then the same number. All are C++ blocks: beside a multibody plant a Python callback runs with cold caches and costs
three times as much, and these blocks run more often than any other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import MatrixGain, Saturation

from forcectl.arrays import Matrix, Vector
from forcectl.errors import invalid
from forcectl.framework.batch import batch_values
from forcectl.framework.wiring import export_outputs, split, through
from forcectl.robot.assumptions import assumed_loop_inertia
from forcectl.robot.model import RobotModel

# Output ports of a drive for the motion of its motors, joint side: (2n,) [rad, rad/s], then its halves.
MOTOR_PORTS = ("motor_state", "motor_position", "motor_velocity")


class Motors:
    """n motors at the joints: `inertia` B [kg m^2], friction `coulomb` c [Nm] and `viscous` b [Nms/rad], shape (n,).

    `to_joint` is the inverse of S.

    Raises:
        BadInputError: an S that cannot be inverted, or a value that is not allowed.
    """

    def __init__(self, inertia: ArrayLike, to_motor: Matrix, coulomb: ArrayLike, viscous: ArrayLike):
        n = self.size = len(to_motor)
        if to_motor.shape != (n, n) or not np.linalg.cond(to_motor) < 1e6:
            raise invalid("to_motor", to_motor.tolist(), "a square matrix that can be inverted")
        self.to_motor, self.to_joint = to_motor, np.linalg.inv(to_motor)
        self.inertia = batch_values("inertia", inertia, n, "positive and finite")
        self.coulomb = batch_values("coulomb_friction", coulomb, n, "not negative")
        self.viscous = batch_values("viscous_friction", viscous, n, "not negative")

    def at_rest(self, position: ArrayLike) -> Vector:
        """phi for the motors at these joint positions, shape (n,) [rad]."""
        return self.to_motor @ batch_values("initial_position", position, self.size)

    def add_friction(
        self, builder: DiagramBuilder, free: Matrix, stick: Vector, suffix: str = ""
    ) -> tuple[InputPort, OutputPort]:
        """Add blocks for soft(s, `stick`), s = `free` times their input; returns their input and output ports."""
        limit = np.concatenate([np.full(self.size, np.inf), stick])
        # s and -s; only the second half is limited, so that their sum is s - sat(s), exactly zero when sticking.
        speed = builder.AddNamedSystem(f"free_speed{suffix}", MatrixGain(np.vstack([free, -free])))
        friction = through(builder, f"friction{suffix}", Saturation(-limit, limit), speed.get_output_port())
        slip = through(builder, f"slip{suffix}", MatrixGain(np.tile(np.eye(self.size), 2)), friction)
        return speed.get_input_port(), slip

    def export_motion(self, builder: DiagramBuilder, axes: System) -> None:
        """Export the motion of `axes`, whose state is phi, phi' and n further entries."""
        gain = MatrixGain(np.kron(np.eye(2, 3), self.to_joint))
        export_motion(builder, through(builder, "motor_state", gain, axes.get_output_port()))


def export_motion(builder: DiagramBuilder, state: OutputPort) -> tuple[OutputPort, OutputPort]:
    """Export the motion of motors as `MOTOR_PORTS`; `state` is of shape (2n,). Returns its halves."""
    n = state.size() // 2
    position, velocity = split(builder, "position_and_velocity", [n, n], state)
    export_outputs(builder, dict(zip(MOTOR_PORTS, (state, position, velocity), strict=True)))
    return position, velocity


def joint_to_motor(robot: RobotModel) -> Matrix:
    """S: motor angles over gear ratios per joint angles, shape (n, n) [1]."""
    return robot.motor_from_joint / robot.parameters.gear_ratio[:, None]


def loop_inertia(robot: RobotModel) -> Vector:
    """Inertia that each joint's velocity loop is tuned for, shape (n,) [kg m^2]; empty: that of the rotors alone."""
    parameters = robot.parameters
    if "velocity_loop_inertia" not in parameters.assumed:
        return parameters.velocity_loop_inertia
    context = robot.create_context()
    robot.set_positions(context, parameters.default_posture)
    return assumed_loop_inertia(parameters, np.diag(robot.mass_matrix(context)))

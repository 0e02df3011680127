"""The drives of a robot with elastic joints: motor inertia, cascaded servo, friction, spring torque.

    B phi'' = B w_v [(v_r - phi') + w_i int(v_r - phi')] - S^-T tau_spring - b phi' - c sign(phi'),   v_r = K_v (r - phi) + r'

phi = S q_m are the motor angles divided by the gear ratios: S is the identity but for the couplings between motors, and
B = diag(J_m N^2) is the inertia of the rotors at the joints. The step of `forcectl.plant.servo`, written as a linear
system and a saturation, because soft(s, c) = s - sat(s, -c, c):

    s  = linear in phi, phi', the integral, r, r', tau_spring
    v+ = (s - sat(s, -dt c/B, dt c/B)) / (1 + dt (w_v (1 + w_i dt) + b/B))

Both are C++ blocks: beside a multibody plant a Python callback runs with cold caches and costs three times as much, and
this one runs more often than any other. The friction sticks as exactly as in Python.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LinearSystem, MatrixGain, Multiplexer, Saturation

from forcectl.lanes import check, lane_values
from forcectl.plant.servo import ServoGains, servo_gains
from forcectl.robot import RobotModel

Matrix = NDArray[np.float64]


def free_speed_rows(gains: ServoGains, to_motor: Matrix, push: Matrix) -> Matrix:
    """s as a matrix on [phi, phi', integral, r, r', tau_spring], shape (n, 6n).

    Args:
        gains: coefficients of an inner step, arrays of shape (n,). to_motor: S. push: speed per spring torque, (n, n).
    """
    n = len(to_motor)
    p, dt = gains.velocity * gains.position, gains.step
    eye, column = np.eye(n), p[:, None]
    reference_rate = (gains.velocity + p * dt)[:, None] * to_motor
    return np.hstack([-column * eye, eye, np.diag(gains.integral), column * to_motor, reference_rate, push])


def state_update(gains: ServoGains, to_motor: Matrix, speed: Matrix) -> tuple[Matrix, Matrix]:
    """Sampled A, B of [phi, phi', integral] with the input [r, r', tau_spring, sat(s)].

    Args:
        gains, to_motor: see `free_speed_rows`. speed: the matrix of s.
    """
    n = len(to_motor)
    eye, zero, dt = np.eye(n), np.zeros((n, n)), gains.step
    inverse = gains.inverse[:, None]
    after = np.hstack([inverse * speed, -inverse * eye])  # v+ on [state, r, r', tau, sat]
    k = gains.position[:, None]
    wanted = np.hstack([-k * eye, zero, zero, k * to_motor, (1 + k * dt) * to_motor, zero, zero])
    x = np.hstack([eye, np.zeros((n, 6 * n))]) + dt * after
    i = np.hstack([zero, zero, eye, np.zeros((n, 4 * n))]) + dt * (wanted - after)
    whole = np.vstack([x, after, i])
    return whole[:, : 3 * n], whole[:, 3 * n :]


class Drive(Diagram):
    """Servo loops, motor inertia and sticking friction of n axes.

    ```
    name: Drive
    input_ports: [reference, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity]
    ```

    reference: shape (2n,), joint reference and its rate [rad, rad/s]; moves on with its rate over a step.
    spring_torque: shape (n,), torque of the joint springs on the links [Nm]; the motors feel the opposite.
    motor_state: shape (2n,), q_m and its rate [rad, rad/s]: the desired state of the joint springs.
    motor_position, motor_velocity: its halves. All are state, no direct feedthrough.

    Sampling: `period` [s], one step of the servo each.

    Args:
        inertia: B, shape (n,) [kg m^2]. to_motor: S, shape (n, n).
        position_gain, velocity_gain, integral_gain: K_v, w_v, w_i [1/s], > 0.
        coulomb_friction: c, shape (n,) [Nm]. viscous_friction: b, shape (n,) [Nms/rad].
        initial_position: q_m at rest, shape (n,) [rad]. initial_torque: of the springs there, shape (n,) [Nm].
    """

    def __init__(
        self,
        inertia: ArrayLike,
        to_motor: Matrix,
        *,
        period: float,
        position_gain: float,
        velocity_gain: float,
        integral_gain: float,
        coulomb_friction: ArrayLike,
        viscous_friction: ArrayLike,
        initial_position: Matrix,
        initial_torque: Matrix,
    ):
        super().__init__()
        n = len(to_motor)
        B = lane_values("inertia", inertia, n, "positive")
        coulomb = lane_values("coulomb_friction", coulomb_friction, n, "not negative")
        viscous = lane_values("viscous_friction", viscous_friction, n, "not negative")
        for name, gain in (("position", position_gain), ("velocity", velocity_gain), ("integral", integral_gain)):
            check(f"{name}_gain", gain, "positive")
        dt = check("period", period, "positive")
        k_v, w_v, w_i = (np.full(n, gain) for gain in (position_gain, velocity_gain, integral_gain))
        gains = servo_gains(k_v, w_v, w_i, coulomb / B, viscous / B, dt)
        back = np.linalg.inv(to_motor)
        speed = free_speed_rows(gains, to_motor, -(dt / B)[:, None] * back.T)
        a, b = state_update(gains, to_motor, speed)
        axes = LinearSystem(a, b, np.eye(3 * n), np.zeros((3 * n, 4 * n)), dt)
        # At rest the integral of the servo carries the springs' torque.
        integral = back.T @ initial_torque / (B * velocity_gain * integral_gain)
        axes.configure_default_state(np.concatenate([to_motor @ initial_position, np.zeros(n), integral]))

        self.port_units = {"reference": "rad,rad/s"}
        builder = DiagramBuilder()
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        add("axes", axes)
        known = add("state_and_inputs", Multiplexer([3 * n, 2 * n, n]))
        free = add("free_speed", MatrixGain(speed))
        friction = add("friction", Saturation(-gains.stick, gains.stick))
        inputs = add("axes_inputs", Multiplexer([2 * n, n, n]))
        connect(axes.get_output_port(), known.get_input_port(0))
        connect(known.get_output_port(), free.get_input_port())
        connect(free.get_output_port(), friction.get_input_port())
        connect(friction.get_output_port(), inputs.get_input_port(2))
        connect(inputs.get_output_port(), axes.get_input_port())
        for i, name in enumerate(("reference", "spring_torque")):
            outside = export(known.get_input_port(1 + i), name)
            builder.ConnectInput(outside, inputs.get_input_port(i))
        zero = np.zeros((n, n))
        for name, rows in (
            ("motor_state", [[back, zero, zero], [zero, back, zero]]),
            ("motor_position", [[back, zero, zero]]),
            ("motor_velocity", [[zero, back, zero]]),
        ):
            block = add(name, MatrixGain(np.block(rows)))
            connect(axes.get_output_port(), block.get_input_port())
            builder.ExportOutput(block.get_output_port(), name)
        builder.BuildInto(self)


def joint_to_motor(robot: RobotModel) -> Matrix:
    """S: motor angles over gear ratios per joint angles, shape (n, n) [1]."""
    matrix: Matrix = robot.motor_from_joint / robot.facts.gear_ratio[:, None]
    return matrix

"""The drives of a robot with elastic joints: motor inertia, cascaded servo, friction, spring torque.

    B phi'' = B w_v [(v_r - phi') + w_i int(v_r - phi')] - S^-T tau_spring - b phi' - c sign(phi')
    v_r     = K_v (r - phi) + r'

phi = S q_m are the motor angles divided by the gear ratios: S is the identity but for the couplings between motors, and
B = diag(J_m N^2) is the inertia of the rotors at the joints. A velocity loop tuned for an inertia J has w_v in
proportion to J/B, so each axis has its own. At first friction holds an axis back by c/(B w_v K_v) [rad]: with
J = B one that moves heavy links sticks while the others move (docs/hunting.md).

The step of `forcectl.plant.drives.servo`, written as a linear system and a saturation, because
soft(s, c) = s - sat(s, -c, c):

    s  = linear in phi, phi', the integral, r, r', tau_spring
    v+ = (s - sat(s, -dt c/B, dt c/B)) / (1 + dt (w_v (1 + w_i dt) + b/B))

Both are C++ blocks: beside a multibody plant a Python callback runs with cold caches and costs three times as much, and
this one runs more often than any other. A sticking axis stands still exactly: s and sat(s) are then the same number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import Demultiplexer, LinearSystem, MatrixGain, Multiplexer, Saturation

from forcectl.errors import invalid
from forcectl.framework.batch import check, check_count, lane_values
from forcectl.plant.drives.servo import ServoCoefficients, servo_gains
from forcectl.robot.model import RobotModel

Matrix = NDArray[np.float64]


class InnerStep(NamedTuple):
    """One inner step as matrices, with x = [phi, phi', integral] and u = [r, r', tau_spring]."""

    free_x: Matrix  # s = free_x x + free_u u, shapes (n, 3n)
    free_u: Matrix
    state: Matrix  # x+ = state x + inputs u + slip (s - sat(s)), shapes (3n, 3n), (3n, 3n), (3n, n)
    inputs: Matrix
    slip: Matrix


def inner_step(gains: ServoCoefficients, to_motor: Matrix, push: Matrix) -> InnerStep:
    """The matrices of an inner step, with the reference at its start.

    Args:
        gains: coefficients, arrays of shape (n,). to_motor: S. push: speed per spring torque, shape (n, n).
    """
    n = len(to_motor)
    eye, zero, dt = np.eye(n), np.zeros((n, n)), gains.step
    k, w = gains.position[:, None], gains.velocity[:, None]
    wanted_x, wanted_u = np.hstack([-k * eye, zero, zero]), np.hstack([k * to_motor, to_motor, zero])
    rest = np.zeros((n, 3 * n))
    speed = gains.inverse[:, None] * eye
    return InnerStep(
        free_x=w * wanted_x + np.hstack([zero, eye, np.diag(gains.integral)]),
        free_u=w * wanted_u + np.hstack([zero, zero, push]),
        state=np.vstack([np.hstack([eye, zero, zero]), rest, np.hstack([zero, zero, eye]) + dt * wanted_x]),
        inputs=np.vstack([rest, rest, dt * wanted_u]),
        slip=np.vstack([dt * speed, speed, -dt * speed]),
    )


def unrolled_steps(step: InnerStep, dt: float, count: int) -> tuple[list[Matrix], Matrix]:
    """`count` inner steps in a row, the reference moving on with its rate.

    Returns:
        for each step the matrix of its s on [x, u, s - sat(s) of the steps before], and the matrix of the last x on
        [x, u, all s - sat(s)]; x and u are those at the start.
    """
    n = step.slip.shape[1]
    x = np.hstack([np.eye(3 * n), np.zeros((3 * n, 3 * n))])
    frees = []
    for i in range(count):
        moved = np.eye(3 * n)
        moved[:n, n : 2 * n] = i * dt * np.eye(n)
        u = np.hstack([np.zeros((3 * n, 3 * n)), moved, np.zeros((3 * n, i * n))])
        frees.append(step.free_x @ x + step.free_u @ u)
        x = np.hstack([step.state @ x + step.inputs @ u, step.slip])
    return frees, x


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
    motor_position, motor_velocity: its halves [rad, rad/s]. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s], divided into `substeps` inner steps; the spring torque is held over the period.

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
        substeps: int,
        position_gain: float,
        velocity_gain: ArrayLike,
        integral_gain: float,
        coulomb_friction: ArrayLike,
        viscous_friction: ArrayLike,
        initial_position: Matrix,
        initial_torque: Matrix,
    ):
        super().__init__()
        n = len(to_motor)
        if to_motor.shape != (n, n) or not np.linalg.cond(to_motor) < 1e6:
            raise invalid("to_motor", to_motor.tolist(), "a square matrix that can be inverted")
        start = lane_values("initial_position", initial_position, n)
        torque = lane_values("initial_torque", initial_torque, n)
        B = lane_values("inertia", inertia, n, "positive and finite")
        coulomb = lane_values("coulomb_friction", coulomb_friction, n, "not negative")
        viscous = lane_values("viscous_friction", viscous_friction, n, "not negative")
        w_v = lane_values("velocity_gain", velocity_gain, n, "positive and finite")
        for name, gain in (("position", position_gain), ("integral", integral_gain)):
            check(f"{name}_gain", gain, "positive")
        dt = check("period", period, "positive") / check_count("substeps", substeps)
        k_v, w_i = np.full(n, position_gain), np.full(n, integral_gain)
        gains = servo_gains(k_v, w_v, w_i, coulomb / B, viscous / B, dt)
        back = np.linalg.inv(to_motor)
        step = inner_step(gains, to_motor, -(dt / B)[:, None] * back.T)
        frees, after = unrolled_steps(step, dt, substeps)
        inputs = (3 + substeps) * n
        axes = LinearSystem(after[:, : 3 * n], after[:, 3 * n :], np.eye(3 * n), np.zeros((3 * n, inputs)), period)
        # At rest the integral of the servo carries the springs' torque.
        integral = back.T @ torque / (B * w_v * integral_gain)
        axes.configure_default_state(np.concatenate([to_motor @ start, np.zeros(n), integral]))

        self.port_units = {"reference": "rad,rad/s"}
        builder = DiagramBuilder()
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        add("axes", axes)
        eye, unlimited = np.eye(n), np.full(n, np.inf)
        slips: list[OutputPort] = []
        readers: list[list[InputPort]] = [[], []]
        for i, free in enumerate(frees, start=1):
            known = add(f"known_{i}", Multiplexer([3 * n, 2 * n, n] + [n] * len(slips)))
            # s and -s; only the second half is limited, so that their sum is s - sat(s), exactly zero when sticking.
            speed = add(f"free_speed_{i}", MatrixGain(np.vstack([free, -free])))
            limit = np.concatenate([unlimited, gains.stick])
            friction = add(f"friction_{i}", Saturation(-limit, limit))
            slip = add(f"slip_{i}", MatrixGain(np.hstack([eye, eye])))
            connect(axes.get_output_port(), known.get_input_port(0))
            for j, earlier in enumerate(slips):
                connect(earlier, known.get_input_port(3 + j))
            connect(known.get_output_port(), speed.get_input_port())
            connect(speed.get_output_port(), friction.get_input_port())
            connect(friction.get_output_port(), slip.get_input_port())
            slips.append(slip.get_output_port())
            for reader, index in zip(readers, (1, 2), strict=True):
                reader.append(known.get_input_port(index))
        both = add("axes_inputs", Multiplexer([2 * n, n] + [n] * substeps))
        for j, port in enumerate(slips):
            connect(port, both.get_input_port(2 + j))
        connect(both.get_output_port(), axes.get_input_port())
        for reader, index, name in zip(readers, (0, 1), ("reference", "spring_torque"), strict=True):
            outside = export(both.get_input_port(index), name)
            for read in reader:
                builder.ConnectInput(outside, read)
        zero = np.zeros((n, n))
        state = add("motor_state", MatrixGain(np.block([[back, zero, zero], [zero, back, zero]])))
        halves = add("position_and_velocity", Demultiplexer([n, n]))
        connect(axes.get_output_port(), state.get_input_port())
        connect(state.get_output_port(), halves.get_input_port())
        builder.ExportOutput(state.get_output_port(), "motor_state")
        builder.ExportOutput(halves.get_output_port(0), "motor_position")
        builder.ExportOutput(halves.get_output_port(1), "motor_velocity")
        builder.BuildInto(self)


def joint_to_motor(robot: RobotModel) -> Matrix:
    """S: motor angles over gear ratios per joint angles, shape (n, n) [1]."""
    matrix: Matrix = robot.motor_from_joint / robot.facts.gear_ratio[:, None]
    return matrix

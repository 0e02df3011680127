"""The drives of a robot with elastic joints: motor inertia, cascaded servo, friction, spring torque::

    B phi'' = B w_v [(v_r - phi') + w_i int(v_r - phi')] - S^-T tau_spring - b phi' - c sign(phi')
    v_r     = K_v (r - phi) + r'

phi = S q_m and B as in `forcectl.plant.drives.motors`. A velocity loop tuned for an inertia J has w_v in
proportion to J/B, so each axis has its own. Until the integral has acted, friction holds an axis back by
c/(B w_v K_v) [rad]: with J = B an axis that moves heavy links sticks while the others move (docs/hunting.md).

The step is that of `forcectl.plant.drives.servo`, written as a linear system and a saturation::

    s  = linear in phi, phi', the integral, r, r', tau_spring
    v+ = soft(s, dt c/B) / (1 + dt (w_v (1 + w_i dt) + b/B))
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import LinearSystem, Multiplexer

from forcectl.arrays import Matrix
from forcectl.framework.batch import batch_values, check, check_count
from forcectl.framework.block import PythonDiagram
from forcectl.plant.drives.motors import Motors
from forcectl.plant.drives.servo import ServoCoefficients, ServoGains, step_coefficients


class _InnerStep(NamedTuple):
    """One inner step as matrices, with x = [phi, phi', integral] and u = [r, r', tau_spring]."""

    free_x: Matrix  # s = free_x x + free_u u, shapes (n, 3n)
    free_u: Matrix
    state: Matrix  # x+ = state x + inputs u + slip (s - sat(s)), shapes (3n, 3n), (3n, 3n), (3n, n)
    inputs: Matrix
    slip: Matrix


def _inner_step(gains: ServoCoefficients, to_motor: Matrix, push: Matrix) -> _InnerStep:
    """The matrices of one step, for the reference at its start; `push` is the speed per spring torque, (n, n)."""
    n = len(to_motor)
    eye, zero, dt = np.eye(n), np.zeros((n, n)), gains.step
    k, w = gains.position[:, None], gains.velocity[:, None]
    wanted_x, wanted_u = np.hstack([-k * eye, zero, zero]), np.hstack([k * to_motor, to_motor, zero])
    rest = np.zeros((n, 3 * n))
    speed = gains.inverse[:, None] * eye
    return _InnerStep(
        free_x=w * wanted_x + np.hstack([zero, eye, np.diag(gains.integral)]),
        free_u=w * wanted_u + np.hstack([zero, zero, push]),
        state=np.vstack([np.hstack([eye, zero, zero]), rest, np.hstack([zero, zero, eye]) + dt * wanted_x]),
        inputs=np.vstack([rest, rest, dt * wanted_u]),
        slip=np.vstack([dt * speed, speed, -dt * speed]),
    )


def _unrolled(step: _InnerStep, dt: float, count: int) -> tuple[list[Matrix], Matrix]:
    """`count` inner steps as matrices on [x, u, s - sat(s) of earlier steps]; the reference advances with its rate.

    Returns the matrix of s for each step, and that of x after the last step; x and u are those at the start.
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


class Drive(PythonDiagram):
    """Servo loops, motor inertia and sticking friction of n axes.

    ```
    name: Drive
    input_ports: [reference, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity]
    ```

    reference: shape (2n,), joint reference and its rate [rad, rad/s]; extrapolated with its rate within a period.
    spring_torque: shape (n,), torque of the joint springs on the links [Nm]; on the motors it acts with minus sign.
    motor_state: shape (2n,), q_m and its rate [rad, rad/s]: the desired state of the joint springs.
    motor_position, motor_velocity: its halves [rad, rad/s]. All outputs are state, no direct feedthrough.

    Sampling: every `period` [s], divided into `substeps` inner steps; the spring torque is held over the period.

    Args:
        inertia: B, shape (n,) [kg m^2].
        to_motor: S, shape (n, n).
        gains: K_v, w_v, w_i, > 0.
        coulomb_friction: c, shape (n,) [Nm].
        viscous_friction: b, shape (n,) [Nms/rad].
        initial_position: q_m at rest, shape (n,) [rad].
        initial_torque: spring torque at rest, shape (n,) [Nm].
    """

    def __init__(
        self,
        inertia: ArrayLike,
        to_motor: Matrix,
        gains: ServoGains,
        *,
        period: float,
        substeps: int,
        coulomb_friction: ArrayLike,
        viscous_friction: ArrayLike,
        initial_position: Matrix,
        initial_torque: Matrix,
    ):
        super().__init__()
        motors = Motors(inertia, to_motor, coulomb_friction, viscous_friction)
        n, B, back = motors.size, motors.inertia, motors.to_joint
        torque = batch_values("initial_torque", initial_torque, n)
        checked = [batch_values(f"{k}_gain", v, n, "positive and finite") for k, v in gains._asdict().items()]
        dt = check("period", period, "positive") / check_count("substeps", substeps)
        one = step_coefficients(ServoGains(*checked), motors.coulomb / B, motors.viscous / B, dt)
        step = _inner_step(one, to_motor, -(dt / B)[:, None] * back.T)
        frees, after = _unrolled(step, dt, substeps)
        inputs = (3 + substeps) * n
        axes = LinearSystem(after[:, : 3 * n], after[:, 3 * n :], np.eye(3 * n), np.zeros((3 * n, inputs)), period)
        # At rest the integral of the servo carries the springs' torque.
        _, w_v, w_i = checked
        integral = back.T @ torque / (B * w_v * w_i)
        axes.configure_default_state(np.concatenate([motors.at_rest(initial_position), np.zeros(n), integral]))

        self.port_units = {"reference": "rad,rad/s"}
        builder = DiagramBuilder()
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        add("axes", axes)
        slips: list[OutputPort] = []
        readers: list[list[InputPort]] = [[], []]
        for i, free in enumerate(frees, start=1):
            known = add(f"known_{i}", Multiplexer([3 * n, 2 * n, n] + [n] * len(slips)))
            speed, slip = motors.add_friction(builder, free, one.stick, f"_{i}")
            connect(axes.get_output_port(), known.get_input_port(0))
            for j, earlier in enumerate(slips):
                connect(earlier, known.get_input_port(3 + j))
            connect(known.get_output_port(), speed)
            slips.append(slip)
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
        motors.export_motion(builder, axes)
        builder.BuildInto(self)

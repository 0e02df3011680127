"""The drives of a robot with elastic joints and torque sensors, commanded with torques instead of positions::

    B phi'' = tau_m - S^-T tau_spring - tau_F,    tau_F = b phi' + c sign(phi')
    tau_m   = sat(S^-T (tau_bar + k (tau_bar - tau_spring)) + tau_F_hat)
    tau_F_hat' = w_F (tau_m - S^-T tau_spring - B phi'' - tau_F_hat)

tau_bar is the torque command, tau_spring the torque measured by the sensors in the joints, k the gain of the torque
loop, and w_F the bandwidth of the observer that estimates the friction from the motor's own motion. Below the limits of
the motors this is a drive with 1/(1 + k) of the inertia and of the friction that the observer has not yet compensated:

    B/(1 + k) phi'' = S^-T (tau_bar - tau_spring) - (tau_F - tau_F_hat)/(1 + k)

The torque on a stuck drive grows by w_F (1 + k) times the torque error per second until it moves: at rest the springs
have the commanded torque. phi, S and B as in `forcectl.plant.drives.motors`. The torques are held over a step, which
is implicit in the friction:

    v+ = soft(v + dt/B (tau_m - S^-T tau_spring), dt c/B) / (1 + dt b/B),    phi+ = phi + dt v+

so sticking is exact. Sensors of torque and speed are assumed to be exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem, MatrixGain, Multiplexer, Saturation

from forcectl.arrays import Matrix
from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import PythonDiagram
from forcectl.plant.drives.motors import Motors


class TorqueDrive(PythonDiagram):
    """Torque loop, motor inertia and static friction of n axes.

    ```
    name: TorqueDrive
    input_ports: [torque_command, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity, motor_torque]
    ```

    torque_command: shape (n,), tau_bar at the joints [Nm].
    spring_torque: shape (n,), torque of the joint springs on the links [Nm]; on the motors it acts with minus sign.
    motor_state: shape (2n,), q_m and its rate [rad, rad/s]: the desired state of the joint springs. State.
    motor_position, motor_velocity: its halves [rad, rad/s]. State.
    motor_torque: shape (n,), tau_m of the motors, times their gear ratios [Nm]. Feedthrough of both inputs.

    Sampling: every `period` [s]; torques are held over it.

    Args:
        inertia: B, shape (n,) [kg m^2].
        to_motor: S, shape (n, n).
        torque_gain: k, >= 0.
        friction_bandwidth: w_F of the friction observer [rad/s], >= 0; 0 for none.
        torque_limit: of tau_m, shape (n,) [Nm], > 0; infinite for none.
        coulomb_friction: c, shape (n,) [Nm].
        viscous_friction: b, shape (n,) [Nms/rad].
        initial_position: q_m at rest, shape (n,) [rad].
    """

    def __init__(
        self,
        inertia: ArrayLike,
        to_motor: Matrix,
        *,
        period: float,
        torque_gain: float,
        friction_bandwidth: float,
        torque_limit: ArrayLike,
        coulomb_friction: ArrayLike,
        viscous_friction: ArrayLike,
        initial_position: ArrayLike,
    ):
        super().__init__()
        motors = Motors(inertia, to_motor, coulomb_friction, viscous_friction)
        n, B, back = motors.size, motors.inertia, motors.to_joint
        limit = batch_values("torque_limit", torque_limit, n, "positive")
        gain, dt = check("torque_gain", torque_gain, "not negative"), check("period", period, "positive")
        share = -np.expm1(-dt * check("friction_bandwidth", friction_bandwidth, "not negative"))
        eye, zero = np.eye(n), np.zeros((n, n))
        slowed = np.diag(1 / (1 + dt * motors.viscous / B))
        inert = share * np.diag(B / dt)
        # x = [phi, phi', tau_F_hat]; inputs: s - sat(s), tau_m and the springs' torque on the motors.
        axes = LinearSystem(
            np.block([[eye, zero, zero], [zero, zero, zero], [zero, inert, (1 - share) * eye]]),
            np.block([[dt * slowed, zero, zero], [slowed, zero, zero], [-inert @ slowed, share * eye, share * eye]]),
            np.eye(3 * n),
            np.zeros((3 * n, 3 * n)),
            period,
        )
        axes.configure_default_state(np.concatenate([motors.at_rest(initial_position), np.zeros(2 * n)]))

        self.port_units = {"torque_command": "Nm"}
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("axes", axes)
        load = add("springs_on_motors", MatrixGain(-back.T))
        torque_inputs = add("torque_inputs", Multiplexer([n, n, 3 * n]))
        loop = add("torque_loop", MatrixGain(np.hstack([(1 + gain) * back.T, gain * eye, zero, zero, eye])))
        torque = add("motors", Saturation(-limit, limit))
        known = add("known", Multiplexer([3 * n, n, n]))
        rate = np.diag(dt / B)
        free = np.hstack([zero, eye, zero, rate, rate])
        free_speed, slip = motors.add_friction(builder, free, dt * motors.coulomb / B)
        acting = add("acting", Multiplexer([n, n, n]))
        connect(known.get_output_port(), free_speed)
        connect(slip, acting.get_input_port(0))
        for source, block, index in (
            (load, torque_inputs, 1),
            (axes, torque_inputs, 2),
            (torque_inputs, loop, 0),
            (loop, torque, 0),
            (axes, known, 0),
            (torque, known, 1),
            (load, known, 2),
            (torque, acting, 1),
            (load, acting, 2),
            (acting, axes, 0),
        ):
            connect(source.get_output_port(), block.get_input_port(index))
        builder.ExportInput(torque_inputs.get_input_port(0), "torque_command")
        builder.ExportInput(load.get_input_port(), "spring_torque")
        motors.export_motion(builder, axes)
        builder.ExportOutput(torque.get_output_port(), "motor_torque")
        builder.BuildInto(self)

"""Motion of the motors of a robot with elastic joints: rotor inertia, static friction, torque of the joint springs.

    B v' = tau - tau_s - tau_F(v)

with the friction (5.2), whose Coulomb part sticks. One step is implicit in the friction::

    s  = v + dt (tau - tau_s - tau_O)/B                                  speed without Coulomb and viscous friction
    v+ = soft(s, dt tau_C/B)/(1 + dt D/B),   q+ = q + dt v+              D = D+ or D- by the sign of s
    soft(s, c) = sign(s) max(|s| - c, 0)

A motor under less than tau_C is exactly at rest. The spring torque is held over the step: stable while
dt sqrt(K_J/B) stays below 1, with the stiffness K_J of the springs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import AffineSystem, LinearSystem, MatrixGain, Multiplexer, Saturation

from forcectl.framework.batch import batch_values, check
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import through
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.drives.motors import export_motion


class MotorMotion(PythonDiagram):
    """Positions and velocities of n motors, joint side, from torques. C++ blocks.

    ```
    name: MotorMotion
    input_ports: [motor_torque, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity]
    ```

    motor_torque: shape (n,), of the motors [Nm]. spring_torque: shape (n,), of the joint springs on the links [Nm].
    motor_state: shape (2n,), position and speed: the desired state of the joint springs [rad, rad/s].
    motor_position: shape (n,) [rad]. motor_velocity: shape (n,) [rad/s]. All outputs are state, no direct feedthrough.

    Sampling: every `time_step` [s]; torques are held over it.

    Args:
        inertia: B of the rotors, shape (n,) [kg m2].
        friction: of the n joints.
        start: positions at rest (n,) [rad].
    """

    def __init__(self, inertia: ArrayLike, friction: JointFriction, *, time_step: float, start: ArrayLike):
        super().__init__()
        n, step = friction.size, check("time_step", time_step, "positive")
        rate = step / batch_values("inertia", inertia, n, "positive and finite")
        eye, zero = np.eye(n), np.zeros((n, n))
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        forward, backward = (
            np.diag(1 / (1 + rate * viscous)) for viscous in (friction.viscous_forward, friction.viscous_backward)
        )
        # q+ = q + dt v+, v+ = v+; the input is the part of s beyond the Coulomb friction, forward and backward.
        after, speed = np.block([[eye, zero], [zero, zero]]), np.hstack([forward, backward])
        state = LinearSystem(after, np.vstack([step * speed, speed]), np.eye(2 * n), np.zeros((2 * n, 2 * n)), step)
        state.configure_default_state(np.concatenate([batch_values("start", start, n), np.zeros(n)]))
        motion = add("motion", state)
        known = add("known", Multiplexer([n, n, n]))
        # s four times. The part beyond a limit is s - sat(s): exactly zero when sticking, as both are the same number.
        copies = np.tile(np.hstack([eye, np.diag(rate), -np.diag(rate)]), (4, 1))
        free = AffineSystem(D=copies, y0=np.tile(-rate * friction.offset, 4))
        free_speed = through(builder, "free_speed", free, known.get_output_port())
        stick, unlimited = rate * friction.coulomb, np.full(n, np.inf)
        lower = np.concatenate([-unlimited, -unlimited, -unlimited, -stick])
        limited = Saturation(lower, np.concatenate([unlimited, stick, unlimited, unlimited]))
        held = through(builder, "friction", limited, free_speed)
        difference = MatrixGain(np.kron(np.eye(2), np.hstack([eye, -eye])))
        connect(through(builder, "beyond_friction", difference, held), motion.get_input_port())
        _, speeds = export_motion(builder, motion.get_output_port())
        connect(speeds, known.get_input_port(0))
        builder.ExportInput(known.get_input_port(1), "motor_torque")
        builder.ExportInput(known.get_input_port(2), "spring_torque")
        builder.BuildInto(self)

"""Motion of the motors of a robot with elastic joints: rotor inertia, friction that sticks, torque of the springs.

    B v' = tau - tau_s - tau_F(v)

One step is semi-implicit, v+ = `sticking_speed(v + dt (tau - tau_s - tau_O)/B)`, q+ = q + dt v+: a motor below tau_C
stands still, exactly. The spring torque is held over the step: stable while dt sqrt(K_J/B) stays below 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, LinearSystem, Multiplexer

from forcectl.framework.batch import batch_values, check
from forcectl.plant.drives.joint_friction import JointFriction, StickingSpeed
from forcectl.plant.drives.motors import export_motion


class MotorMotion(Diagram):
    """Positions and speeds of n motors, joint side, of C++ blocks.

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
        self.port_units = {"motor_torque": "Nm", "spring_torque": "Nm", "motor_state": "rad,rad/s"}
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        # q+ = q + dt v+, v+ = v+.
        after, taken = np.block([[eye, zero], [zero, zero]]), np.vstack([step * eye, eye])
        state = LinearSystem(after, taken, np.eye(2 * n), np.zeros((2 * n, n)), step)
        state.configure_default_state(np.concatenate([batch_values("start", start, n), np.zeros(n)]))
        motion = add("motion", state)
        known = add("known", Multiplexer([n, n, n]))
        free = add(
            "free_speed",
            AffineSystem(D=np.hstack([eye, np.diag(rate), -np.diag(rate)]), y0=-rate * friction.offset),
        )
        speed = add("sticking_speed", StickingSpeed(friction, rate))
        _, speeds = export_motion(builder, motion.get_output_port())
        connect(speeds, known.get_input_port(0))
        connect(known.get_output_port(), free.get_input_port())
        connect(free.get_output_port(), speed.GetInputPort("free_speed"))
        connect(speed.GetOutputPort("speed"), motion.get_input_port())
        builder.ExportInput(known.get_input_port(1), "motor_torque")
        builder.ExportInput(known.get_input_port(2), "spring_torque")
        builder.BuildInto(self)

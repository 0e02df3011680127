"""The servo loops of a position-controlled robot at the rate of its plant, and the torque they command to the motors::

    tau = sat(u),   u = K_p (r - q) + K_d (v_r - v) + z + tau_ff,   z' = K_i (r - q) + w_b (tau - u)
    K_p = K_d K_v,  K_d = B w_v,  K_i = w_i K_p,  w_b^2 = K_v w_v

with B the inertia that a joint moves and the gains of `forcectl.plant.drives.servo`. Between two references r is
extrapolated with v_r, so that references at 250 Hz are no steps for a loop at 2 kHz. With v_r = 0 the motion lags by
1/K_v in steady motion; with v_r = r' it does not lag. The integral z compensates constant torques: gravity, friction,
loads. While a motor is saturated, w_b (tau - u) unwinds it.

The loops run m times in a step dt of the plant. The torque that acts in a step is the mean of theirs, with the motion
extrapolated by v + a h, a = (v - v_last)/dt, where h = (m - 1)/(2m) dt is the mean time of the m samples:

    u = K_p (r + v_r h - q - v h) + K_d (v_r - v - a h) + z + tau_ff

so that a plant at 1 kHz has loops of 2 kHz. All but `ReferenceHold` are C++ blocks: a Python callback at that rate
costs more than the plant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import (
    LinearSystem,
    MatrixGain,
    Multiplexer,
    Saturation,
)

from forcectl.framework.batch import batch_values, check, check_count, whole_multiple
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.framework.wiring import split, through
from forcectl.plant.drives.servo import ServoGains

_SLOW = 2e-3  # [rad/s] speed reference below which the friction compensation is smaller, without a step at rest


class ReferenceHold(PythonBlock):
    """References of n joints, sampled at ticks and extrapolated with their velocity between ticks.

        r + v_r (t - t_k) = o_k + I(t),   I = dt sum v_r,   o_k = r - I_k + dt (v_r - v_r,k-1)

    I is an integrator outside this block, at the rate of the plant, so that nothing is computed here between ticks.
    In the step in which a reference is sampled, I still integrates the velocity before it.

    ```
    name: ReferenceHold
    input_ports: [joint_position_command, joint_velocity_command, joint_torque_feedforward, travelled]
    output_ports: [reference]
    ```

    joint_position_command: shape (n,), r [rad]. joint_velocity_command: shape (n,), v_r [rad/s].
    joint_torque_feedforward: shape (n,) [Nm]. It and v_r are zero when they are not connected.
    travelled: shape (n,), I [rad].
    reference: shape (3n,), o, v_r and the feed-forward with the friction compensation [rad, rad/s, Nm]. State.

    The friction compensation is a torque in the direction of v_r, proportional to v_r below 2 mrad/s. A joint whose
    reference is not finite is held at its last one, with zero velocity and feed-forward.

    Sampling: every `period` [s]; what is sampled at a tick is in the output after it.

    Args:
        time_step: dt of the integrator [s].
        start: r before the first tick, shape (n,) [rad].
        compensation: torque of the friction compensation, shape (n,) [Nm], >= 0.
    """

    optional_inputs = ("joint_torque_feedforward", "joint_velocity_command")

    def __init__(self, size: int, *, period: float, time_step: float, start: ArrayLike, compensation: ArrayLike = 0.0):
        super().__init__()
        n = self._n = check_count("size", size)
        self._step = check("time_step", time_step, "positive")
        self._compensation = batch_values("compensation", compensation, n, "not negative")
        self.port_units = {"travelled": "rad", "reference": "rad,rad/s,Nm"}
        names = ("joint_position_command", "joint_velocity_command", "joint_torque_feedforward")
        self._inputs = [self.DeclareVectorInputPort(name, n) for name in names]
        self._travelled = self.DeclareVectorInputPort("travelled", n)
        state = self.DeclareDiscreteState(np.concatenate([batch_values("start", start, n), np.zeros(2 * n)]))
        self.DeclareStateOutputPort("reference", state)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._take
        )

    def _take(self, context: Context, next_state: DiscreteValues) -> None:
        n, held = self._n, context.get_discrete_state(0).value()
        travelled, last_rate = self._travelled.Eval(context), held[n : 2 * n]
        taken = np.concatenate([port.Eval(context) if port.HasValue(context) else np.zeros(n) for port in self._inputs])
        if not np.isfinite(taken).all():
            rows = taken.reshape(3, n)
            bad = ~np.isfinite(rows).all(axis=0)
            rows[0, bad] = (held[:n] + travelled)[bad]
            rows[1:, bad] = 0.0
        taken[2 * n :] += self._compensation * np.clip(taken[n : 2 * n] / _SLOW, -1.0, 1.0)
        taken[:n] += self._step * (taken[n : 2 * n] - last_rate) - travelled
        next_state.set_value(0, taken)


class JointServo(PythonDiagram):
    """Position servos of n joints.

    ```
    name: JointServo
    input_ports: [joint_position_command, joint_velocity_command, joint_torque_feedforward, position, velocity]
    output_ports: [motor_torque, torque_integral]
    ```

    joint_position_command, joint_velocity_command, joint_torque_feedforward: shape (n,), see `ReferenceHold`.
    position, velocity: shape (n,), of the motors [rad, rad/s].
    motor_torque: shape (n,), tau, joint side [Nm]. Feedthrough of position and velocity.
    torque_integral: shape (n,), integral of motor_torque over time [Nms]. State.

    Sampling: every `period` [s] the references, which act on the motors one step later; every `time_step` [s] the rest.

    Args:
        substeps: m, how often the loops run in a time step.
        gains: K_v, w_v, w_i.
        inertia: B, shape (n,) [kg m2].
        limit: of the motor torque, shape (n,), may be infinite [Nm].
        start: r before the first reference, shape (n,) [rad].
        torque: z at the start, shape (n,) [Nm].
        compensation: torque of the friction compensation, shape (n,) [Nm], >= 0.
    """

    optional_inputs = ReferenceHold.optional_inputs

    def __init__(
        self,
        gains: ServoGains,
        inertia: ArrayLike,
        limit: ArrayLike,
        *,
        period: float,
        time_step: float,
        start: ArrayLike,
        torque: ArrayLike = 0.0,
        substeps: int = 1,
        compensation: ArrayLike = 0.0,
    ):
        super().__init__()
        n = np.size(inertia)
        B = batch_values("inertia", inertia, n, "positive")
        count = check_count("substeps", substeps)
        bound = batch_values("limit", limit, n, "positive")
        step = check("time_step", time_step, "positive")
        whole_multiple("period", check("period", period, "positive"), step, "time_step")
        self.port_units = {"position": "rad", "velocity": "rad/s", "torque_integral": "Nms"}
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        eye, zero = np.eye(n), np.zeros((n, n))
        references = ReferenceHold(n, period=period, time_step=step, start=start, compensation=compensation)
        hold = add("references", references)
        kd = np.diag(B * gains.velocity)
        kp = kd * gains.position
        ki = kp * gains.integral
        unwinding = (
            np.sqrt(gains.position * gains.velocity) if gains.integral else 0.0
        )  # without integral gain z would unwind and not recover
        ahead = 0.5 * (count - 1) / count * step
        # Inputs at the start of a step: o, v_r, tau_ff, I, q, v, z, v_last.
        known = add("known", Multiplexer([3 * n, n, n, n, n, n]))
        damped, slowing = kd + ahead * kp, kd * (ahead / step)
        law = np.hstack([kp, damped, eye, kp, -kp, -damped - slowing, eye, slowing])
        wanted = through(builder, "wanted_torque", MatrixGain(law), known.get_output_port())
        motor = through(builder, "torque_limit", Saturation(-bound, bound), wanted)
        # z, the integrals of tau and v_r, and v_last.
        after = add("after", Multiplexer([8 * n, n, n]))
        error = np.hstack([ki, zero, zero, ki, -ki, zero, zero, zero, -unwinding * eye, unwinding * eye])
        mean = np.hstack([*[zero] * 9, eye])
        travel = np.hstack([zero, eye, *[zero] * 8])
        speed = np.hstack([*[zero] * 5, eye / step, *[zero] * 4])
        nothing = np.zeros((4 * n, 10 * n))
        kept = np.diag(np.repeat([1.0, 1.0, 1.0, 0.0], n))
        sums = LinearSystem(kept, step * np.vstack([error, mean, travel, speed]), np.eye(4 * n), nothing, step)
        sums.configure_default_state(np.concatenate([batch_values("torque", torque, n), np.zeros(3 * n)]))
        integrals = through(builder, "integrals", sums, after.get_output_port())
        integral, impulse, travelled, last = split(builder, "integrals_and_speed", [n] * 4, integrals)
        connect(hold.GetOutputPort("reference"), known.get_input_port(0))
        connect(travelled, known.get_input_port(1))
        connect(travelled, hold.GetInputPort("travelled"))
        connect(integral, known.get_input_port(4))
        connect(last, known.get_input_port(5))
        for i, port in enumerate((known.get_output_port(), wanted, motor)):
            connect(port, after.get_input_port(i))
        for i in range(3):
            builder.ExportInput(hold.get_input_port(i), hold.get_input_port(i).get_name())
        builder.ExportInput(known.get_input_port(2), "position")
        builder.ExportInput(known.get_input_port(3), "velocity")
        builder.ExportOutput(motor, "motor_torque")
        builder.ExportOutput(impulse, "torque_integral")
        builder.BuildInto(self)

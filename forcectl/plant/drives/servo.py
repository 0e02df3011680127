"""Servo loops of a drive, PI control of the speed under P control of the position, and axes with static friction::

    a = w_v (v_r - v) + z,    v_r = K_v (r - x) + r',    z' = w_v w_i [K_v (r - x) + c (r' - v)]

In the cascade, here and in `forcectl.plant.drives.drive`, the integral is over all of v_r - v, c = 1. In the servo with
torque output, `forcectl.plant.drives.joint_servo`, it is over the position error only, c = 0. With K_v = w/(2 zeta) and
w_v = 2 zeta w, x follows w^2/(s^2 + 2 zeta w s + w^2) times the reference, if its speed is not fed forward.

An axis of the cascade has a load and static friction (the calibrated plant of the design's targets, section 2)::

    v' = a + a_load - b v - a_c sign(v),    v = 0 while |a + a_load| <= a_c

One inner step is implicit in v. With s, the velocity that the step would reach without friction::

    v+ = soft(s, dt a_c) / (1 + dt (w_v (1 + w_i dt) + b)),     soft(s, c) = sign(s) max(|s| - c, 0)

so sticking is exact (v+ = 0, no creep) and the velocity loop is stable at any step size. Position and reference are
both those at the start of the step: one of them at its end would shift the motion by a whole step. a_c is the Coulomb
friction, and equals the static friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues

from forcectl.arrays import Vector
from forcectl.framework.batch import (
    BatchBlock,
    BatchParameter,
    BatchValue,
    batch_values,
    check,
    check_count,
)
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.framework.wiring import split

if TYPE_CHECKING:
    from scipy.signal import StateSpace


class ServoGains(NamedTuple):
    """Gains of servo loops, each a number or one per axis [1/s]."""

    position: BatchValue  # K_v
    velocity: BatchValue  # w_v
    integral: BatchValue  # w_i


def servo_gains(bandwidth: float, damping_ratio: float, integral_gain: float) -> ServoGains:
    """Gains whose position loop is w^2/(s^2 + 2 zeta w s + w^2).

    Args:
        bandwidth: w [rad/s].
        damping_ratio: zeta [1].
        integral_gain: w_i [1/s].
    """
    return ServoGains(bandwidth / (2 * damping_ratio), 2 * damping_ratio * bandwidth, integral_gain)


class ServoCoefficients(NamedTuple):
    """Coefficients of one inner step of length dt."""

    position: BatchValue  # K_v [1/s]
    velocity: BatchValue  # w_v (1 + w_i dt) dt [-]
    integral: BatchValue  # w_v w_i dt [1/s]
    stick: BatchValue  # a_c dt [m/s or rad/s]
    inverse: BatchValue  # 1/(1 + dt (w_v (1 + w_i dt) + b)) [-]
    step: float  # dt [s]


def step_coefficients(gains: ServoGains, coulomb: BatchValue, viscous: BatchValue, step: float) -> ServoCoefficients:
    """Coefficients of one inner step.

    Args:
        gains: K_v, w_v, w_i.
        coulomb: a_c [m/s^2 or rad/s^2].
        viscous: b [1/s].
        step: dt [s].
    """
    position, velocity, integral = gains
    damping = velocity * (1 + integral * step)
    inverse = 1 / (1 + step * (damping + viscous))
    return ServoCoefficients(position, damping * step, velocity * integral * step, coulomb * step, inverse, step)


def servo_steps(
    x: BatchValue,
    v: BatchValue,
    i: BatchValue,
    r: BatchValue,
    rate: BatchValue,
    push: BatchValue,
    gains: ServoCoefficients,
    count: int,
    m: Any = np,
) -> tuple[BatchValue, BatchValue, BatchValue]:
    """`count` inner steps of the servo.

    Args:
        x, v, i: position, velocity, integral of the velocity error [rad, rad/s, rad] or [m, m/s, m].
        r, rate: reference and its rate at the start [rad, rad/s] or [m, m/s]; it is extrapolated with its rate.
        push: velocity that the load adds per inner step, a_load dt [rad/s] or [m/s].
        gains: coefficients of an inner step.
        m: numpy, or scalar functions of the same names.

    Returns:
        x, v, i after the steps.
    """
    position, velocity, integral, stick, inverse, step = gains
    maximum, copysign = m.maximum, m.copysign
    for _ in range(count):
        wanted = position * (r - x) + rate
        free = v + velocity * wanted + integral * i + push
        v = copysign(maximum(abs(free) - stick, 0.0), free) * inverse
        x = x + step * v
        i = i + step * (wanted - v)
        r = r + step * rate
    return x, v, i


class ServoCore(BatchBlock):
    """Cascaded servo with static friction, without load: contact hardly disturbs a stiff drive (Sec. 2.1).

    ```
    name: ServoCore
    input_ports: [reference]
    output_ports: [state]
    parameters: [position_gain, velocity_gain, integral_gain, coulomb_friction, viscous_friction]
    ```

    reference: shape (2n,), reference and its rate, [rad, rad/s] or [m, m/s]; extrapolated with its rate inside a tick.
    state: shape (3n,), position, velocity and integral of the velocity error, [rad, rad/s, rad] or [m, m/s, m].
    State, no direct feedthrough.

    Parameters (Context, shape (n,)): position_gain K_v [1/s] > 0, velocity_gain w_v [1/s] > 0, integral_gain w_i [1/s]
    >= 0, coulomb_friction a_c [m/s^2 or rad/s^2] >= 0, viscous_friction b [1/s] >= 0.

    Sampling: every `period` [s], divided into `substeps` inner steps.
    """

    def __init__(
        self,
        size: int,
        *,
        period: float = 0.002,
        substeps: int = 4,
        position_gain: ArrayLike = 25.0,
        velocity_gain: ArrayLike = 200.0,
        integral_gain: ArrayLike = 15.0,
        coulomb_friction: ArrayLike = 1.6,
        viscous_friction: ArrayLike = 0.0,
        initial_position: ArrayLike = 0.0,
        unit: str = "rad",
    ):
        self._substeps = check_count("substeps", substeps)
        self._step = check("period", period, "positive") / substeps
        super().__init__(
            size,
            {
                "position_gain": BatchParameter(position_gain, "positive and finite", "1/s"),
                "velocity_gain": BatchParameter(velocity_gain, "positive and finite", "1/s"),
                "integral_gain": BatchParameter(integral_gain, "not negative", "1/s"),
                "coulomb_friction": BatchParameter(coulomb_friction, "not negative", f"{unit}/s^2"),
                "viscous_friction": BatchParameter(viscous_friction, "not negative", "1/s"),
            },
        )
        self.port_units = {"reference": f"{unit},{unit}/s", "state": f"{unit},{unit}/s,{unit}"}
        self._reference = self.DeclareVectorInputPort("reference", 2 * size)
        start = batch_values("initial_position", initial_position, size)
        state = self.DeclareDiscreteState(np.concatenate([start, np.zeros(2 * size)]))
        self._state = int(state)  # looking a state up by number takes half the time
        self.DeclareStateOutputPort("state", state)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """Coefficients of one inner step."""
        *gains, coulomb, viscous = values
        return step_coefficients(ServoGains(*gains), coulomb, viscous, self._step)

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        gains = self.values(context)
        r, rate = self.unstack(self._reference.Eval(context))
        x, v, i = self.unstack(context.get_discrete_state(self._state).value())
        next_state.set_value(self.stack(*servo_steps(x, v, i, r, rate, 0.0, gains, self._substeps, self.math)))


class Servo(PythonDiagram):
    """`ServoCore` with its state split into position and velocity.

    ```
    name: Servo
    input_ports: [reference]
    output_ports: [position, velocity]
    ```

    reference: shape (2n,), see `ServoCore` [rad, rad/s] or [m, m/s].
    position: shape (n,) [rad] or [m]. velocity: shape (n,) [rad/s] or [m/s].
    All outputs are state, no direct feedthrough.

    Sampling: every `period` [s] of the core.
    """

    def __init__(self, core: ServoCore):
        super().__init__()
        units = core.port_units["reference"].split(",")
        self.port_units = {"reference": core.port_units["reference"], "position": units[0], "velocity": units[1]}
        builder = DiagramBuilder()
        builder.AddNamedSystem("core", core)
        position, velocity, _ = split(builder, "parts", [core.size] * 3, core.GetOutputPort("state"))
        builder.ExportInput(core.GetInputPort("reference"), "reference")
        builder.ExportOutput(position, "position")
        builder.ExportOutput(velocity, "velocity")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class ServoConfig(Config, in_batches=True):
    """Scenario part `servo`. `ideal: true` leaves the servo out: the drive follows the filtered reference exactly."""

    ideal: bool = key(False, "true: the drive follows the filtered reference exactly; false: it has servo loops")
    position_gain: float = key(
        25.0, "gain K_v of the position loop", unit="1/s", bounds="from 0.001 to 100000", each=True
    )
    velocity_gain: float = key(
        200.0, "gain w_v of the velocity loop", unit="1/s", bounds="from 0.01 to 10000", each=True
    )
    integral_gain: float = key(
        15.0, "integral gain w_i of the velocity loop; 0: none", unit="1/s", bounds="from 0 to 10000", each=True
    )
    coulomb_friction: float = key(
        1.6,
        "Coulomb friction along the pressed direction, as a deceleration (OneDimensional, Kinematic)",
        unit="m/s^2",
        bounds="from 0 to 100",
        each=True,
    )
    friction_scale: float = key(
        1.0, "factor on the joint friction of the control parameters (Multibody)", unit="1", bounds="from 0 to 20"
    )
    tuned_for: str = key(
        "axes",
        "inertia that the velocity loops of the joints are tuned for: that in the control parameters (axes), or that "
        "of the rotors alone (rotors); Multibody",
        choices=("axes", "rotors"),
    )
    substeps: int = key(4, "inner steps of the servo per control tick, each at most 0.5 ms", bounds="from 1 to 100")

    def gains(self, rotor_inertia: Vector, loop_inertia: Vector) -> ServoGains:
        """Gains of each drive with respect to the inertia of its rotor.

        Args:
            rotor_inertia: at the joints (n,) [kg m2].
            loop_inertia: inertia that the loops are tuned for (n,) [kg m2]; empty: that of the rotors.
        """
        known = self.tuned_for == "axes" and loop_inertia.size > 0
        ratio = loop_inertia / rotor_inertia if known else np.ones(len(rotor_inertia))
        return ServoGains(self.position_gain, self.velocity_gain * ratio, self.integral_gain)

    def sampled_response(self, period: float) -> StateSpace:
        """From [reference, its rate] to [position, velocity] of one axis without friction; an ideal servo is direct."""
        if self.ideal:
            return state_space(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2), period)
        gains = ServoGains(self.position_gain, self.velocity_gain, self.integral_gain)
        inner = step_coefficients(gains, 0.0, 0.0, period / self.substeps)
        # Without friction a tick is linear: the columns are its responses to a unit of each state and input.
        x, v, i, r, rate = np.eye(5)
        moved = np.array(servo_steps(x, v, i, r, rate, 0.0, inner, self.substeps))
        return state_space(moved[:, :3], moved[:, 3:], np.eye(2, 3), np.zeros((2, 2)), period)

    def add_to(self, builder: DiagramBuilder, size: int, period: float) -> Servo:
        """Add the block for a batch of n axes along the pressed direction [m]."""
        core = ServoCore(
            size,
            period=period,
            substeps=self.substeps,
            position_gain=self.position_gain,
            velocity_gain=self.velocity_gain,
            integral_gain=self.integral_gain,
            coulomb_friction=self.coulomb_friction,
            unit="m",
        )
        return builder.AddNamedSystem("servo", Servo(core))

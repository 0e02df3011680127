"""Force control by set invariance without a nominal controller: relative degree 2, one step ahead (Sec. 3.2.2, 3.4).

    y = -dx_bar - C_T_hat F_bar <= 0,    y'' = -dx_bar''                                            (3.44), (3.50)

The control is the acceleration of the displacement command, integrated twice, exactly for a control held over the tick:

    dx_bar[k+1] = dx_bar[k] + Ts v[k] + Ts^2 u/2,    v[k+1] = v[k] + Ts u

The force enters through C_T_hat only: with a wrong C_T_hat the steady state is F = (C_T_hat/C_T) F_bar (3.55).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.force.adaptive_force_law import AdaptivePlanConfig
from forcectl.force.law import ForceLaw, LawConfig
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status

_MEMORY = ("velocity", "invariance_function", "status", "desired", "slope", "bend")
_NOT_FINITE = float(Status.NOT_FINITE)


def one_step_acceleration(
    y: BatchValue, rate: BatchValue, gamma: BatchValue, upper: BatchValue, period: float, m: Any = np
) -> BatchValue:
    """The fastest acceleration y'' of a double integrator after which the constraint y <= 0 can still be kept.

    For y <= 0 it is the largest a in [gamma, upper] whose next state (y1, y1') = (y + Ts y' + Ts^2 a/2, y' + Ts a) can
    be brought to rest at 0 with decelerations within gamma that change at the ticks only; gamma if there is none. For
    y > 0 the same is done for (-y, -y'), with the opposite sign. (3.31)*, (3.33)*, (3.57), sampled

    The set of such states is a polygon with corners on the parabola Phi = y - y'^2/(2 gamma) = 0 at speeds of whole
    multiples of -gamma Ts. So Phi(y1, y1') <= 0 holds as well, and every braking ends exactly at rest.

    Args:
        y: constraint output, violated when positive.
        rate: y'.
        gamma: lower bound of y'' when braking, < 0.
        upper: largest y'' when accelerating, > 0.
        period: tick Ts [s].
        m: numpy, or `SCALAR_MATH` for floats.
    """
    side = m.where(y > 0.0, -1.0, 1.0)
    speed_step = -gamma * period
    speed = side * rate / speed_step
    # In units of speed_step and speed_step * Ts: the corner of speed n is n (n + 1)/2 half steps ahead.
    ahead = -side * y / (speed_step * period) - 0.5 * speed
    n = m.floor((m.sqrt(1.0 + 8.0 * m.maximum(ahead, 0.0)) - 1.0) * 0.5)
    next_speed = m.where(ahead < 0.0, 2.0 * ahead, n + (ahead - 0.5 * n * (n + 1.0)) / (n + 1.0))
    return side * m.minimum(m.maximum(-gamma * (next_speed - speed), gamma), upper)


def fall(
    desired: BatchValue,
    last: BatchValue,
    last_slope: BatchValue,
    last_bend: BatchValue,
    compliance: BatchValue,
    opposite: BatchValue,
    period: float,
    m: Any = np,
) -> tuple[BatchValue, BatchValue, BatchValue, BatchValue]:
    """Speed and acceleration of the set point under a falling reference.

    The smaller of two successive differences is taken, so that jumps and corners of the reference do not count.

    Args:
        desired, last: F_bar now and a tick ago [N].
        last_slope, last_bend: first and second difference a tick ago [N/s, N/s^2].
        compliance: C_T_hat [m/N].
        opposite: -gamma [m/s^2].
        period: tick [s].
        m: numpy, or `SCALAR_MATH` for floats.

    Returns:
        slope and bend, the present differences; speed [m/s] and acceleration [m/s^2] of the set point, both >= 0.
    """
    slope = (desired - last) / period
    bend = (slope - last_slope) / period
    speed = -compliance * m.minimum(m.maximum(slope, last_slope), 0.0)
    return slope, bend, speed, m.minimum(-compliance * m.minimum(m.maximum(bend, last_bend), 0.0), 0.9 * opposite)


class InvarianceForceLaw(ForceLaw):
    """Invariance force controller [57] for n independent force loops.

    ```
    name: InvarianceForceLaw
    input_ports: [desired_force, measured_force, compliance (optional)]
    output_ports: [displacement_command, invariance_function, status]
    parameters: [gamma, upper_acceleration, speed_limit, lower_limit, upper_limit, compliance (optional)]
    ```

    desired_force, measured_force: shape (n,) [N]; the measured force is only checked to be finite.
    compliance: shape (n,), C_T_hat [m/N], > 0; the port exists when no `compliance` is given, else it is a parameter.
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    invariance_function: shape (n,), Phi(y, y') [m] of the state before the tick; above zero while the constraint cannot
    be kept within gamma, as after a step down.
    status: shape (n,), 0, or `Status.NOT_FINITE` while the command brakes and holds [1].
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): gamma [m/s^2] < 0, the braking acceleration towards the constraint;
    upper_acceleration [m/s^2] > 0, the largest when speeding up; speed_limit [m/s] > 0 of the command; lower_limit and
    upper_limit [m] of the command; compliance C_T_hat [m/N] > 0.

    A desired force below the present one is reached in the same manner from the other side. The set point may move at
    any time, also by a changing estimate of the compliance: position and velocity of the command stay continuous.

    A rising reference is followed at the distance the command needs to stop, so that F never passes F_bar. A falling
    one is followed with its speed and its acceleration, by differences. If it suddenly begins to fall at r [N/s], F
    exceeds it by at most C_T r^2/(2 upper_acceleration) + 2 Ts r; if it suddenly stops, F falls short by at most
    C_T r^2/(-2 gamma). A single jump counts as a step, not as a speed.

    A desired force, measured force or compliance that is not finite (or a compliance not above zero) brakes the command
    within gamma and holds it there. A loss of contact has no effect on the law: the command stays at its set point, and
    the force returns to it when contact is back.

    Sampling: every `period` [s]; no delay from desired_force to displacement_command, see `SampledBlock`.
    """

    port_units = {"invariance_function": "m"}
    follows = "desired_force"
    # Inputs of a subclass after the forces, and its own memory; the names differ from those above.
    own_inputs: tuple[str, ...] = ()
    own_memory: tuple[str, ...] = ()

    def __init__(
        self,
        size: int,
        *,
        gamma: ArrayLike = -0.1,
        upper_acceleration: ArrayLike | None = None,
        compliance: ArrayLike | None = None,
        speed_limit: ArrayLike = np.inf,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        period: float = 0.002,
    ):
        if upper_acceleration is None:
            upper_acceleration = -batch_values(f"{type(self).__name__}.gamma", gamma, size, "negative and finite")
        parameters = {
            "gamma": BatchParameter(gamma, "negative and finite", "m/s^2"),
            "upper_acceleration": BatchParameter(upper_acceleration, "positive and finite", "m/s^2"),
            "speed_limit": BatchParameter(speed_limit, "positive", "m/s"),
        }
        super().__init__(
            size,
            parameters,
            dict.fromkeys((*_MEMORY, *self.own_memory), 0.0),
            period,
            lower_limit=lower_limit,
            upper_limit=upper_limit,
            compliance=compliance,
            inputs=self.own_inputs,
            shows=("invariance_function", "status"),
        )

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """The parameters, with -gamma and the largest acceleration of the command."""
        gamma, upper, *rest = values
        return gamma, -gamma, upper, self.math.maximum(upper, -gamma), *rest

    def decide(
        self,
        memory: Memory,
        inputs: Memory,
        y: BatchValue,
        rate: BatchValue,
        retreat: BatchValue,
        gamma: BatchValue,
        upper: BatchValue,
    ) -> tuple[BatchValue, Memory]:
        """The acceleration -dx_bar'' of a new tick, and the subclass' own memory after it.

        Args:
            memory: of the tick before.
            inputs: of the tick.
            y: constraint output [m].
            rate: its rate [m/s].
            retreat: acceleration of the set point, which is y'' + dx_bar'' [m/s^2].
            gamma: lower bound of y'' [m/s^2].
            upper: upper bound of it [m/s^2].
        """
        return one_step_acceleration(y, rate, gamma, upper, self._period, self.math) - retreat, {}

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        maximum, minimum, where, period = self.math.maximum, self.math.minimum, self.math.where, self._period
        gamma, opposite, upper, most, speed_limit, lower_limit, upper_limit, *fixed = self.values(context)
        x, v, last = memory["displacement_command"], memory["velocity"], memory["desired"]
        desired, measured = inputs["desired_force"], inputs["measured_force"]
        compliance = fixed[0] if fixed else inputs["compliance"]
        good = (abs(desired) + abs(measured) + compliance < inf) & (compliance > 0.0)
        desired, compliance = where(good, desired, last), where(good, compliance, 0.0)

        free = -compliance * desired
        target = minimum(maximum(free, lower_limit), upper_limit)
        follow = where(free == target, compliance, 0.0)
        slope, bend, falls, retreat = fall(
            desired, last, memory["slope"], memory["bend"], follow, opposite, period, self.math
        )
        rate = falls - v
        y = target - x
        chosen, own = self.decide(memory, inputs, y, rate, retreat, gamma + retreat, upper)
        braked = v - minimum(maximum(v, period * gamma), period * opposite)
        wanted = where(good, v - period * chosen, braked)

        # The speed limit is applied within the acceleration limits, and the limits of the command last.
        change = period * most
        wanted = minimum(maximum(wanted, -speed_limit), speed_limit)
        wanted = minimum(maximum(wanted, v - change), v + change)
        after = x + 0.5 * period * (v + wanted)
        inside = minimum(maximum(after, minimum(x, lower_limit)), maximum(x, upper_limit))
        velocity = where(inside == after, wanted, 0.0)
        phi = y + 0.5 * maximum(rate, 0.0) * rate / opposite
        return {
            "displacement_command": inside,
            "velocity": velocity,
            "invariance_function": phi,
            "status": where(good, 0.0, _NOT_FINITE),
            "desired": desired,
            "slope": slope,
            "bend": bend,
            **own,
        }


_Law = TypeVar("_Law", bound=InvarianceForceLaw)


@dataclass(kw_only=True)
class InvarianceLimits(Config, LawConfig):
    """Keys that the configurations of laws with this constraint share."""

    gamma: float = key(
        -0.1,
        "braking deceleration of the displacement command before its set point, as a negative number",
        unit="m/s^2",
        bounds="from -1000 to -1e-6",
        each=True,
    )
    upper_acceleration: float | None = key(
        None,
        "largest acceleration of the displacement command when it speeds up; null: -gamma",
        unit="m/s^2",
        bounds="positive",
        each=True,
    )
    compliance_error: float = key(
        1.0,
        "modelled total compliance in the constraint relative to the true one, C_T_hat / C_T",
        bounds="from 0.001 to 1000",
        each=True,
    )
    speed_limit: float = key(
        inf, "largest speed of the displacement command", unit="m/s", bounds="at least 0.00001", each=True
    )
    lower_limit: float = key(
        -0.1,
        "lower limit of the displacement command, into the surface",
        unit="m",
        bounds="from -10 to -0.000001",
        each=True,
    )
    upper_limit: float = key(
        0.1,
        "upper limit of the displacement command, off the surface",
        unit="m",
        bounds="from 0.000001 to 10",
        each=True,
    )

    def block(self, kind: type[_Law], model: PlantModel, compliance: ArrayLike | None) -> _Law:
        """The block with this total compliance C_T_hat [m/N], or with a port for it (None)."""
        return kind(
            model.size,
            gamma=self.gamma,
            upper_acceleration=self.upper_acceleration,
            compliance=compliance,
            speed_limit=self.speed_limit,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )


@dataclass(kw_only=True)
class InvarianceConfig(InvarianceLimits, in_batches=True):
    """Scenario part `!Invariance`: force control by set invariance, without a nominal law. (Sec. 3.2.2, 3.4)"""

    def law(self, model: PlantModel, compliance: ArrayLike | None) -> InvarianceForceLaw:
        """The block with this total compliance C_T_hat [m/N], or with a port for it (None)."""
        return self.block(InvarianceForceLaw, model, compliance)


@dataclass(kw_only=True)
class AdaptiveInvarianceConfig(AdaptivePlanConfig, InvarianceConfig, in_batches=True):
    """Scenario part `!AdaptiveInvariance`: `!Invariance`, compliance estimated on line. (3.56)"""

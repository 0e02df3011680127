"""Force control with a controller linear in its parameters, which VRFT tunes (Secs. 4.3 and 4.5)::

    dx_bar = u_hat - C_R_hat F                                                                         (4.12)
    u_hat  = C_rho(z) (F_bar - F)                                                                      (4.13)
    C_rho  = K_P + K_I Ts/(1 - z^-1) + K_D (1 - z^-1)/(Ts + T_D - T_D z^-1) + sum_i f_i z^-i           (4.20)

With T_D = 0 this is the discrete PID of (4.20), whose gains are K_I Ts and K_D/Ts; T_D > 0 is the derivative
s/(1 + s T_D) of Sec. 4.3. The plant gain from dx to F is negative, and so are the gains. The positive feedback of the
robot's compliance leaves a plant with the environment's compliance alone, in every posture.

Not in the thesis and off by default: a feed-forward -C_F F_bar of the desired force behind a first-order lag T_F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.errors import BadInputError, invalid
from forcectl.force.law import ForceLaw, LinearLawConfig, low_pass
from forcectl.framework.batch import BatchParameter, BatchValue
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel

GAINS = ("proportional_gain", "integral_gain", "derivative_gain")
GAIN_UNITS = {"proportional_gain": "m/N", "integral_gain": "m/(N s)", "derivative_gain": "m s/N"}
EARLY = 0.1  # [s] largest K_P/-K_I > 0: a contact with damping, whose force rises early, may need K_P > 0
EXCITE, REGULATE = 0.0, 1.0  # values of `mode`


class LinearForceLaw(ForceLaw):
    """PID and FIR force controller with feedback of the robot's compliance, for n independent force loops.

    ```
    name: LinearForceLaw
    input_ports: [desired_force, measured_force, proportional_gain (optional), integral_gain (optional),
    derivative_gain (optional), excitation (optional), mode (optional)]
    output_ports: [displacement_command, controller_output]
    parameters: [robot_compliance, derivative_filter, feed_forward, feed_forward_filter, proportional_gain (optional),
    integral_gain (optional), derivative_gain (optional), fir_0 (optional), fir_1 (optional), fir_2 (optional),
    lower_limit, upper_limit]
    ```

    desired_force, measured_force: shape (n,) [N].
    proportional_gain, integral_gain, derivative_gain: shape (n,) [m/N, m/(N s), m s/N], ports when `gains` is None,
    else parameters. When they change, u_hat does not jump.
    excitation: shape (n,), u_hat of the open-loop experiment [m]; mode: shape (n,), `EXCITE` or `REGULATE` [1]. Both
    ports exist with `open_loop`. In `EXCITE` the command follows the excitation. The integral tracks it, so that the
    hand-over to `REGULATE` is without a jump for every force error.
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    controller_output: shape (n,), u_hat = dx_bar + C_R_hat F [m] as commanded, after the limits.
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): robot_compliance C_R_hat [m/N] >= 0, derivative_filter T_D [s] >= 0, feed_forward
    C_F [m/N] >= 0, feed_forward_filter T_F [s] >= 0, the three gains, and fir_0, fir_1, ... [m/N], as many as are
    given, lower_limit and upper_limit of dx_bar [m].

    The integral starts at C_R_hat F, so that the feedback of the force at the start does not move the command from 0.
    At a limit the integral only changes away from it. A force, gain or excitation that is not a number holds the last
    command and all states. After contact loss F = 0: the command follows the surface, down to its lower limit.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, see `SampledBlock`.

    Args:
        gains: K_P, K_I, K_D, each a number or shape (n,), negative, as the plant gain is; None: from ports.
        fir: f_0, f_1, ..., each a number or shape (n,).

    Raises:
        BadInputError: not three gains, or a parameter that is not allowed.
    """

    port_units = GAIN_UNITS | {"excitation": "m", "controller_output": "m"}
    uses_compliance = False

    def __init__(
        self,
        size: int,
        *,
        gains: Sequence[ArrayLike] | None = None,
        fir: Sequence[ArrayLike] = (),
        robot_compliance: ArrayLike = 0.0,
        derivative_filter: ArrayLike = 0.0,
        feed_forward: ArrayLike = 0.0,
        feed_forward_filter: ArrayLike = 0.0,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        open_loop: bool = False,
        period: float = 0.002,
    ):
        parameters = {
            "robot_compliance": BatchParameter(robot_compliance, "not negative and finite", "m/N"),
            "derivative_filter": BatchParameter(derivative_filter, "not negative and finite", "s"),
            "feed_forward": BatchParameter(feed_forward, "not negative and finite", "m/N"),
            "feed_forward_filter": BatchParameter(feed_forward_filter, "not negative and finite", "s"),
        }
        if gains is not None:
            if len(gains) != len(GAINS):
                raise BadInputError(f"gains has {len(gains)} values: must have {len(GAINS)}, {', '.join(GAINS)}")
            parameters |= {n: BatchParameter(v, "finite", GAIN_UNITS[n]) for n, v in zip(GAINS, gains, strict=True)}
        parameters |= {f"fir_{i}": BatchParameter(value, "finite", "m/N") for i, value in enumerate(fir)}
        self._own_gains, self._open_loop = gains is not None, open_loop
        own = ("controller_output", "started", "integral", "proportional", "derivative", "expected_force")
        super().__init__(
            size,
            parameters,
            {**dict.fromkeys(own, 0.0), "last_errors": np.zeros((max(len(fir) - 1, 1), 1))},
            period,
            lower_limit=lower_limit,
            upper_limit=upper_limit,
            inputs=[*(GAINS if gains is None else ()), *(("excitation", "mode") if open_loop else ())],
            shows=("controller_output",),
        )

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m, period = self.math, self._period
        robot, filter_time, forward, forward_time, *coefficients, lower, upper = self.values(context)
        force = inputs["measured_force"]
        error = inputs["desired_force"] - force
        gains, fir = coefficients[:3], coefficients[3:]
        if not self._own_gains:
            gains, fir = [inputs[name] for name in GAINS], coefficients
        kp, ki, kd = gains
        good = (abs(error) < np.inf) & (abs(force) < np.inf) & (abs(kp) + abs(ki) + abs(kd) < np.inf)
        if self._open_loop:
            excitation = inputs["excitation"]
            regulate = inputs["mode"] >= 0.5 * (EXCITE + REGULATE)
            good = good & (regulate | (abs(excitation) < np.inf))
            excitation = m.where(good, excitation, 0.0)
        error, force = m.where(good, error, 0.0), m.where(good, force, 0.0)
        kp, ki, kd = m.where(good, kp, 0.0), m.where(good, ki, 0.0), m.where(good, kd, 0.0)

        past = memory["last_errors"]
        feedback = robot * force
        # The integral compensates a change of K_P, and at the start the feedback of the force.
        integral = memory["integral"] + (memory["proportional"] - kp * past[0])
        integral = m.where(memory["started"] > 0, integral, feedback)
        proportional = kp * error
        derivative = (filter_time * memory["derivative"] + kd * (error - past[0])) / (filter_time + period)
        moving: BatchValue = 0.0
        for coefficient, e in zip(fir, (error, *past), strict=False):
            moving = moving + coefficient * e
        desired = m.where(good, inputs["desired_force"], 0.0)
        expected = low_pass(memory["expected_force"], desired, forward_time, period)
        others = proportional + derivative + moving - feedback - forward * expected
        after = integral + ki * period * error
        free = after + others
        # At a limit of the command the integral stops where the command reaches it, and is never moved back to there.
        after = m.where((free > upper) & (after > integral), m.maximum(integral, upper - others), after)
        integral = m.where((free < lower) & (after < integral), m.minimum(integral, lower - others), after)
        command = m.minimum(m.maximum(integral + others, lower), upper)
        if self._open_loop:
            command = m.where(regulate, command, m.minimum(m.maximum(excitation - feedback, lower), upper))
            integral = m.where(regulate, integral, command - others)
        new = {
            "displacement_command": command,
            "controller_output": command + feedback,
            "started": 1.0,
            "integral": integral,
            "proportional": proportional,
            "derivative": derivative,
            "expected_force": expected,
            "last_errors": [error, *past[:-1]],
        }
        good = good & (abs(free) < np.inf)
        return self.choose(good, new, memory)


@dataclass(kw_only=True)
class VrftConfig(Config, LinearLawConfig, in_batches=True):
    """Scenario part `!Vrft`: PID with a filter, or FIR, with gains found by VRFT; the default is Sec. 4.3.4.

    With `gains_from` the three gains are found before the run, see `forcectl.scenario.gains`, and none may be given.
    """

    gains_from: str | None = key(
        None,
        "name of the experiment that finds the three gains, on the station and seed of the run; null: the gains given "
        "here",
    )
    gains_variant: str | None = key(None, "variant of the experiment that finds the gains; null: its first")
    proportional_gain: float = key(
        -5.37e-5, "proportional gain K_P, force error to displacement", unit="m/N", each=True
    )
    integral_gain: float = key(
        -2.53e-4,
        "integral gain K_I, force error to displacement rate; negative, as displacements into the surface are",
        unit="m/(N s)",
        bounds="at most 0",
        each=True,
    )
    derivative_gain: float = key(
        1.62e-8, "derivative gain K_D, force error rate to displacement", unit="m s/N", each=True
    )
    fir: list[float] = key(
        [],
        "coefficients f_0, f_1, ... of an FIR filter of the force error, added to the PID; empty: none",
        unit="m/N",
        bounds="from -100000 to 100000",
    )
    derivative_filter: float | None = key(
        None,
        "time constant T_D of the derivative's filter; null: two ticks",
        unit="s",
        bounds="from 0 to 100",
        each=True,
    )
    robot_compliance_error: float = key(
        1.0,
        "modelled compliance of the robot relative to the true one, C_R_hat / C_R",
        bounds="from 0 to 1000",
        each=True,
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
    reference_bandwidth: float = key(
        1.5,
        "bandwidth of the reference model that the gains were tuned for",
        unit="rad/s",
        bounds="positive",
        each=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gains_from is not None:
            for field in fields(self):
                if field.name in GAINS and (gain := getattr(self, field.name)) != field.default:
                    raise invalid(field.name, gain, f"left out: gains_from = {self.gains_from!r} determines it")
            return
        if self.gains_variant is not None:
            raise invalid("gains_variant", self.gains_variant, "null without gains_from")
        if self.integral_gain == 0 <= self.proportional_gain and not any(self.fir):
            allowed = "below zero with integral_gain = 0: else the law does not press"
            raise invalid("proportional_gain", self.proportional_gain, allowed)
        if self.proportional_gain > (most := -EARLY * self.integral_gain) and not any(self.fir):
            allowed = f"at most {most:g} m/N, {EARLY:g} s times minus integral_gain: a push is negative"
            raise invalid("proportional_gain", self.proportional_gain, allowed)

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth [rad/s] of the reference model M(s) = w/(s + w)."""
        return self.reference_bandwidth

    def check_tunable(self, use: str, what: str) -> None:
        """BadInputError unless the gains can be tuned or scaled from these values.

        Args:
            use: what K_P and K_I are needed for, for the message.
            what: what is done with the PID gains, for the message.
        """
        if not (self.proportional_gain < 0 and self.integral_gain < 0):
            gains = f"proportional_gain = {self.proportional_gain:g}, integral_gain = {self.integral_gain:g}"
            raise BadInputError(f"{gains}: must both be below zero, because they {use}")
        if self.fir:
            raise invalid("fir", self.fir, f"empty: the PID gains are {what}")

    def law(self, model: PlantModel, *, gains_from_ports: bool = False) -> LinearForceLaw:
        """The block; C_R_hat is `robot_compliance_error` times the true compliance of the robot."""
        gains = (self.proportional_gain, self.integral_gain, self.derivative_gain)
        return LinearForceLaw(
            model.size,
            gains=None if gains_from_ports else gains,
            fir=self.fir,
            derivative_filter=2 * model.period if self.derivative_filter is None else self.derivative_filter,
            robot_compliance=self.robot_compliance_error * model.robot_compliance,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )

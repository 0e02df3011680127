"""Compliance of the environment from changes of the desired force: EWRLS with an instrumental variable::

    x = -dx - C_R_hat F = C_E F - h                       (2.10) with the unknown height h of the surface
    F_M = M(z) F_bar                                      modelled response to the desired force, the instrument
    k = P z/(R + z P z),    C_E += k (x - F C_E),    P -= k z P,    P += (Ts/T) (C_E^2 - P)

The height of the surface and friction change force and displacement together, in a ratio set by the controller and not
by the contact. They would bias least squares with F as regressor. x, F and z = F_M pass the same high-pass
w_h s/(s + w_h), which removes slopes and the bending of the robot. Without information P returns to C_E^2 with the time
constant T.
"""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check
from forcectl.framework.sampled_block import Memory, SampledBatch

# C_E, P, the output, whether samples count, time until they may, F_M; high-passed x, F and z; last x, F and F_M.
_MEMORY = (
    *("estimate", "covariance", "environment_compliance", "learning", "wait", "model"),
    *("x", "f", "z", "last_x", "last_f", "last_model"),
)


class ExcitedCompliance(SampledBatch):
    """Estimate of the compliance of the environment of n contacts, from changes of the desired force.

    ```
    name: ExcitedCompliance
    input_ports: [desired_force, measured_force, displacement]
    output_ports: [environment_compliance, learning]
    parameters: [bandwidth, drift_bandwidth, robot_compliance, surface_deviation, memory, minimum_excitation,
    minimum_force, largest_change, range, rate]
    ```

    desired_force, measured_force: shape (n,) [N].
    displacement: shape (n,), actual motor-side dx [m], passed through the same filter as the force.
    environment_compliance: shape (n,), C_E_hat limited by range and rate [m/N]. State, no direct feedthrough.
    learning: shape (n,), 1 while samples count, else 0 [1]. State.

    Parameters (Context, shape (n,)): bandwidth w_c of M [rad/s] > 0 and drift_bandwidth w_h [rad/s] > 0, both below
    1/period; robot_compliance C_R_hat [m/N] >= 0; surface_deviation [m] > 0, standard deviation of what the surface
    adds to dx within 1/w_h, which gives R; memory T [s] > 0. Guards: samples count only while `|z|` is at least
    minimum_excitation [N] >= 0, and from 1/w_h after the force has risen above minimum_force [N] >= 0. The error is
    limited to largest_change [1] > 0 times z C_E. C_E_hat stays within the factor range [1] >= 1 of the initial one,
    and its relative change is at most rate [1/s] > 0.

    An input that is not finite is skipped.

    Sampling: every `period` [s]; the outputs change one tick after the samples they use.

    Args:
        initial_compliance: C_E_hat at the start [m/N], > 0.
    """

    port_units = {"learning": "1"}

    def __init__(
        self,
        size: int,
        *,
        initial_compliance: ArrayLike,
        bandwidth: ArrayLike = 1.5,
        drift_bandwidth: ArrayLike = 3.0,
        robot_compliance: ArrayLike = 0.0,
        surface_deviation: ArrayLike = 1e-5,
        memory: ArrayLike = 3.0,
        minimum_excitation: ArrayLike = 0.2,
        minimum_force: ArrayLike = 2.0,
        largest_change: ArrayLike = 2.0,
        range: ArrayLike = 10.0,
        rate: ArrayLike = 3.0,
        period: float = 0.002,
    ):
        self._period = check("period", period, "positive")
        self._first = batch_values("initial_compliance", initial_compliance, size, "positive and finite")
        super().__init__(
            size,
            {
                "bandwidth": BatchParameter(bandwidth, "positive and finite", "rad/s"),
                "drift_bandwidth": BatchParameter(drift_bandwidth, "positive and finite", "rad/s"),
                "robot_compliance": BatchParameter(robot_compliance, "not negative", "m/N"),
                "surface_deviation": BatchParameter(surface_deviation, "positive and finite", "m"),
                "memory": BatchParameter(memory, "positive", "s"),
                "minimum_excitation": BatchParameter(minimum_excitation, "not negative", "N"),
                "minimum_force": BatchParameter(minimum_force, "not negative", "N"),
                "largest_change": BatchParameter(largest_change, "positive", "1"),
                "range": BatchParameter(range, "positive", "1"),
                "rate": BatchParameter(rate, "positive", "1/s"),
            },
        )
        inputs = [
            self.DeclareVectorInputPort(name, size) for name in ("desired_force", "measured_force", "displacement")
        ]
        start = {"estimate": self._first, "covariance": self._first**2, "environment_compliance": self._first}
        self.declare_memory(dict.fromkeys(_MEMORY, 0.0) | start, inputs, period)
        self.show_held("environment_compliance")
        self.show_held("learning")

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Both filters are stable and do not oscillate; the range is a factor of at least 1."""
        for name in ("bandwidth", "drift_bandwidth"):
            if not (values[name] * self._period < 1).all():
                raise invalid(name, values[name].tolist(), f"below 1/period = {1 / self._period:g} rad/s")
        if not (values["range"] >= 1).all():
            raise invalid("range", values["range"].tolist(), "at least 1")

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """Per tick: 1 - A, decay of the high-pass, C_R, R, forgetting, guards, bounds, change and time to wait."""
        w, w_h, robot, deviation, memory, excitation, force, change, span, rate = values
        first, period = self.batch_value(self._first), self._period
        noise = deviation**2 / (w_h * period)  # the disturbance is correlated over 1/w_h
        return (
            *(w * period, 1 - w_h * period, robot, noise, self.math.minimum(period / memory, 1.0)),
            *(excitation, force, change, first / span, first * span, rate * period, 1 / w_h),
        )

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One sample."""
        m = self.math
        values = self.values(context)
        approach, decay, robot, noise, forgetting, excitation, least, change, low, high, rate, pause = values
        c, p, shown, model = memory["estimate"], memory["covariance"], memory["environment_compliance"], memory["model"]
        force = inputs["measured_force"]
        now = -inputs["displacement"] - robot * force
        # Before the first sample: rest at zero force and displacement.
        x = decay * memory["x"] + (now - memory["last_x"])
        f = decay * memory["f"] + (force - memory["last_f"])
        z = decay * memory["z"] + (model - memory["last_model"])
        after = model + approach * (inputs["desired_force"] - model)
        wait = m.where(force < least, pause, m.maximum(memory["wait"] - self._period, 0.0))
        learn = (abs(z) >= excitation) & (wait <= 0)

        most = change * abs(z) * c
        error = m.minimum(m.maximum(x - f * c, -most), most)
        gain = p * z / (noise + z * p * z)
        new = m.minimum(m.maximum(m.where(learn, c + gain * error, c), low), high)
        p = m.where(learn, p * (1 - gain * z), p)
        p = p + forgetting * (new**2 - p)
        step = rate * shown
        shown = shown + m.minimum(m.maximum(new - shown, -step), step)
        values = (new, p, shown, m.where(learn, 1.0, 0.0), wait, after, x, f, z, now, force, model)
        # Infinity minus infinity is not a number, so one comparison catches both NaN and overflow.
        total = now + force + after + x + f + new + p
        good = total - total == 0
        return self.choose(good, dict(zip(_MEMORY, values, strict=True)), memory)

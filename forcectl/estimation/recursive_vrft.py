"""Recursive VRFT: the gains of a PID force controller from the data of an experiment, sample by sample (Sec. 4.5).

A controller whose closed loop is M(z) = (1 - A) z^-1/(1 - A z^-1), A = 1 - Ts w_c, would have had the virtual error
e_v = (M^-1 - 1) y [N] as input and the recorded u [m] as output. Least squares over K_P, K_I Ts and K_D/Ts of (4.20)::

    phi[k] = F(z) [y - y z^-1, y, y - 2 y z^-1 + y z^-2]/(1 - A),    target F(z) u[k-1]                (4.27)*
    F = 1 (Sec. 4.5),    or L = M (1 - M), which weighs frequencies as the closed loop does (Sec. 4.2)

u[k-1] belongs to y[k], because the virtual error of (4.24) is one sample ahead. u and y are relative to the first
sample, at rest. The recursion (4.19) updates the factors of P = U D U', so P stays symmetric and positive for any P_0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.batch import SCALAR_MATH, BatchParameter, BatchValue, batch_values, check
from forcectl.framework.sampled_block import Memory, SampledBatch

GAINS = ("proportional_gain", "integral_gain", "derivative_gain")
_WAIT = 3.0  # samples after a gap until no difference contains samples from before it
_SMOOTHING = 0.05  # per sample, of the rate of the force
_DATA = 11  # number of states of `regressor_step`


def regressor_step(
    memory: Sequence[BatchValue], u: BatchValue, y: BatchValue, decay: BatchValue, prefilter: bool, m: Any = np
) -> tuple[tuple[BatchValue, BatchValue, BatchValue], BatchValue, BatchValue, list[BatchValue]]:
    """One sample of the data in regressor form.

    Args:
        memory: `_DATA` batch values, zero before the first sample.
        u: u_hat at this tick [m].
        y: force at this tick [N].
        decay: A.
        prefilter: F = M (1 - M) instead of 1.

    Returns:
        phi, target, whether the sample is valid, and the memory.
    """
    started, rest_u, rest_y, wait, y1, slope_y, s1, rate, u1, slope_u, t1 = memory
    good = (abs(u) < np.inf) & (abs(y) < np.inf)
    first = good & (started == 0)
    rest_u, rest_y = m.where(first, u, rest_u), m.where(first, y, rest_y)
    u, y = m.where(good, u - rest_u, u1), m.where(good, y - rest_y, y1)
    if prefilter:
        slope_y, slope_u = decay * slope_y + (y - y1), decay * slope_u + (u - u1)
        s, t, target = decay * s1 + slope_y, decay * t1 + slope_u, (1.0 - decay) * t1
    else:
        s, t, target = y / (1.0 - decay), u, t1
    phi = (s - s1, s, s - s1 - rate)
    wait = m.where(good, m.maximum(wait - 1.0, 0.0), _WAIT)
    started = m.where(good, 1.0, started)
    learn = good & (wait == 0)
    return phi, target, learn, [started, rest_u, rest_y, wait, y, slope_y, s, s - s1, u, slope_u, t]


def rounded(value: BatchValue, quantum: BatchValue, m: Any = np) -> BatchValue:
    """`value` rounded to a multiple of `quantum`; unchanged where the quantum is 0."""
    exists = quantum > 0
    size = m.where(exists, quantum, 1.0)
    return m.where(exists, size * m.floor(value / size + 0.5), value)


def rls_step(
    theta: Sequence[BatchValue],
    diagonal: Sequence[BatchValue],
    upper: Sequence[BatchValue],
    phi: Sequence[BatchValue],
    target: BatchValue,
    forgetting: BatchValue,
) -> tuple[list[BatchValue], list[BatchValue], list[BatchValue]]:
    """One update of recursive least squares (4.19) with three parameters, in Bierman's form.

    Args:
        theta: estimate (3).
        diagonal: of D (3).
        upper: U above its diagonal of ones (3), row by row.
        phi: regressor (3).
        target: scalar.
        forgetting: lambda, 0 < lambda <= 1.

    Returns:
        theta, D and U after the sample; P = U D U'.
    """
    d0, d1, d2 = diagonal
    u01, u02, u12 = upper
    p0, p1, p2 = phi
    f1, f2 = p1 + u01 * p0, p2 + u02 * p0 + u12 * p1
    g0, g1, g2 = d0 * p0, d1 * f1, d2 * f2
    a0 = forgetting + p0 * g0
    a1 = a0 + f1 * g1
    a2 = a1 + f2 * g2
    # P phi is summed column by column; the update of U uses the old entries.
    k0, k1 = g0 + u01 * g1, g1
    above = [u01 - f1 / a0 * g0, u02 - f2 / a1 * k0, u12 - f2 / a1 * k1]
    k0, k1 = k0 + u02 * g2, k1 + u12 * g2
    error = (target - (p0 * theta[0] + p1 * theta[1] + p2 * theta[2])) / a2
    return (
        [theta[0] + k0 * error, theta[1] + k1 * error, theta[2] + g2 * error],
        [d0 / a0, d1 * a0 / (a1 * forgetting), d2 * a1 / (a2 * forgetting)],
        above,
    )


def recursive_vrft(
    u: ArrayLike,
    y: ArrayLike,
    *,
    bandwidth: float,
    period: float,
    prefilter: bool = True,
    initial_covariance: float = 100.0,
    forgetting: float = 1.0,
) -> Array:
    """Gains after each sample of a recorded experiment.

    Args:
        u: u_hat (k,) [m].
        y: force (k,) [N]; the first sample of both at rest.
        bandwidth: w_c of M [rad/s].
        period: Ts [s].
        initial_covariance: P_0 = this times the identity. The rest: see `RecursiveVrft`.

    Returns:
        K_P, K_I, K_D [m/N, m/(N s), m s/N], shape (k, 3).
    """
    decay, learnt = 1.0 - period * bandwidth, []
    memory, theta, d, upper = [0.0] * _DATA, [0.0] * 3, [initial_covariance] * 3, [0.0] * 3
    for uk, yk in zip(np.asarray(u, dtype=float).tolist(), np.asarray(y, dtype=float).tolist(), strict=True):
        phi, target, learn, memory = regressor_step(memory, uk, yk, decay, prefilter, SCALAR_MATH)
        if learn:
            theta, d, upper = rls_step(theta, d, upper, phi, target, forgetting)
        learnt.append(theta)
    return np.array(learnt) * [1.0, 1.0 / period, period]


class RecursiveVrft(SampledBatch):
    """Tunes the PID gains of n force loops while their experiment runs.

    ```
    name: RecursiveVrft
    input_ports: [controller_output, measured_force, mode (optional)]
    output_ports: [proportional_gain, integral_gain, derivative_gain]
    parameters: [bandwidth, forgetting, resolution, minimum_force, minimum_rate, gain_range]
    ```

    controller_output: shape (n,), u_hat as commanded [m]. measured_force: shape (n,) [N].
    mode: shape (n,) [1]; samples count while it is below 0.5 (`EXCITE`). The port does not exist with `always`; force
    and displacement are then relative to zero, not to the first sample.
    proportional_gain, integral_gain, derivative_gain: shape (n,), K_P, K_I, K_D [m/N, m/(N s), m s/N];
    `initial_gains` before the first sample. State, no direct feedthrough.

    Parameters (Context, shape (n,)): bandwidth w_c [rad/s] > 0 of the reference model, below 1/period; forgetting in
    (0, 1], 1 for a surface that does not change; resolution [N] >= 0 that the force is rounded to before it is used, as
    in a recording: without it, second differences of the simulated force give a K_D that measured data would not
    (targets, section 2). For tuning during force control: minimum_force [N] >= 0 and minimum_rate [N/s] >= 0, below
    which samples do not count, the rate smoothed over 20 samples; gain_range [1] > 0, largest factor by which K_P and
    K_I may differ from the initial gains, up or down, infinite: no bounds. Forgetting does not increase D beyond P_0.

    A sample that is not finite is skipped, as are the two after it, whose differences would contain it.

    Sampling: every `period` [s]; the outputs change one tick after the samples they use.

    Args:
        prefilter: weigh with M (1 - M); without it, noise biases K_P.
        initial_covariance: P_0 is this times the identity, > 0, for the gains K_P, K_I Ts, K_D/Ts and the data as in
            (4.27).
        initial_gains: K_P, K_I, K_D, each a number or shape (n,).
    """

    port_units = {"proportional_gain": "m/N", "integral_gain": "m/(N s)", "derivative_gain": "m s/N"}

    def __init__(
        self,
        size: int,
        *,
        bandwidth: ArrayLike = 1.5,
        forgetting: ArrayLike = 1.0,
        resolution: ArrayLike = 0.0,
        minimum_force: ArrayLike = 0.0,
        minimum_rate: ArrayLike = 0.0,
        gain_range: ArrayLike = np.inf,
        initial_gains: Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        initial_covariance: ArrayLike = 100.0,
        prefilter: bool = True,
        always: bool = False,
        period: float = 0.002,
    ):
        self._period = check("period", period, "positive")
        self._highest = batch_values("initial_covariance", initial_covariance, size, "positive and finite")
        units = zip(initial_gains, (1.0, period, 1.0 / period), strict=True)
        self._first = [batch_values("initial_gains", value, size) * unit for value, unit in units]
        super().__init__(
            size,
            {
                "bandwidth": BatchParameter(bandwidth, "positive and finite", "rad/s"),
                "forgetting": BatchParameter(forgetting, "above 0 and at most 1", "1"),
                "resolution": BatchParameter(resolution, "not negative", "N"),
                "minimum_force": BatchParameter(minimum_force, "not negative", "N"),
                "minimum_rate": BatchParameter(minimum_rate, "not negative", "N/s"),
                "gain_range": BatchParameter(gain_range, "positive", "1"),
            },
        )
        self._prefilter = prefilter
        names = ("controller_output", "measured_force", *(() if always else ("mode",)))
        inputs = [self.DeclareVectorInputPort(name, size) for name in names]
        data = np.zeros((_DATA, size))
        data[0] = always  # rest is known
        # theta, D, U, the smoothed rate and the data, see `rls_step` and `regressor_step`.
        memory = {
            "theta": np.array(self._first),
            "diagonal": np.tile(self._highest, (3, 1)),
            "upper": np.zeros((3, size)),
            "rate": 0.0,
            "data": data,
        }
        self.declare_memory(memory, inputs, period)
        for i, (name, unit) in enumerate(zip(GAINS, (1.0, 1.0 / period, period), strict=True)):
            self.show_held(name, "theta", i, unit)

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """(A, forgetting, resolution or None, least force and rate, bounds of K_P and K_I Ts or None, P_0)."""
        m = self.math
        bandwidth, forgetting, resolution, force, rate, span = values
        bounds = None
        if np.any(limited := abs(span) < np.inf):
            first, factor = [self.batch_value(gain) for gain in self._first[:2]], m.where(limited, span, 1.0)
            ends = [(m.minimum(g / factor, g * factor), m.maximum(g / factor, g * factor)) for g in first]
            bounds = [(m.where(limited, low, -np.inf), m.where(limited, high, np.inf)) for low, high in ends]
        return (
            1.0 - self._period * bandwidth,
            forgetting,
            resolution if np.any(resolution) else None,
            force,
            rate,
            bounds,
            self.batch_value(self._highest),
        )

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The reference model is stable and does not oscillate."""
        if not (values["bandwidth"] * self._period < 1).all():
            limit = f"below 1/period = {1 / self._period:g} rad/s"
            raise invalid("bandwidth", values["bandwidth"].tolist(), limit)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One sample."""
        m = self.math
        decay, forgetting, resolution, least, slowest, bounds, highest = self.values(context)
        y, data, rate = inputs["measured_force"], memory["data"], memory["rate"]
        if resolution is not None:
            y = rounded(y, resolution, m)
        phi, target, learn, after = regressor_step(data, inputs["controller_output"], y, decay, self._prefilter, m)
        rate = rate + _SMOOTHING * ((after[4] - data[4]) / self._period - rate)
        learn = learn & (abs(after[4]) >= least) & (abs(rate) >= slowest)
        kept: dict[str, Any] = {"rate": rate, "data": after}
        if "mode" in inputs:
            running = inputs["mode"] < 0.5
            learn = learn & running
            kept = self.choose(running, kept, memory)
        estimate, diagonal, upper = rls_step(
            memory["theta"], memory["diagonal"], memory["upper"], phi, target, forgetting
        )
        diagonal = [m.minimum(d, highest) for d in diagonal]
        if bounds is not None:
            within = [m.minimum(m.maximum(g, low), high) for g, (low, high) in zip(estimate, bounds, strict=False)]
            estimate = [*within, estimate[2]]
        # Infinity minus infinity is not a number, so one comparison catches both NaN and overflow.
        total = estimate[0] + estimate[1] + estimate[2]
        learn = learn & (total - total == 0)
        learnt = self.choose(learn, {"theta": estimate, "diagonal": diagonal, "upper": upper}, memory)
        return {**learnt, **kept}

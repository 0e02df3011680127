"""Force control by invariance of the measured force: relative degree 4, with bouncing reduction (Sec. 3.7)::

    y = F - F_bar <= 0,    F = -dx/C_T,    dx = h(s) dx_bar,    h(s) = w^2/(s^2 + 2 z w s + w^2)

    y'''  = -w^2 xbar'/C_T - w^2 y' - 2 z w y''                                                (3.62)*, (3.87)*
    y^(4) = -w^2 xbar''/C_T - w^2 y'' - 2 z w y'''                                                     (3.65)*

The control is xbar'', integrated twice. At rest F = F_bar for any assumed compliance (3.63). y' and y'' come from one
of::

    model        x' and x'' of h(s), driven by the command:  y' = -x'/C_T, y'' = -x''/C_T                (3.62)*
    difference   differences of the measured force                                                       (3.87)*
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.force.adaptive_force_law import AdaptiveLawConfig
from forcectl.force.invariance.functions import (
    FLOAT_MATH,
    alpha_for_rate,
    alpha_for_uncertainty,
    invariance_4,
    least_gamma,
)
from forcectl.force.law import ForceLaw, LawConfig
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory
from forcectl.plant.drives.position_loop import first_order_hold, second_order
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.quadratic_program import Status

DERIVATIVES = ("model", "difference")
_NOT_FINITE = float(Status.NOT_FINITE)


def fourth_derivative(
    state: Sequence[BatchValue], alpha: BatchValue, gamma: BatchValue, upper: BatchValue, m: Any = np
) -> tuple[BatchValue, BatchValue]:
    """y^(4) of the law, and Phi of the virtual state on which it depends.

    y^(4) is `upper` while Phi(xi_hat) < 0, else gamma (3.30), (3.78). While y > 0 falls, the same for -y (3.85).

    Args:
        state: y, y', y'', y'''.
        alpha: >= 0.
        gamma: < 0.
        upper: > 0.
        m: numpy, or `FLOAT_MATH` for floats.
    """
    y, *rates = state
    side = m.where((y > 0) & (rates[0] < 0), -1.0, 1.0)
    phi = invariance_4((side * y, *(side * (1 + alpha) * rate for rate in rates)), gamma, m)
    return side * m.where(phi < 0, upper, gamma), phi


def speed_window(
    y: BatchValue,
    absent: BatchValue,
    desired: BatchValue,
    c: BatchValue,
    w: BatchValue,
    z: BatchValue,
    least: BatchValue,
    limit: BatchValue,
    m: Any = np,
) -> tuple[BatchValue, BatchValue]:
    """Smallest and largest velocity of the command [m/s] when y' and y'' are differences of the measured force.

    Without contact the force does not respond, and a = c y4/w^2 + 2 z w v (3.65)* grows without bound at speeds above
    v_u = c `|y4|`/(2 z w^3). In contact the speed is at most 3 v_u, and changes the force in 2 z/w by at most 0.6 of
    the reference or of the error, whichever is larger. The approach without contact is slower: v_u, and a quarter
    instead of 0.6. So are retreats and motion at y > 0: a tenth of v_u plus the speed that changes the force by the
    error in 2 z/w. There is no retreat without contact while y < 0.

    Args:
        y: F - F_bar [N].
        absent: whether there is no contact.
        desired: F_bar [N].
        c: C_T_hat [m/N].
        w, z: of the lag from command to force.
        least: the smaller of `|gamma|` and the largest y^(4) [N/s^4].
        limit: speed limit of the command [m/s].
        m: numpy, or `FLOAT_MATH` for floats.
    """
    unstable = 0.5 * c * least / (z * w * w * w)
    per_newton = 0.5 * c * w / z
    size = per_newton * m.maximum(abs(desired), abs(y))
    speed = m.minimum(limit, m.minimum(3.0 * unstable, 0.6 * size))
    approach = m.minimum(speed, m.minimum(unstable, 0.25 * size))
    back = m.minimum(speed, 0.1 * unstable + per_newton * abs(y))
    low = -m.where(y > 0, back, m.where(absent, approach, speed))
    return low, m.where((y < 0) & absent, 0.0, back)


class FourthDegreeForceLaw(ForceLaw):
    """Invariance force controller of relative degree 4 for n independent force loops.

    ```
    name: FourthDegreeForceLaw
    input_ports: [desired_force, measured_force, compliance (optional)]
    output_ports: [displacement_command, invariance_function, status]
    parameters: [gamma, upper, alpha, bandwidth, damping_ratio, acceleration_limit, speed_limit, rest_region,
    lower_limit, upper_limit, compliance (optional)]
    ```

    desired_force, measured_force: shape (n,) [N].
    compliance: shape (n,), C_T_hat [m/N], > 0; the port exists when no `compliance` is given, else it is a parameter.
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    invariance_function: shape (n,), Phi of the virtual state at the tick [N].
    status: shape (n,), 0, or `Status.NOT_FINITE` while the command brakes and holds [1].
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): gamma [N/s^4] < 0; upper [N/s^4] > 0, the largest y^(4), `|gamma|` when not given;
    alpha [1] >= 0 of the virtual state; bandwidth w [rad/s] and damping_ratio z [1] of the lag between command and
    measured force; acceleration_limit [m/s^2] > 0 and speed_limit [m/s] > 0 of the command (with differences, never
    above `speed_window`); rest_region [N] >= 0, force error within which the command brakes and rests; lower_limit and
    upper_limit [m] of the command; compliance C_T_hat [m/N] > 0.

    The velocity of the command never jumps, except to zero at a limit of the command. A force or compliance that is not
    a number brakes the command within the acceleration limit and holds it. With differences, a measured force below
    rest_region counts as lost contact: a retreat stops, and the command approaches slowly, down to the lower limit.

    Range of use, with differences on the default plant and gamma = -1e5: stiffness 1e3 to 1e6 N/m. A slip of sticking
    joints (0.1 mm of command: 1 N at 1e4 N/m, up to 5 N at 1e6 N/m) causes a limit cycle where its force exceeds
    rest_region. So do C_T_hat three times too large, alpha = 0 and gamma = -1e7. With a much smaller `|gamma|`, or a
    bandwidth above that of the plant, joints stay in static friction.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, see `SampledBlock`.

    Args:
        derivatives: "model" or "difference", see the module's documentation.
    """

    port_units = {"invariance_function": "N"}

    def __init__(
        self,
        size: int,
        *,
        gamma: ArrayLike,
        alpha: ArrayLike,
        bandwidth: ArrayLike,
        damping_ratio: ArrayLike = 1.0,
        upper: ArrayLike | None = None,
        compliance: ArrayLike | None = None,
        acceleration_limit: ArrayLike = np.inf,
        speed_limit: ArrayLike = np.inf,
        rest_region: ArrayLike = 0.0,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        derivatives: str = "difference",
        period: float = 0.002,
    ):
        if derivatives not in DERIVATIVES:
            raise unknown("derivatives", str(derivatives), DERIVATIVES)
        self._from_model = derivatives == "model"
        if upper is None:
            upper = -batch_values(f"{type(self).__name__}.gamma", gamma, size, "negative and finite")
        parameters = {
            "gamma": BatchParameter(gamma, "negative and finite", "N/s^4"),
            "upper": BatchParameter(upper, "positive and finite", "N/s^4"),
            "alpha": BatchParameter(alpha, "not negative", "1"),
            "bandwidth": BatchParameter(bandwidth, "positive and finite", "rad/s"),
            "damping_ratio": BatchParameter(damping_ratio, "positive and finite", "1"),
            "acceleration_limit": BatchParameter(acceleration_limit, "positive", "m/s^2"),
            "speed_limit": BatchParameter(speed_limit, "positive", "m/s"),
            "rest_region": BatchParameter(rest_region, "not negative", "N"),
        }
        own = ("model_position", "model_velocity") if self._from_model else ("last_force", "last_rate", "samples")
        super().__init__(
            size,
            parameters,
            dict.fromkeys(("invariance_function", "status", "velocity", *own), 0.0),
            period,
            lower_limit=lower_limit,
            upper_limit=upper_limit,
            compliance=compliance,
            shows=("invariance_function", "status"),
        )
        if size == 1:
            self.math = FLOAT_MATH

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The limits are in order, alpha is finite."""
        super().check_together(values)
        if not np.isfinite(values["alpha"]).all():
            raise invalid("alpha", values["alpha"].tolist(), "finite")

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """The parameters, and the sampled h(s) for a command that is linear between ticks, entry by entry."""
        models = []
        for w, z in zip(np.ravel(values[3]), np.ravel(values[4]), strict=True):
            phi, start, change = first_order_hold(*second_order(float(w), float(z)), self._period)
            models.append(np.concatenate([phi.ravel(), start.ravel(), change.ravel()]))
        return *values, tuple(self.batch_value(entry) for entry in np.transpose(models))

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m, period = self.math, self._period
        gamma, upper, alpha, w, z, limit, speed, rest, lowest, highest, *fixed, model = self.values(context)
        x, v = memory["displacement_command"], memory["velocity"]
        desired, force = inputs["desired_force"], inputs["measured_force"]
        compliance = fixed[0] if fixed else inputs["compliance"]
        good = (abs(desired) < np.inf) & (abs(force) < np.inf) & (compliance > 0.0) & (compliance < np.inf)
        force, desired, c = m.where(good, force, 0.0), m.where(good, desired, 0.0), m.where(good, compliance, 1.0)

        y = force - desired
        if self._from_model:
            position, rate = memory["model_position"], memory["model_velocity"]
            y1, y2 = -rate / c, -w * (w * (x - position) - 2 * z * rate) / c
        else:
            samples = memory["samples"]
            y1 = m.where(samples > 0, (force - memory["last_force"]) / period, 0.0)
            y2 = m.where(samples > 1, (y1 - memory["last_rate"]) / period, 0.0)
            samples = m.where(good, m.minimum(samples + 1.0, 2.0), 0.0)
            own = {"last_force": force, "last_rate": y1, "samples": samples}
        y3 = -w * (w * v / c + w * y1 + 2 * z * y2)
        y4, phi = fourth_derivative((y, y1, y2, y3), alpha, gamma, upper, m)
        a = -c * (y4 / (w * w) + y2 + 2 * z * y3 / w)
        good = good & (abs(a) < np.inf) & (phi - phi == 0)
        a = m.where(good & (abs(y) >= rest), a, -v / period)
        low, high = -speed, speed
        if not self._from_model:
            low, high = speed_window(y, force <= rest, desired, c, w, z, m.minimum(-gamma, upper), speed, m)
        a = m.minimum(m.maximum(a, (low - v) / period), (high - v) / period)
        a = m.minimum(m.maximum(a, -limit), limit)

        after = x + period * (v + 0.5 * period * a)
        inside = m.minimum(m.maximum(after, lowest), highest)
        velocity = m.where(inside == after, v + period * a, 0.0)
        if self._from_model:
            p11, p12, p21, p22, g1, g2, d1, d2 = model
            change = inside - x
            own = {
                "model_position": p11 * position + p12 * rate + g1 * x + d1 * change,
                "model_velocity": p21 * position + p22 * rate + g2 * x + d2 * change,
            }
        return {
            "displacement_command": inside,
            "invariance_function": m.where(good, phi, 0.0),
            "status": m.where(good, 0.0, _NOT_FINITE),
            "velocity": velocity,
            **own,
        }


@dataclass(kw_only=True)
class FourthDegreeInvarianceConfig(Config, LawConfig, in_batches=True):
    """Scenario part `!FourthDegreeInvariance`: invariance of the measured force, of relative degree 4. (Sec. 3.7)"""

    gamma: float = key(
        -1e5, "fourth derivative of the force when it brakes", unit="N/s^4", bounds="from -1e12 to -0.001", each=True
    )
    upper: float | None = key(
        None, "largest fourth derivative of the force; null: -gamma", unit="N/s^4", bounds="positive", each=True
    )
    alpha: float | None = key(
        None,
        "factor of the virtual state, larger: earlier braking; null: 3, or from compliance_ratio and force_rate "
        "(3.81)*, (3.84)*",
        bounds="not negative",
        each=True,
    )
    compliance_ratio: float = key(
        1.0,
        "largest over smallest possible total compliance (3.82); above 1 gamma is checked, too (3.67)*",
        bounds="at least 1",
    )
    force_rate: float | None = key(
        None,
        "largest rate of the force that is desired at the force error force_rate_error; gives alpha; null: not used",
        unit="N/s",
        bounds="positive",
    )
    force_rate_error: float | None = key(
        None,
        "force error at which force_rate is the largest desired rate of the force; null: not used",
        unit="N",
        bounds="positive",
    )
    bandwidth: float | None = key(
        None,
        "bandwidth w of the lag from command to measured force; null: that of the force sensor",
        unit="rad/s",
        bounds="positive",
        each=True,
    )
    damping_ratio: float = key(
        1.0, "damping ratio z of the lag from command to measured force", unit="1", bounds="from 0.01 to 10", each=True
    )
    derivatives: str = key(
        "difference", "source of the force's derivatives: model of the lag, or measured force", choices=DERIVATIVES
    )
    compliance_error: float = key(
        1.0, "modelled total compliance relative to the true one, C_T_hat / C_T", bounds="from 0.001 to 1000", each=True
    )
    acceleration_limit: float = key(
        0.1, "largest acceleration of the displacement command", unit="m/s^2", bounds="positive", each=True
    )
    speed_limit: float = key(
        np.inf,
        "largest speed of the displacement command; with differences `speed_window` limits it further",
        unit="m/s",
        bounds="at least 0.00001",
        each=True,
    )
    rest_region: float = key(
        0.3, "force error within which the command brakes and rests", unit="N", bounds="not negative", each=True
    )
    lower_limit: float = key(
        -0.1, "lower limit of the command, into the surface", unit="m", bounds="from -10 to -0.000001", each=True
    )
    upper_limit: float = key(
        0.1, "upper limit of the command, off the surface", unit="m", bounds="from 0.000001 to 10", each=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.force_rate is None) != (self.force_rate_error is None):
            raise BadInputError(" must be given with force_rate, or neither of them", key="force_rate_error")
        if self.alpha is None or self.compliance_ratio == 1:
            return
        if not np.all(self.alpha > (least := self.compliance_ratio - 1)):
            raise invalid("alpha", self.alpha, f"above {least:g}, compliance_ratio - 1 (3.84)*: else contact bounces")

    def chosen_alpha(self) -> ArrayLike:
        """The factor alpha of the virtual state: as given, else from rate and compliance ratio, else as in Fig. 3.10.

        For a batch with several gammas, one for each.
        """
        if self.alpha is not None:
            return self.alpha
        if self.force_rate is None or self.force_rate_error is None:
            return 3.0 if self.compliance_ratio == 1 else alpha_for_uncertainty(self.compliance_ratio)
        error, rate = self.force_rate_error, self.force_rate
        for_rates = [alpha_for_rate(4, gamma, error, rate) for gamma in np.ravel(self.gamma)]
        alphas = [alpha_for_uncertainty(self.compliance_ratio, each) for each in for_rates]
        return alphas[0] if np.ndim(self.gamma) == 0 else alphas

    def _check_gamma(self, model: PlantModel, bandwidth: BatchValue) -> None:
        """BadInputError unless acceleration_limit suffices to brake with gamma at the largest possible compliance."""
        if self.compliance_ratio == 1:
            return
        largest = self.compliance_ratio * self.compliance_error * model.total_compliance
        least = least_gamma(bandwidth, self.damping_ratio, largest, self.acceleration_limit)
        for gamma, limit in zip(batch_values("gamma", self.gamma, model.size).tolist(), least.tolist(), strict=True):
            if gamma < limit:
                text = f"at least {limit:.4g}, the braking by acceleration_limit at the largest compliance (3.67)*"
                raise invalid("gamma", gamma, text)

    def law(self, model: PlantModel, compliance: ArrayLike | None) -> FourthDegreeForceLaw:
        """The block with this total compliance C_T_hat [m/N], or with a port for it (None).

        Raises:
            BadInputError: acceleration_limit is too small for gamma at the largest possible compliance.
        """
        bandwidth = model.sensor_bandwidth if self.bandwidth is None else self.bandwidth
        self._check_gamma(model, bandwidth)
        return FourthDegreeForceLaw(
            model.size,
            gamma=self.gamma,
            upper=self.upper,
            alpha=self.chosen_alpha(),
            bandwidth=bandwidth,
            damping_ratio=self.damping_ratio,
            compliance=compliance,
            acceleration_limit=self.acceleration_limit,
            speed_limit=self.speed_limit,
            rest_region=self.rest_region,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            derivatives=self.derivatives,
            period=model.period,
        )


@dataclass(kw_only=True)
class AdaptiveFourthDegreeInvarianceConfig(AdaptiveLawConfig, FourthDegreeInvarianceConfig):
    """Scenario part `!AdaptiveFourthDegreeInvariance`: `!FourthDegreeInvariance`, compliance estimated on line."""

    compliance_error: float = key(
        2 / 3,
        "initial estimate of the environment's compliance over its true value, C_E_hat / C_E; "
        "1/1.5: stiffness 50 % too high",
        bounds="from 0.001 to 1000",
        each=True,
    )

"""Force control with a disturbance observer, for a position-controlled robot::

    d[k]      = d[k-1] + (-C_T_hat F[k] - x_m[k] - d[k-1]) g Ts/(1 + g Ts)                              observer
    x_m[k]    = x_m[k-1] + (dx_bar[k-1] - x_m[k-1]) Ts/(T_m + Ts)                               nominal model of the lag
    dx_bar[k] = -C_T_hat F_r[k] - d[k],    F_r[k] = F_r[k-1] + (F_bar[k] - F_r[k-1]) w Ts/(1 + w Ts)        prefilter

d is the difference, as a displacement, between the measured force and the one that the model predicts for the command:
an offset of the surface, friction of the drives, a wrong compliance. It is subtracted from the command. The limited
command enters the model, so that a limit does not wind up the observer. Bandwidths g and w are two degrees of
freedom.

Sources: K. Ohnishi, M. Shibata and T. Murakami, Motion control for advanced mechatronics, IEEE/ASME Transactions on
Mechatronics 1(1), 1996; review with the force loop: E. Sariyildiz, R. Oboe and K. Ohnishi, Disturbance observer-based
robust control and its applications: 35th anniversary overview, IEEE Transactions on Industrial Electronics 67(3), 2020.
There the robot is acceleration-controlled, here position-controlled: the nominal plant is the compliance behind a lag
T_m.

Stability on the ideal plant F[k] = -dx_bar[k-1]/C_T with T_m = 0: the pole of the observer is 1 - (C_T_hat/C_T)
g Ts/(1 + g Ts), stable if and only if::

    C_T_hat/C_T < 2 (1 + g Ts)/(g Ts)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.force.law import ForceLaw, LawConfig, low_pass
from forcectl.framework.batch import BatchParameter, BatchValue
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace


class DisturbanceObserverForceLaw(ForceLaw):
    """Feed-forward force control by the contact's compliance, with a disturbance observer, for n independent loops.

    ```
    name: DisturbanceObserverForceLaw
    input_ports: [desired_force, measured_force, compliance (optional)]
    output_ports: [displacement_command, disturbance]
    parameters: [observer_bandwidth, reference_bandwidth, model_lag, lower_limit, upper_limit, compliance (optional)]
    ```

    desired_force, measured_force: shape (n,) [N].
    compliance: shape (n,), C_T_hat [m/N], > 0; the port exists when no `compliance` is given, else it is a parameter.
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    disturbance: shape (n,), d [m]; positive: the measured force is smaller than the modelled one.
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): observer_bandwidth g [rad/s] and reference_bandwidth w [rad/s], positive and
    finite, model_lag T_m [s] >= 0, lower_limit and upper_limit of dx_bar [m], compliance C_T_hat [m/N] > 0.

    A force that is not a number holds the command and all states.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, see `SampledBlock`.
    """

    port_units = {"disturbance": "m"}

    def __init__(
        self,
        size: int,
        *,
        observer_bandwidth: ArrayLike,
        reference_bandwidth: ArrayLike,
        model_lag: ArrayLike = 0.0,
        compliance: ArrayLike | None = None,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        period: float = 0.002,
    ):
        parameters = {
            "observer_bandwidth": BatchParameter(observer_bandwidth, "positive and finite", "rad/s"),
            "reference_bandwidth": BatchParameter(reference_bandwidth, "positive and finite", "rad/s"),
            "model_lag": BatchParameter(model_lag, "not negative", "s"),
        }
        super().__init__(
            size,
            parameters,
            dict.fromkeys(("disturbance", "expected_displacement", "expected_force"), 0.0),
            period,
            lower_limit=lower_limit,
            upper_limit=upper_limit,
            compliance=compliance,
            shows=("disturbance",),
        )

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m, period = self.math, self._period
        observer, reference, lag, lower, upper, *given = self.values(context)
        compliance = given[0] if given else inputs["compliance"]
        desired, force = inputs["desired_force"], inputs["measured_force"]
        good = (abs(desired) < np.inf) & (abs(force) < np.inf) & (abs(compliance) < np.inf)
        desired, force = m.where(good, desired, 0.0), m.where(good, force, 0.0)
        expected = low_pass(memory["expected_displacement"], memory["displacement_command"], lag, period)
        disturbance = low_pass(memory["disturbance"], -compliance * force - expected, 1 / observer, period)
        wanted = low_pass(memory["expected_force"], desired, 1 / reference, period)
        free = -compliance * wanted - disturbance
        new = {
            "displacement_command": m.minimum(m.maximum(free, lower), upper),
            "disturbance": disturbance,
            "expected_displacement": expected,
            "expected_force": wanted,
        }
        return self.choose(good & (abs(free) < np.inf), new, memory)


@dataclass(kw_only=True)
class DisturbanceObserverConfig(Config, LawConfig, in_batches=True):
    """Scenario part `!DisturbanceObserver`: feed-forward by the contact's compliance, with a disturbance observer."""

    observer_bandwidth: float = key(
        1.5, "bandwidth g of the disturbance observer", unit="rad/s", bounds="positive", each=True
    )
    reference_bandwidth: float = key(
        1.5, "bandwidth w of the filter of the desired force", unit="rad/s", bounds="positive", each=True
    )
    model_lag: float | None = key(
        None,
        "time constant T_m of the modelled lag from the command to the measured force; null: the sensor's lag",
        unit="s",
        bounds="from 0 to 1",
        each=True,
    )
    compliance_error: float = key(
        1.0, "modelled total compliance relative to the true one, C_T_hat / C_T", bounds="from 0.001 to 1000", each=True
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

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth [rad/s] of the nominal closed loop."""
        return self.reference_bandwidth

    def law(self, model: PlantModel, compliance: ArrayLike | None) -> DisturbanceObserverForceLaw:
        """The block with this modelled total compliance [m/N], or with an input port for it (None)."""
        return DisturbanceObserverForceLaw(
            model.size,
            observer_bandwidth=self.observer_bandwidth,
            reference_bandwidth=self.reference_bandwidth,
            model_lag=model.sensor_lag if self.model_lag is None else self.model_lag,
            compliance=compliance,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )

    def sampled_response(self, model: PlantModel) -> StateSpace:
        """From the measured force to displacement and rate of the command."""
        return self.law(model, self.compliance_error * model.total_compliance).sampled_response()

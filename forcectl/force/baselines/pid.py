"""Explicit PI and PID force control with feed-forward, for a position-controlled robot::

    dx_bar = -C_T_hat [ (K_P + K_I Ts/(1 - z^-1) + K_D (1 - z^-1)/(Ts + T_D - T_D z^-1)) e + K_F F_r ],    e = F_bar - F
    F_r[k] = F_r[k-1] + (F_bar[k] - F_r[k-1]) Ts/(T_F + Ts)

Sources: R. Volpe and P. Khosla, A theoretical and experimental investigation of explicit force control strategies for
manipulators, IEEE Transactions on Automatic Control 38(11), 1993: the strategies P, PI, PID with feed-forward, and the
need to filter the derivative. J. De Schutter and H. Van Brussel, Compliant robot motion II, International Journal of
Robotics Research 7(4), 1988: the force loop around a position loop, scaled by the compliance of the contact.

At a limit of the command the integral stops (anti-windup by clamping). The block is `LinearForceLaw`, whose equations
these are with scaled gains.

Stability on the ideal plant F[k] = -dx_bar[k-1]/C_T, with r = C_T_hat/C_T and without derivative: z^2 + (r K_P - 1 +
r K_I Ts) z - r K_P = 0 has its roots inside of the unit circle if and only if::

    K_I > 0,    r K_P > -1,    r (2 K_P + K_I Ts) < 2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forcectl.errors import invalid
from forcectl.force.law import LinearLawConfig
from forcectl.force.linear_law import LinearForceLaw
from forcectl.framework.fields import Config, key
from forcectl.plant.plant_model import PlantModel


@dataclass(kw_only=True)
class PidConfig(Config, LinearLawConfig, in_batches=True):
    """Scenario part `!Pid`: explicit PI or PID control of the force, with feed-forward."""

    proportional_gain: float = key(
        0.5, "proportional gain K_P of the force error", unit="1", bounds="from 0 to 100", each=True
    )
    integral_gain: float = key(
        2.25, "integral gain K_I of the force error", unit="1/s", bounds="from 0 to 10000", each=True
    )
    derivative_gain: float = key(
        0.0, "derivative gain K_D of the force error", unit="s", bounds="from 0 to 10", each=True
    )
    derivative_filter: float = key(
        0.02, "time constant T_D of the derivative's filter", unit="s", bounds="from 0 to 100", each=True
    )
    feed_forward: float = key(
        0.0,
        "feed-forward gain K_F of the desired force; 1: the depth modelled for it, 0: none",
        unit="1",
        bounds="from 0 to 10",
        each=True,
    )
    feed_forward_filter: float = key(
        0.0,
        "time constant T_F of the feed-forward's filter of the desired force; 0: none",
        unit="s",
        bounds="not negative",
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.proportional_gain == self.integral_gain == self.feed_forward == 0:
            allowed = "above zero without proportional_gain and feed_forward: else the law does not press"
            raise invalid("integral_gain", self.integral_gain, allowed)

    def unused(self) -> tuple[list[str], str]:
        """Filters whose signal has no gain, and why they are unused."""
        gains = {"derivative_filter": self.derivative_gain, "feed_forward_filter": self.feed_forward}
        return [name for name, gain in gains.items() if not np.any(gain)], "the gain of the signal that it filters is 0"

    def reference_model_bandwidth(self) -> float | None:
        """Pole K_I/(1 + K_P) [rad/s] of the loop around F = -dx/C_T in continuous time, without derivative."""
        return self.integral_gain / (1 + self.proportional_gain)

    def law(self, model: PlantModel) -> LinearForceLaw:
        """The block."""
        compliance = self.compliance_error * model.total_compliance
        gains = (self.proportional_gain, self.integral_gain, self.derivative_gain)
        return LinearForceLaw(
            model.size,
            gains=[-compliance * gain for gain in gains],
            derivative_filter=self.derivative_filter,
            feed_forward=compliance * self.feed_forward,
            feed_forward_filter=self.feed_forward_filter,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )

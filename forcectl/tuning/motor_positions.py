"""VRFT on motor positions: the record of an experiment with the effect of friction left out::

    C_rho (h e_v) = x_m + C_R_hat (h y)

x_m is the displacement of the motors along n, C_R_hat the compliance that is fed back by (4.12), h the joint-reference
filter with the command delay. Without friction x_m = h dx_bar, and this is VRFT with both sides filtered by h. With
friction the motors do not follow the command, and VRFT on the command uses a motion that did not happen; the motor
positions are the input that acted. So it is VRFT of the record u = x_m + C_R_hat (h y), y = h y.

The gains are those for an arm without friction. Where they differ from gains tuned on the command, drives were in
static friction during the record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.framework.batch import check
from forcectl.framework.fields import Config, key
from forcectl.plant.drives.position_loop import LONGEST_COMMAND_DELAY, second_order, zero_order_hold

INPUTS = ("command", "motor")
STICKS = 0.05  # relative difference of the two K_P above which drives are reported to stick


@dataclass(kw_only=True)
class DriveFilter(Config):
    """h: the nominal joint-reference filter with its command delay."""

    bandwidth: float = key(75.4, "bandwidth w of the nominal joint-reference filter", unit="rad/s", bounds="positive")
    damping_ratio: float = key(
        1.0, "damping ratio z of the nominal joint-reference filter", unit="1", bounds="from 0.01 to 10"
    )
    delay: float = key(
        0.002,
        "delay of the command before the nominal joint-reference filter",
        unit="s",
        bounds=f"not negative, at most {LONGEST_COMMAND_DELAY:g}",
    )

    def response(self, values: ArrayLike, period: float) -> Array:
        """h of a signal (k,) that was zero before its first sample, sampled every `period` [s]."""
        a, b = zero_order_hold(*second_order(self.bandwidth, self.damping_ratio), period)
        ticks = round(self.delay / period)  # the period of a record need not divide the delay
        below = np.poly(a)
        # Of x[k+1] = A x + B u, y = [1 0] x.
        above = np.array([b[0, 0], a[0, 1] * b[1, 0] - a[1, 1] * b[0, 0]])
        return np.asarray(lfilter(np.concatenate([np.zeros(1 + ticks), above]), below, np.asarray(values, dtype=float)))


def motor_record(motor: ArrayLike, y: ArrayLike, *, robot_compliance: float, period: float) -> tuple[Array, Array]:
    """Input and output of VRFT on motor positions; h is the nominal filter.

    Args:
        motor: x_m, shape (k,) [m], from its value at rest.
        y: force (k,) [N], from its value at rest.
        robot_compliance: C_R_hat of (4.12) [m/N], 0 where it was not fed back.
        period: Ts [s].

    Raises:
        BadInputError: not as many samples of both.
    """
    check("robot_compliance", robot_compliance, "not negative")
    motor, filtered = np.asarray(motor, dtype=float), DriveFilter().response(y, period)
    if motor.shape != filtered.shape:
        raise BadInputError(f"motor has {motor.size} samples and y has {filtered.size}: must be as many")
    return motor + robot_compliance * filtered, filtered


def disagreement(command: float, motor: float) -> float:
    """Relative difference of a gain found on commands from the one found on motor positions; infinite for 0 there."""
    return abs(command / motor - 1.0) if motor else float("inf")

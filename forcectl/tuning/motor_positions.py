"""VRFT on motor positions: the record of an experiment without what friction did in it::

    C_rho (h e_v) = x_m + C_R_hat (h y)

x_m is the displacement of the motors along n, C_R_hat the compliance that is fed back by (4.12), h the joint-reference
filter with the command delay. Without friction x_m = h dx_bar, and this is VRFT with both sides behind h. With friction
the command is not the input that acted, and VRFT on it learns from motion that never was; the motors tell what acted.
So it is VRFT of the record u = x_m + C_R_hat (h y), y = h y.

It tunes for an arm without friction. Where the gains of the two differ, drives stuck in the record.
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
STICKS = 0.05  # share by which K_P may differ, before drives are said to stick


@dataclass(kw_only=True)
class DriveFilter(Config):
    """h as it is known: the nominal joint-reference filter with its command delay."""

    bandwidth: float = key(75.4, "w of the filter", unit="rad/s", bounds="positive")
    damping_ratio: float = key(1.0, "z of the filter", unit="1", bounds="from 0.01 to 10")
    delay: float = key(0.002, "command delay", unit="s", bounds=f"not negative, at most {LONGEST_COMMAND_DELAY:g}")

    def response(self, values: ArrayLike, period: float) -> Array:
        """h of a signal (k,) that was zero before its first sample, sampled every `period` [s]."""
        a, b = zero_order_hold(*second_order(self.bandwidth, self.damping_ratio), period)
        ticks = round(self.delay / period)  # a record may have any period
        below = np.poly(a)
        # Of x[k+1] = A x + B u, y = [1 0] x.
        above = np.array([b[0, 0], a[0, 1] * b[1, 0] - a[1, 1] * b[0, 0]])
        return np.asarray(lfilter(np.concatenate([np.zeros(1 + ticks), above]), below, np.asarray(values, dtype=float)))


def motor_record(motor: ArrayLike, y: ArrayLike, *, robot_compliance: float, period: float) -> tuple[Array, Array]:
    """The input and the output that VRFT is given; h is the nominal filter.

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
    """By how much a gain found on commands is off that found on motor positions, as a share of the latter."""
    return abs(command / motor - 1.0) if motor else float("inf")

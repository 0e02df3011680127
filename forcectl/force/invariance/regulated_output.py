"""Outputs that are brought to a set point without overshoot: the force through the compliance, Cartesian coordinates.

force        y = -dx_bar - C_T_hat F_bar,    y'' = -dx_bar''                                    (3.44), (3.50)
coordinate   y = x - x_d,                    y'' = x''                                          (3.37)
angle        the same with the angle of the tool about an axis
side force   a coordinate into a second surface with x_d = C_22 F_2 + C_21 F_bar; the force then has y - C_12 F_2
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from forcectl.arrays import Vector
from forcectl.force.invariance.force_law import fall, one_step_acceleration
from forcectl.framework.batch import SCALAR_MATH


class Regulated(NamedTuple):
    """One output at one tick: y [m], y' [m/s], the y'' it asks for and that it allows at most, in SI units."""

    y: float
    rate: float
    wish: float
    bound: float


class ReferenceState(NamedTuple):
    """What following a reference remembers: the desired force [N], and its first and second differences."""

    desired: float
    slope: float
    bend: float


@dataclass(frozen=True)
class RegulatedCoordinate:
    """A Cartesian coordinate of the TCP, or an angle of it, that goes to a set point beside the force (3.37).

    Attributes:
        axis: unit vector in W, (3,); of a coordinate perpendicular to n, and each to those of its kind.
        displacement: set point along it, or about it, from the start [m or rad].
        gamma: deceleration towards it [m/s^2 or rad/s^2], < 0.
        turns: whether it is an angle about the axis.
        force: F_2, that a surface across the axis carries at this displacement [N].
        coupling: C_21 = C_12, by which the robot gives way along one of the axis and -n under a force along the other
            [m/N].
    """

    axis: Vector
    displacement: float
    gamma: float
    turns: bool = False
    force: float = 0.0
    coupling: float = 0.0

    @property
    def row(self) -> Vector:
        """The axis as a spatial one, rotations first, (6,)."""
        return np.concatenate([self.axis, np.zeros(3)] if self.turns else [np.zeros(3), self.axis])

    def regulate(self, x: float, v: float, desired: float, period: float) -> Regulated:
        """At displacement x [m or rad] and speed v [m/s or rad/s] beside a desired force F_bar [N]."""
        y = x - self.displacement - self.coupling * desired
        a = one_step_acceleration(y, v, self.gamma, -self.gamma, period, SCALAR_MATH)
        return Regulated(y, v, a, a)


def regulate_force(
    x: float,
    v: float,
    desired: float,
    compliance: float,
    past: ReferenceState,
    gamma: float,
    upper: float,
    period: float,
    nominal: float | None = None,
) -> tuple[Regulated, ReferenceState]:
    """The force, as `InvarianceForceLaw` regulates it: a falling reference is followed with its speed.

    As `InvarianceCorrection` does with a nominal law, which is limited only as far as y <= 0 asks for it (3.18).

    Args:
        x, v: displacement dx_bar along n and its rate [m, m/s].
        desired: F_bar [N].
        compliance: C_T_hat [m/N].
        past: of the tick before.
        gamma: deceleration towards the constraint [m/s^2], < 0.
        upper: largest acceleration away from rest [m/s^2], > 0.
        period: tick [s].
        nominal: -dx_bar'' of a nominal law [m/s^2]; None: there is none.
    """
    slope, bend, falls, retreat = fall(desired, *past, compliance, -gamma, period, SCALAR_MATH)
    y, least = -compliance * desired - x, gamma + retreat
    if nominal is not None:
        upper = -least if y > 0 else math.inf
    a = one_step_acceleration(y, falls - v, least, upper, period, SCALAR_MATH) - retreat
    return Regulated(y, falls - v, a if nominal is None else nominal, a), ReferenceState(desired, slope, bend)

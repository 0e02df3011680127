"""Outputs that are brought to a set point without overshoot: the force (by the compliance) and Cartesian coordinates.

force        y = -dx_bar - C_T_hat F_bar,    y'' = -dx_bar''                                    (3.44), (3.50)
coordinate   y = x - x_d,                    y'' = x''                                          (3.37)
angle        the same with the angle of the tool about an axis
side force   a coordinate into a second surface with x_d = C_22 F_2 + C_21 F_bar; y of the force is then y - C_12 F_2
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
    """One output at one tick: y [m], y' [m/s], the wanted y'' and the largest allowed y'', in SI units."""

    y: float
    rate: float
    desired_acceleration: float
    bound: float


class ReferenceState(NamedTuple):
    """Memory for following a reference: the desired force [N], and its first and second differences."""

    desired: float
    slope: float
    bend: float


@dataclass(frozen=True)
class RegulatedCoordinate:
    """A Cartesian coordinate of the TCP, or an angle of it, that is regulated to a set point beside the force (3.37).

    Attributes:
        axis: unit vector in W, (3,); perpendicular to the axes of the same kind, that of a coordinate also to n.
        displacement: set point along or about the axis, from the start [m or rad].
        gamma: braking acceleration towards the set point [m/s^2 or rad/s^2], < 0.
        turns: whether it is an angle about the axis.
        force: F_2, the force on a surface across the axis at this displacement [N]; 0: there is none.
        coupling: C_21 = C_12, the displacement of the robot along one of the axis and -n per force along the other
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
        """The output at displacement x [m or rad], speed v [m/s or rad/s] and the desired force F_bar [N]."""
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
    """The force as a regulated output, as in `InvarianceForceLaw`: a falling reference is followed with its speed.

    With a nominal law as in `InvarianceCorrection`: it is limited only as far as y <= 0 requires (3.18).

    Args:
        x, v: displacement dx_bar along n and its rate [m, m/s].
        desired: F_bar [N].
        compliance: C_T_hat [m/N].
        past: of the tick before.
        gamma: braking acceleration towards the constraint [m/s^2], < 0.
        upper: largest acceleration when speeding up [m/s^2], > 0.
        period: tick [s].
        nominal: -dx_bar'' of a nominal law [m/s^2]; None: there is none.
    """
    slope, bend, falls, retreat = fall(desired, *past, compliance, -gamma, period, SCALAR_MATH)
    y, least = -compliance * desired - x, gamma + retreat
    if nominal is not None:
        upper = -least if y > 0 else math.inf
    a = one_step_acceleration(y, falls - v, least, upper, period, SCALAR_MATH) - retreat
    return Regulated(y, falls - v, a if nominal is None else nominal, a), ReferenceState(desired, slope, bend)

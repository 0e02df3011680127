"""Limits of joint positions and speeds as bounds of the joint accelerations u, by invariance.

The method is that of `forcectl.tasks.constraints.base`. Positions (r = 2) are kept with half of the acceleration limit,
so that braking and the return from a violation are always possible. Bounds for speeds (r = 1) and accelerations (r = 0)
follow.
"""

from __future__ import annotations

import math

import numpy as np

from forcectl.arrays import Vector
from forcectl.force.invariance.force_law import one_step_acceleration
from forcectl.framework.batch import SCALAR_MATH, SMALL_BATCH
from forcectl.framework.kernels import largest, smallest
from forcectl.robot.model import JointLimits

_GRADUAL = 0.9  # share of the braking in the speed profile; the rest lets braking begin and end gradually
_NEAR = 0.05  # [rad] distance to a position limit below which a joint counts as less able to move


def bounded_acceleration(y: float, rate: float, gamma: float, period: float, approach: float = 0.0) -> float:
    """The bound a(y, y') of y'' for constraints of relative degree 2, without a limit of the approach speed.

    Args:
        y: constraint output.
        rate: y'.
        gamma: braking, < 0.
        period: tick Ts [s].
        approach: time constant T of `gradual_acceleration` [s]; 0: braking begins and ends within a tick.

    Returns:
        at least gamma where the constraint holds and can be kept with gamma; down to 2 gamma where it cannot, which
        happens by the curvature of one tick; within +-gamma where it is violated. Infinity, no bound, for a y of minus
        infinity; NaN for arguments that are not finite.
    """
    if not math.isfinite(y + rate):  # comparisons below would give a finite bound
        return math.inf if y == -math.inf and math.isfinite(rate) else math.nan
    bound: float = one_step_acceleration(y, rate, gamma, -gamma if y > 0.0 else math.inf, period, SCALAR_MATH)
    if y > 0.0:
        return bound
    if bound > gamma:
        return min(bound, max(gradual_acceleration(y, rate, gamma, approach), gamma)) if approach > 0.0 else bound
    # The larger root a of Phi(y + Ts y' + Ts^2 a/2, y' + Ts a) = 0: braking that starts late by a part of a tick.
    half = rate / period - 0.5 * gamma
    square = half * half - (rate * rate - 2.0 * gamma * (y + period * rate)) / period**2
    root = math.sqrt(square) - half if square >= 0.0 else 2.0 * gamma
    return max(min(root, gamma), 2.0 * gamma)


def gradual_acceleration(y: float, rate: float, gamma: float, approach: float) -> float:
    """The y'' with which y' approaches a speed profile w with the time constant T, without a jump of y''.

        y'' = w'(-y) (-y') + (w(-y) - y')/T,    w(d) = d/T up to d = g T^2,    (g (2 d - g T^2))^(1/2) beyond

    w is the speed that braking at g = 0.9 `|gamma|` can stop within the distance d; near the end it decays with T.

    Args:
        y: constraint output, <= 0.
        rate: y'.
        gamma: braking, < 0.
        approach: T [s], > 0.
    """
    g = _GRADUAL * -gamma
    corner = g * approach * approach
    if -y <= corner:
        return (-y / approach - 2.0 * rate) / approach
    speed = math.sqrt(g * (-2.0 * y - corner))
    return (speed - rate) / approach - g * rate / speed


class JointBounds:
    """The bounds of all joints.

    Args:
        limits: with finite accelerations, see `checked_limits`.
        period: tick Ts [s].
        approach: time constant T with which positions and speeds approach their limits [s]; 0: one tick.
    """

    def __init__(self, limits: JointLimits, period: float, approach: float = 0.0):
        self._period, self._n = period, len(limits.velocity)
        self._approach, self._slowing = approach, max(approach, period)
        self._change = period / self._slowing * limits.acceleration
        each = (limits.position_lower, limits.position_upper, limits.velocity, limits.acceleration)
        self._low, self._high, self._speed, self._acceleration = each
        self._joints = [limit.tolist() for limit in each]
        # Acceleration from rest towards the speed limit, with the time constant.
        self._most = self._speed / self._slowing
        # Largest gain of speed before braking follows the profile, and the displacement that this takes.
        self._gained = max(1.5 * approach, period) * self._acceleration
        self._tail = 0.25 * approach**2 * self._acceleration
        self._joints += [self._gained.tolist(), self._tail.tolist()]
        # Distance of every joint from the middle of its range within which it can stop from its speed limit; a joint
        # with a limit on one side only has no middle.
        ranged, free = np.isfinite(self._low) & np.isfinite(self._high), np.isinf(self._low) & np.isinf(self._high)
        low, high = (np.where(ranged, limit, 0.0) for limit in (self._low, self._high))
        self._middle = 0.5 * (low + high)
        self._clear = np.where(free, np.inf, 0.5 * (high - low) - self._stopping_distance(self._speed))

    def at(self, q: Vector, v: Vector) -> tuple[Vector, Vector, float]:
        """Lower and upper bounds of u (n,) [rad/s^2], and the largest violation of a position [rad] or speed [rad/s].

        Args:
            q, v: (n,) [rad, rad/s].
        """
        Ts = self._period
        if self._n > SMALL_BATCH and self._unbound(q, v):
            # Braking to rest within a tick is always allowed.
            rest, change = v / -Ts, v / self._slowing
            return (
                np.maximum(np.minimum(-self._most - change, rest), -self._acceleration),
                np.minimum(np.maximum(self._most - change, rest), self._acceleration),
                0.0,
            )
        lower, upper, violation = [], [], 0.0
        # Joint by joint in floats: for one arm a third of the time of numpy.
        for x, rate, low, high, speed, acceleration, gained, tail in zip(
            q.tolist(), v.tolist(), *self._joints, strict=True
        ):
            down = min((-speed - rate) / self._slowing, -rate / Ts)
            up = max((speed - rate) / self._slowing, -rate / Ts)
            # A limit so far away that braking may begin later gives no bound.
            ahead, back = rate + gained, gained - rate
            if x - high + tail + (ahead * (2 * Ts + ahead / (_GRADUAL * acceleration)) if ahead > 0.0 else 0.0) > 0.0:
                up = min(up, bounded_acceleration(x - high, rate, -0.5 * acceleration, Ts, self._approach))
            if low - x + tail + (back * (2 * Ts + back / (_GRADUAL * acceleration)) if back > 0.0 else 0.0) > 0.0:
                down = max(down, -bounded_acceleration(low - x, -rate, -0.5 * acceleration, Ts, self._approach))
            lower.append(max(min(down, acceleration), -acceleration))
            upper.append(max(min(up, acceleration), -acceleration))
            violation = max(violation, x - high, low - x, abs(rate) - speed)
        return np.array(lower), np.array(upper), violation

    def gradual(self, lower: Vector, upper: Vector, last: Vector) -> tuple[Vector, Vector] | None:
        """The bounds, narrowed so that u takes at least T to change from 0 to the acceleration limit of a joint.

        If that leaves no value, the nearest bound; None if T is 0.

        Args:
            lower, upper: of u at this tick (n,) [rad/s^2].
            last: u of the tick before (n,) [rad/s^2].
        """
        if not self._approach:
            return None
        change = self._change
        return np.minimum(np.maximum(lower, last - change), upper), np.maximum(np.minimum(upper, last + change), lower)

    def mobility(self, q: Vector) -> Vector | None:
        """Ability of each joint to move, from 0 at a position limit to 1 away from it (n,) [1]; None: all are 1."""
        distance = np.minimum(self._high - q, q - self._low)
        return None if smallest(distance) >= _NEAR else np.minimum(np.maximum(distance / _NEAR, 0.0), 1.0)

    def _unbound(self, q: Vector, v: Vector) -> bool:
        """Whether all joints are too far from their position limits for a bound, and within their speed limits."""
        speed = np.abs(v)
        # Comparisons with NaN are false.
        if not largest(speed - self._speed) <= 0.0:
            return False
        # The usual case: far enough for any speed.
        if largest(np.abs(q - self._middle) - self._clear) <= 0.0:
            return True
        acceleration = np.minimum(self._high - q, q - self._low)
        return bool(largest(self._stopping_distance(speed) - acceleration) <= 0.0)

    def _stopping_distance(self, speed: Vector) -> Vector:
        """Stopping distance of a joint from a speed that first still grows with full acceleration [rad]."""
        ahead = speed + self._gained
        return self._tail + ahead * (2 * self._period + ahead / (_GRADUAL * self._acceleration))

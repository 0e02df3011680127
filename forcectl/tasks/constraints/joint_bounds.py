"""Limits of joint positions and speeds as bounds of the joint accelerations u, by invariance; see `constraints`.

Positions (r = 2) are kept with half of the acceleration limit, so that braking and the way back are always possible;
then there are speeds (r = 1) and accelerations (r = 0).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from forcectl.force.invariance.force_law import one_step_acceleration
from forcectl.framework.batch import SCALAR_MATH, SMALL_BATCH
from forcectl.framework.kernels import largest
from forcectl.robot.model import JointLimits

Vector = NDArray[np.float64]


def bounded_acceleration(y: float, rate: float, gamma: float, period: float) -> float:
    """The bound a(y, y') of y'' for constraints of relative degree 2, without a limit on how fast they are approached.

    Args:
        y: constraint output.
        rate: y'.
        gamma: braking, < 0.
        period: tick Ts [s].

    Returns:
        at least gamma where the constraint holds and can be kept with gamma; down to 2 gamma where it could not, which
        is what the curvature of one tick leaves; within +-gamma where it is violated. No bound, infinity, for a y of
        minus infinity; NaN for what is no number.
    """
    if not math.isfinite(y + rate):  # comparisons would make some number of it
        return math.inf if y == -math.inf and math.isfinite(rate) else math.nan
    bound: float = one_step_acceleration(y, rate, gamma, -gamma if y > 0.0 else math.inf, period, SCALAR_MATH)
    if bound > gamma or y > 0.0:
        return bound
    # The larger root a of Phi(y + Ts y' + Ts^2 a/2, y' + Ts a) = 0: braking that is late by what a tick has left.
    half = rate / period - 0.5 * gamma
    square = half * half - (rate * rate - 2.0 * gamma * (y + period * rate)) / period**2
    root = math.sqrt(square) - half if square >= 0.0 else 2.0 * gamma
    return max(min(root, gamma), 2.0 * gamma)


class JointBounds:
    """The bounds of all joints.

    Args:
        limits: with finite accelerations, see `checked_limits`.
        period: tick Ts [s].
    """

    def __init__(self, limits: JointLimits, period: float):
        self._period, self._n = period, len(limits.velocity)
        each = (limits.position_lower, limits.position_upper, limits.velocity, limits.acceleration)
        self._low, self._high, self._speed, self._acceleration = each
        self._joints = [limit.tolist() for limit in each]
        # Accelerations that lead from rest to the limit of the speed in a tick.
        self._least, self._most, self._braking = -self._speed / period, self._speed / period, -self._acceleration
        self._tick_speed = period * self._acceleration
        # How far from the middle of its range every joint may be when it is as fast as it can be; a joint with a limit
        # on one side only has no middle.
        ranged, free = np.isfinite(self._low) & np.isfinite(self._high), np.isinf(self._low) & np.isinf(self._high)
        low, high = (np.where(ranged, limit, 0.0) for limit in (self._low, self._high))
        self._middle = 0.5 * (low + high)
        self._clear = np.where(free, np.inf, 0.5 * (high - low) - self._stopping_distance(self._speed))

    def at(self, q: Vector, v: Vector) -> tuple[Vector, Vector, float]:
        """Lower and upper bounds of u (n,) [rad/s^2], and by how much a position [rad] or speed [rad/s] is beyond one.

        Args:
            q, v: (n,) [rad, rad/s].
        """
        Ts = self._period
        if self._n > SMALL_BATCH and self._unbound(q, v):
            change = v / Ts
            return (
                np.maximum(self._least - change, self._braking),
                np.minimum(self._most - change, self._acceleration),
                0.0,
            )
        lower, upper, violation = [], [], 0.0
        # Joint by joint in floats: for an arm a third of the cost of numpy.
        for x, rate, low, high, speed, acceleration in zip(q.tolist(), v.tolist(), *self._joints, strict=True):
            down, up = (-speed - rate) / Ts, (speed - rate) / Ts
            # A limit so far away that after a tick of full acceleration there is a tick left before braking binds
            # nothing.
            ahead, back = rate + Ts * acceleration, Ts * acceleration - rate
            if x - high + (ahead * (2 * Ts + ahead / acceleration) if ahead > 0.0 else 0.0) > 0.0:
                up = min(up, bounded_acceleration(x - high, rate, -0.5 * acceleration, Ts))
            if low - x + (back * (2 * Ts + back / acceleration) if back > 0.0 else 0.0) > 0.0:
                down = max(down, -bounded_acceleration(low - x, -rate, -0.5 * acceleration, Ts))
            lower.append(max(min(down, acceleration), -acceleration))
            upper.append(max(min(up, acceleration), -acceleration))
            violation = max(violation, x - high, low - x, abs(rate) - speed)
        return np.array(lower), np.array(upper), violation

    def _unbound(self, q: Vector, v: Vector) -> bool:
        """Whether all joints are too far from their position limits to be bound, and within their speed limits."""
        speed = np.abs(v)
        # Of a NaN every comparison is false.
        if not largest(speed - self._speed) <= 0.0:
            return False
        # Usually they are so far away that no speed matters.
        if largest(np.abs(q - self._middle) - self._clear) <= 0.0:
            return True
        acceleration = np.minimum(self._high - q, q - self._low)
        return bool(largest(self._stopping_distance(speed) - acceleration) <= 0.0)

    def _stopping_distance(self, speed: Vector) -> Vector:
        """What a joint needs to stop from a speed that a tick at full acceleration still adds to [rad]."""
        ahead = speed + self._tick_speed
        return ahead * (2 * self._period + ahead / self._acceleration)

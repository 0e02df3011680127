"""Reference reset: the state from which a trajectory generator continues when constraints hold back the motion.

The deviation d = x_gen - x of each task is limited (angles in characteristic lengths), with its direction n, L = 1 mm::

    |d| <= L,    n (x_gen' - x') <= k (L - |d|)

Within these limits the generator continues from its own reference. Beyond them the excess along n is subtracted from
position, velocity and acceleration. Beyond L/2 the state also approaches, with the time constant T, a point L ahead of
the motion in the direction of the target, and the motion's speed in that direction. Without that an arm oscillates at
the border of its workspace.

So the reference of a blocked motion slides along with it or comes to rest, without a jump. A reference that started
again from the motion would jump, and so would the joint accelerations, at every start. L is small so that the velocity
due to d, 40 1/s times d by default, stays within what joints can follow near a singular posture. T is long so that an
arm that slides around an obstacle keeps its speed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forcectl.arrays import Vector
from forcectl.framework.kernels import largest

Motion = tuple[Vector, Vector, Vector]  # x, x', x'' of the task coordinates, (k,) each

LENGTH = 1e-3  # [m]
RATE = 80.0  # k [1/s]
TURNING = 0.2  # T [s]
_NEAR = 0.5 * LENGTH
_TINY = 1e-12  # [m]


class ReferenceReset:
    """The rules above.

    Args:
        sizes: number of coordinates of each task.
        scale: converts differences of coordinates to lengths (k,) [1 or m/rad].
        period: tick [s].
    """

    def __init__(self, sizes: Sequence[int], scale: Vector, period: float):
        self._share = 1.0 - np.exp(-period / TURNING)
        self._sizes, self._scale = np.array(sizes), scale
        self._begins = np.cumsum(self._sizes) - self._sizes

    def start(self, motion: Motion, reference: Motion, target: Vector | None) -> Motion:
        """The state from which the next reference starts: `reference` itself within the limits.

        Args:
            motion: commanded for the next tick.
            reference: for the next tick.
            target: of the coordinates (k,); None: unknown.
        """
        scale, (position, velocity, acceleration) = self._scale, reference
        deviation, rate = scale * (position - motion[0]), scale * (velocity - motion[1])
        # The usual case: all tasks together are within the limits.
        if deviation @ deviation <= _NEAR**2 and rate @ rate <= (RATE * _NEAR) ** 2:
            return reference
        distance = np.sqrt(self._sum(deviation * deviation))
        # |d| times the speed along n, and its limit.
        leaving, allowed = self._sum(deviation * rate), RATE * distance * (LENGTH - distance)
        # False where a number is NaN.
        if largest(distance) <= _NEAR and largest(leaving - allowed) <= 0.0:
            return reference
        distance = np.maximum(distance, _TINY)
        share = self._each(np.minimum(LENGTH / distance, 1.0))
        outward = deviation / (scale * self._each(distance))
        beyond = np.maximum(leaving / distance - RATE * np.maximum(LENGTH - distance, 0.0), 0.0)
        gaining = np.where(beyond > 0.0, np.maximum(self._sum(deviation * scale * acceleration) / distance, 0.0), 0.0)
        position = motion[0] + share * (position - motion[0])
        velocity = velocity - self._each(beyond) * outward
        acceleration = acceleration - self._each(gaining) * outward
        blocked = self._each(self._share * np.minimum(np.maximum(2.0 * distance / LENGTH - 1.0, 0.0), 1.0))
        ahead, onward = self._ahead(motion, target)
        return (
            position + blocked * (ahead - position),
            velocity + blocked * (onward - velocity),
            acceleration - blocked * acceleration,
        )

    def _ahead(self, motion: Motion, target: Vector | None) -> tuple[Vector, Vector]:
        """The point L ahead of the motion towards the target, and the speed of the motion in that direction."""
        x, rate, _ = motion
        displacement = np.zeros_like(x) if target is None else target - x
        left = np.sqrt(self._sum((self._scale * displacement) ** 2))
        unknown = self._each(~np.isfinite(left))  # of tasks whose target is not finite
        displacement = np.where(unknown, 0.0, displacement)
        left = np.where(np.isfinite(left), np.maximum(left, _TINY), _TINY)
        onward = np.maximum(self._sum(self._scale**2 * displacement * rate) / left**2, 0.0)
        ahead = x + self._each(np.minimum(LENGTH / left, 1.0)) * displacement
        return ahead, np.where(unknown, rate, self._each(onward) * displacement)

    def _sum(self, values: Vector) -> Vector:
        """Sums over the coordinates of each task."""
        return np.add.reduceat(values, self._begins)

    def _each(self, values: Vector) -> Vector:
        """Values of tasks, repeated for each of their coordinates."""
        return values.repeat(self._sizes)

"""Reference reset: what a trajectory generator continues from when constraints keep the motion from its reference.

Task by task, with the deviation d = x_gen - x (angles in characteristic lengths), its direction n, L = 1 mm::

    |d| <= L,    n (x_gen' - x') <= k (L - |d|)

The generator continues from its own reference; of what is beyond, the part along n is taken from position, velocity and
acceleration. Beyond L/2 they also approach, with the time constant T, a point L ahead of the motion on the way to the
target, and the speed that the motion has on that way: else an arm swings at the border of its workspace.

So the reference of a motion that is blocked slides along with it or comes to rest, without a jump. A jump, as in a
reference that starts anew, is a jump of the acceleration of the joints, at every start. L is small for the pull on the
motion, 40 1/s times d by default, to stay within what joints can follow near a singular posture; T is long for an arm
that slides around an obstacle to keep its speed.
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
        scale: makes differences of coordinates comparable (k,) [1 or m/rad].
        period: tick [s].
    """

    def __init__(self, sizes: Sequence[int], scale: Vector, period: float):
        self._share = 1.0 - np.exp(-period / TURNING)
        self._sizes, self._scale = np.array(sizes), scale
        self._begins = np.cumsum(self._sizes) - self._sizes

    def start(self, motion: Motion, reference: Motion, target: Vector | None) -> Motion:
        """What the next reference starts from: `reference` itself where it is not beyond.

        Args:
            motion: as it will be at the next tick.
            reference: what was asked for.
            target: of the coordinates (k,).
        """
        scale, (position, velocity, acceleration) = self._scale, reference
        way, rate = scale * (position - motion[0]), scale * (velocity - motion[1])
        # Usually all tasks together are near enough and slow enough.
        if way @ way <= _NEAR**2 and rate @ rate <= (RATE * _NEAR) ** 2:
            return reference
        apart = np.sqrt(self._sum(way * way))
        # |d| times the speed along n, and what it may be.
        leaving, allowed = self._sum(way * rate), RATE * apart * (LENGTH - apart)
        # Of a NaN every comparison is false.
        if largest(apart) <= _NEAR and largest(leaving - allowed) <= 0.0:
            return reference
        apart = np.maximum(apart, _TINY)
        share = self._each(np.minimum(LENGTH / apart, 1.0))
        outward = way / (scale * self._each(apart))
        beyond = np.maximum(leaving / apart - RATE * np.maximum(LENGTH - apart, 0.0), 0.0)
        gaining = np.where(beyond > 0.0, np.maximum(self._sum(way * scale * acceleration) / apart, 0.0), 0.0)
        position = motion[0] + share * (position - motion[0])
        velocity = velocity - self._each(beyond) * outward
        acceleration = acceleration - self._each(gaining) * outward
        blocked = self._each(self._share * np.minimum(np.maximum(2.0 * apart / LENGTH - 1.0, 0.0), 1.0))
        ahead, onward = self._ahead(motion, target)
        return (
            position + blocked * (ahead - position),
            velocity + blocked * (onward - velocity),
            acceleration - blocked * acceleration,
        )

    def _ahead(self, motion: Motion, target: Vector | None) -> tuple[Vector, Vector]:
        """The point L ahead of the motion on the way to the target, and what the motion has of speed on that way."""
        x, rate, _ = motion
        way = np.zeros_like(x) if target is None else target - x
        left = np.sqrt(self._sum((self._scale * way) ** 2))
        unknown = self._each(~np.isfinite(left))  # of the tasks whose target is no number
        way, left = np.where(unknown, 0.0, way), np.where(np.isfinite(left), np.maximum(left, _TINY), _TINY)
        onward = np.maximum(self._sum(self._scale**2 * way * rate) / left**2, 0.0)
        return x + self._each(np.minimum(LENGTH / left, 1.0)) * way, np.where(unknown, rate, self._each(onward) * way)

    def _sum(self, values: Vector) -> Vector:
        """Over the coordinates of each task."""
        return np.add.reduceat(values, self._begins)

    def _each(self, values: Vector) -> Vector:
        """A number of each task, for each of its coordinates."""
        return values.repeat(self._sizes)

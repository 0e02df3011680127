"""Reference reset: what a trajectory generator continues from when its last reference was missed, task by task.

Where the motion is within 5 mm of the reference (angles in characteristic lengths), the generator continues from its
own reference. Where constraints made the motion deviate further, it starts anew 5 mm ahead of the motion on the way to
the target, with what the motion has of speed in that direction; without a target from the motion itself. So the motion
slides along what is in its way, and comes to rest where that brings it no closer to the target. To start from the
motion itself always, as Algorithm 2 says, lets an arm oscillate without end at the border of its workspace.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Motion = tuple[Vector, Vector, Vector]  # x, x', x'' of the task coordinates, (k,) each

LENGTH = 5e-3  # [m]
_NEARER = 0.9  # a new start is that share of the length ahead, so that the generator goes on from it for some ticks


class ReferenceReset:
    """The rules above.

    Args:
        sizes: number of coordinates of each task.
        scale: makes differences of coordinates comparable (k,) [1 or m/rad].
    """

    def __init__(self, sizes: Sequence[int], scale: Vector):
        self._sizes, self._scale = np.array(sizes), scale
        self._begins = np.cumsum(self._sizes) - self._sizes

    def start(self, motion: Motion, reference: Motion, target: Vector | None) -> Motion:
        """What the next reference starts from.

        Args:
            motion: as it will be at the next tick.
            reference: what was asked for.
            target: of the coordinates (k,).
        """
        way = self._scale * (motion[0] - reference[0])
        # Usually it is true of all tasks together.
        if way.dot(way) <= LENGTH**2:
            return reference
        followed = self._length(motion[0] - reference[0]) <= LENGTH
        if followed.all():
            return reference
        if target is not None:
            motion = self._ahead(motion, target)
        mask = followed.repeat(self._sizes)
        position, velocity, acceleration = (np.where(mask, *pair) for pair in zip(reference, motion, strict=True))
        return position, velocity, acceleration

    def _ahead(self, motion: Motion, target: Vector) -> Motion:
        x, rate, _ = motion
        way = target - x
        left = self._length(way)
        if not np.isfinite(left).all():
            return motion
        left = np.maximum(left, 1e-12)
        onward = np.maximum(np.add.reduceat(self._scale**2 * way * rate, self._begins) / left**2, 0.0)
        share = np.minimum(_NEARER * LENGTH / left, 1.0)
        return x + share.repeat(self._sizes) * way, onward.repeat(self._sizes) * way, np.zeros_like(x)

    def _length(self, way: Vector) -> Vector:
        """Of a difference of task coordinates, for each task [m]."""
        return np.sqrt(np.add.reduceat((self._scale * way) ** 2, self._begins))

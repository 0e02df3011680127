"""Whether a robot's own readings are fit to move by: numbers, no frozen encoder, no lost samples, near the command.

A controller that integrates its own command does not need readings to compute it, but must not go on moving a robot
that it does not see. So a few bad ticks are passed over, and more of them stop the motion until readings are good.

Bad is, of a joint,
- a position or speed that is not a number;
- a frozen encoder: a position that repeats bit for bit while the joint is commanded faster than `frozen_speed`, and
  from then on until it changes; a lost sample shows as this in all moving joints at once;
- a position further than `largest_error` from the command: the joint does not follow, or the reading jumped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forcectl.lanes import check

Vector = NDArray[np.float64]


class Readings(NamedTuple):
    """What is remembered of the readings from tick to tick.

    position: last one, (n,) [rad]; NaN before the first. good: 1 for a joint whose reading was, else 0, (n,).
    frozen: 1 for a joint whose encoder is, else 0, (n,). gap: ticks since all were good.
    """

    position: Vector
    good: Vector
    frozen: Vector
    gap: float


class ReadingGuard:
    """The rules above.

    Args:
        size: joints n. longest_gap: bad readings that are passed over [s], >= 0. frozen_speed: [rad/s], > 0.
            largest_error: [rad], > 0. period: tick [s].
    """

    def __init__(self, size: int, longest_gap: float, frozen_speed: float, largest_error: float, period: float):
        self._ticks = check("longest_gap", longest_gap, "not negative") / period + 0.5
        self._frozen_speed = check("frozen_speed", frozen_speed, "positive")
        self._ones = np.ones(size)
        self._largest_error = check("largest_error", largest_error, "positive")

    def look(self, past: Readings, position: Vector, velocity: Vector, q: Vector, v: Vector) -> Readings:
        """The readings after a tick.

        Args:
            position, velocity: as read (n,) [rad, rad/s]. q, v: as commanded for this tick (n,).
        """
        error, same = np.abs(position - q), position == past.position
        # Of a NaN every comparison is false: such a reading is not near, and neither frozen nor moving.
        fine = past.gap == 0.0 and error.max() <= self._largest_error and not same.any()
        if fine and math.isfinite(velocity @ velocity):
            return Readings(position, self._ones, past.frozen, 0.0)
        good = error <= self._largest_error
        good &= np.isfinite(velocity)
        read = np.isfinite(position)
        moving = np.abs(v) > self._frozen_speed
        frozen = np.where(read, same & (moving | (past.frozen > 0)), past.frozen > 0)
        good &= ~frozen
        gap = 0.0 if good.all() else past.gap + 1.0
        return Readings(np.where(read, position, past.position), good.astype(float), frozen.astype(float), gap)

    def stops(self, readings: Readings) -> bool:
        """Whether to stop the motion."""
        return readings.gap > self._ticks

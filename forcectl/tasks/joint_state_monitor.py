"""Joint-state monitor: detects measurements that are not finite, frozen, lost, or too far from the command.

A few bad ticks are tolerated; more of them stop the motion until the measurements are good again. The measurement of a
joint is bad if its position or speed is not finite, or if its position is more than `largest_error` from the command.
It is also bad (frozen) if the position repeats bit for bit while its command moves by more than `frozen_distance`; lost
samples look the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from forcectl.arrays import Vector
from forcectl.framework.batch import batch_values, check
from forcectl.framework.kernels import largest


class Readings(NamedTuple):
    """Memory of the monitor from tick to tick.

    Attributes:
        read_position: last measured position, (n,) [rad]; NaN before the first.
        read_command: commanded position when the measured one last changed, (n,) [rad].
        reading_ok: 1 for a joint whose measurement was good, else 0, (n,).
        reading_gap: number of ticks since all were good.
    """

    read_position: Vector
    read_command: Vector
    reading_ok: Vector
    reading_gap: float


class JointStateMonitor:
    """The rules above.

    Args:
        size: joints n.
        longest_gap: longest time of bad measurements without a stop [s], >= 0.
        frozen_distance: of the command while a measured position repeats, a number or shape (n,) [rad], > 0.
        largest_error: of a measured position from the command [rad], > 0.
        period: tick [s].
    """

    def __init__(self, size: int, longest_gap: float, frozen_distance: ArrayLike, largest_error: float, period: float):
        self._ticks = check("longest_gap", longest_gap, "not negative") / period + 0.5
        self._frozen_distance = batch_values("frozen_distance", frozen_distance, size, "positive")
        self._ones = np.ones(size)
        self._largest_error = check("largest_error", largest_error, "positive")

    def update(self, past: Readings, position: Vector, velocity: Vector, q: Vector) -> Readings:
        """The memory after a tick.

        Args:
            position, velocity: as measured (n,) [rad, rad/s].
            q: as commanded for this tick (n,) [rad].
        """
        error, same = np.abs(position - q), position == past.read_position
        # Comparisons with NaN are false: such a measurement is bad.
        if largest(error) <= self._largest_error and math.isfinite(velocity.dot(velocity)) and not largest(same):
            return Readings(position, q, self._ones, 0.0)
        read = np.isfinite(position)
        command = np.where(same | ~read, past.read_command, q)
        good = (error <= self._largest_error) & np.isfinite(velocity)
        good &= np.abs(q - command) <= self._frozen_distance
        gap = 0.0 if good.all() else past.reading_gap + 1.0
        return Readings(np.where(read, position, past.read_position), command, good.astype(float), gap)

    def stops(self, readings: Readings) -> bool:
        """Whether to stop the motion."""
        return readings.reading_gap > self._ticks

"""Progress of a task: whether it has reached its target, or the distance to the target has stopped decreasing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from forcectl.arrays import Vector
from forcectl.framework.batch import check
from forcectl.framework.kernels import largest, smallest

_NEARER = 0.9  # of the smallest distance so far: a distance below this counts as progress
_SLOW = 5.0  # [1/s] at a reached target the speed is at most the tolerance times this


class Progress(NamedTuple):
    """Memory and result from tick to tick.

    Attributes:
        target: (k,); NaN before the first.
        nearest: distance when it last decreased by a tenth, in tolerances [1].
        ticks: number of ticks since then.
        reached, stalled: 1 or 0.
    """

    target: Vector
    nearest: float
    ticks: float
    reached: float
    stalled: float


class TaskProgress:
    """Compares task coordinates with their target at every tick.

    The distance is the largest error of a coordinate in units of its tolerance. A target counts as unreachable
    (`stalled`) once the distance has not decreased by a tenth for `patience`. A change of the target starts this again.

    Args:
        tolerance: of each coordinate (k,) [m or rad], > 0.
        patience: longest time without progress [s], > 0.
        period: tick [s].
    """

    def __init__(self, tolerance: Vector, patience: float, period: float):
        self._scale = 1.0 / tolerance
        self._patience = check("patience", patience, "positive") / period

    def update(self, past: Progress, target: Vector, value: Vector, rate: Vector) -> Progress:
        """The progress after a tick; unchanged while the target is not finite.

        Args:
            target: (k,).
            value, rate: of the coordinates (k,).
        """
        distance = largest(np.abs((value - target) * self._scale))
        if distance != distance:
            return past
        if not smallest(target == past.target):
            past = Progress(target, np.inf, 0.0, 0.0, 0.0)
        speed = largest(np.abs(rate * self._scale))
        reached = distance <= 1.0 and speed <= _SLOW
        nearer = distance < _NEARER * past.nearest
        nearest, ticks = (distance, 0.0) if nearer else (past.nearest, past.ticks + 1.0)
        return Progress(target, nearest, ticks, float(reached), float(not reached and ticks > self._patience))

"""Progress of a task: whether its target is reached, or the distance to it has stopped decreasing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from forcectl.arrays import Vector
from forcectl.framework.batch import check
from forcectl.framework.kernels import largest, smallest

_NEARER = 0.9  # of the smallest distance so far: what counts as coming nearer
_SLOW = 5.0  # [1/s] at the target the speed is below the tolerance times this


class Progress(NamedTuple):
    """What is remembered from tick to tick.

    Attributes:
        target: (k,).
        nearest: distance when it last became smaller by a tenth, in tolerances [1].
        ticks: since then.
        reached, stalled: 1 or 0.
    """

    target: Vector
    nearest: float
    ticks: float
    reached: float
    stalled: float


class TaskProgress:
    """Compares task coordinates with their target at every tick.

    The distance is the largest of the coordinates', each in units of its tolerance. A target counts as unreachable
    (`stalled`) once the distance has not become smaller by a tenth for `patience`; a target that changes starts anew.

    Args:
        tolerance: of each coordinate (k,) [m or rad], > 0.
        patience: [s], > 0.
        period: tick [s].
    """

    def __init__(self, tolerance: Vector, patience: float, period: float):
        self._scale = 1.0 / tolerance
        self._patience = check("patience", patience, "positive") / period

    def look(self, past: Progress, target: Vector, value: Vector, rate: Vector) -> Progress:
        """The progress after a tick; as before while the target is not a number.

        Args:
            target: (k,).
            value, rate: of the coordinates (k,).
        """
        apart = largest(np.abs((value - target) * self._scale))
        if apart != apart:
            return past
        if not smallest(target == past.target):
            past = Progress(target, np.inf, 0.0, 0.0, 0.0)
        speed = largest(np.abs(rate * self._scale))
        reached = apart <= 1.0 and speed <= _SLOW
        nearer = apart < _NEARER * past.nearest
        nearest, ticks = (apart, 0.0) if nearer else (past.nearest, past.ticks + 1.0)
        return Progress(target, nearest, ticks, float(reached), float(not reached and ticks > self._patience))

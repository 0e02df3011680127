"""What the guard knows of a command: its size in a tick, and which way the normals are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from forcectl.arrays import Array
from forcectl.force.guard.limits import Numbers


class DisplacementSteps:
    """Steps of the displacement commands of force laws, one along the normal of each loop.

    Args:
        largest: of a sound law in a tick [m].
        slow: into the surface, at which a command is caught up with [m].
    """

    away = True

    def __init__(self, largest: float, slow: float):
        self._largest, self._slow = largest, slow

    def depths(self, command: Numbers) -> Numbers:
        """The command itself."""
        return command

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether no step is larger than one of a sound law; no for one that is not a number."""
        for after, before in zip(wanted, command, strict=True):
            if not -self._largest <= after - before <= self._largest:
                return False
        return True

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """One step: slow into the surface, the largest out of it."""
        slow, largest = self._slow * factor, self._largest
        after = [max(min(w, c + largest), c - slow) for w, c in zip(wanted, command, strict=True)]
        return after, after == wanted

    def back(self, command: Numbers, distance: float) -> Numbers:
        """Every loop away from its surface."""
        return [c + distance for c in command]


class JointSteps:
    """Steps of joint commands.

    Args:
        largest: of a sound controller in a tick, shape (n,) [rad].
        slow: at which a command is caught up with, shape (n,) [rad].
        start: of the joints, shape (n,) [rad].
        rows: displacement along each normal per joint motion, at the start, shape (k, n) [m/rad].
        direction: joint motion along all normals, from joint positions (n,): shape (n,) [rad/m].
    """

    def __init__(self, largest: Array, slow: Array, start: Array, rows: Array, direction: Callable[[Array], Array]):
        self._largest, self._slow, self._start, self._rows = largest, slow, start, rows
        self._direction = direction
        self.away = len(rows) > 0

    def depths(self, command: Numbers) -> Numbers:
        """Along the tangents at the start."""
        return (self._rows @ (np.array(command) - self._start)).tolist() if self.away else []

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether no joint moves by more than in a sound tick; no for one that is not a number."""
        return bool((np.abs(np.subtract(wanted, command)) <= self._largest).all())

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """One step on the straight way."""
        way = np.subtract(wanted, command)
        share = float(np.abs(way / (factor * self._slow)).max())
        return (wanted, True) if share <= 1.0 else ((np.array(command) + way / share).tolist(), False)

    def back(self, command: Numbers, distance: float) -> Numbers:
        """All tools away from their surfaces."""
        here = np.array(command)
        return (here + distance * self._direction(here)).tolist()

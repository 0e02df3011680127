"""Steps of a command per tick that the guard accepts, and its directions along the surface normals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from forcectl.arrays import Array
from forcectl.force.guard.limits import Numbers


class DisplacementSteps:
    """Steps of the displacement commands of force laws, one along the normal of each loop.

    Args:
        largest: largest accepted step in a tick [m].
        slow: step into the surface in a tick, with which the guarded command catches up [m].
    """

    away = True

    def __init__(self, largest: float, slow: float):
        self._largest, self._slow = largest, slow

    def depths(self, command: Numbers) -> Numbers:
        """The command itself."""
        return command

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether every step is within the largest accepted one; false if one is not a number."""
        for after, before in zip(wanted, command, strict=True):
            if not -self._largest <= after - before <= self._largest:
                return False
        return True

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """One step: at most the slow one into the surface, at most the largest one out of it."""
        slow, largest = self._slow * factor, self._largest
        after = [max(min(w, c + largest), c - slow) for w, c in zip(wanted, command, strict=True)]
        return after, after == wanted

    def back(self, command: Numbers, distance: float) -> Numbers:
        """The command of every loop moved away from its surface."""
        return [c + distance for c in command]


class JointSteps:
    """Steps of joint commands.

    Args:
        largest: largest accepted step of each joint in a tick, shape (n,) [rad].
        slow: step of each joint in a tick, with which the guarded command catches up, shape (n,) [rad].
        start: joint positions at the start, shape (n,) [rad].
        rows: displacement along each normal per joint motion, at the start, shape (k, n) [m/rad].
        direction: function of the joint positions (n,): joint motion along all normals, shape (n,) [rad/m].
    """

    def __init__(self, largest: Array, slow: Array, start: Array, rows: Array, direction: Callable[[Array], Array]):
        self._largest, self._slow, self._start, self._rows = largest, slow, start, rows
        self._direction = direction
        self.away = len(rows) > 0

    def depths(self, command: Numbers) -> Numbers:
        """Displacements by the constant Jacobian of the start."""
        return (self._rows @ (np.array(command) - self._start)).tolist() if self.away else []

    def within(self, wanted: Sequence[float], command: Sequence[float]) -> bool:
        """Whether every joint is within its largest accepted step; false if one is not a number."""
        return bool((np.abs(np.subtract(wanted, command)) <= self._largest).all())

    def approach(self, wanted: Numbers, command: Numbers, factor: float) -> tuple[Numbers, bool]:
        """One step on the straight line in joint space."""
        difference = np.subtract(wanted, command)
        share = float(np.abs(difference / (factor * self._slow)).max())
        return (wanted, True) if share <= 1.0 else ((np.array(command) + difference / share).tolist(), False)

    def back(self, command: Numbers, distance: float) -> Numbers:
        """The command with all tools moved away from their surfaces."""
        here = np.array(command)
        return (here + distance * self._direction(here)).tolist()

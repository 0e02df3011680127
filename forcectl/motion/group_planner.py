"""Trajectory states of several groups of components, planned group by group and kept as one array; see `trajectory`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forcectl.errors import invalid
from forcectl.framework.batch import check_count
from forcectl.motion.trajectory import Limits, Motion, Plan, Planner, Target, TrajectoryState, begin_again

Array = NDArray[np.float64]


class GroupPlanner:
    """Planners of groups of components.

    Holds no state but the last plans, to save time: results depend on the arguments only.

    Args:
        sizes: how many components, one after the other, each group has; checked.
        synchronized: see `Planner`.
    """

    def __init__(self, sizes: Sequence[int], synchronized: bool = True):
        self._sizes, self._synchronized = tuple(sizes), synchronized
        ends = np.cumsum(self._sizes).tolist()
        self._groups = [slice(end - size, end) for end, size in zip(ends, self._sizes, strict=True)]
        self._planners = [Planner(size, synchronized) for size in self._sizes]
        self._key, self._plans = np.full((10, sum(sizes)), np.nan), list[Plan]()
        self._arrival = self._braking = self._unit = np.empty(0)

    def __deepcopy__(self, memo: dict[int, Any]) -> GroupPlanner:
        """Another one that has planned nothing."""
        return GroupPlanner(self._sizes, self._synchronized)

    def follow(self, state: Array, start: Sequence[Array] | None, target: Array, limits: Array, period: float) -> Array:
        """The trajectory states one `period` [s] later.

        Args:
            state: rows as the fields of `TrajectoryState`, (16, n).
            start: the motion to go on from, rows as the fields of `Motion`, (3, n); that of the trajectory state when
                None, or in groups where it is not finite.
            target: rows as the fields of `Target`, (3, n).
            limits: rows as the fields of `Limits`, (3, n).
        """
        given = state[:3] if start is None else np.array(start)
        led = (given != state[:3]).any()
        changed = (np.concatenate([target, limits]) != state[7:13]).any()
        if not (led or changed or state[4].any()):
            return self._go_on(state, period)
        parts = []
        for place, planner in zip(self._groups, self._planners, strict=True):
            own = TrajectoryState(*state[:, place])
            if led and np.isfinite(given[:, place]).all():
                own = begin_again(own, Motion(*given[:, place]))
            parts.append(planner.follow(own, Target(*target[:, place]), Limits(*limits[:, place]), period))
        return np.concatenate(parts, axis=1)

    def _go_on(self, state: Array, period: float) -> Array:
        """On the same plans."""
        if (self._key != state[6:]).any():
            self._key = state[6:].copy()
            pairs = zip(self._groups, self._planners, strict=True)
            self._plans = [planner.plan_of(self._key[:, place]) for place, planner in pairs]
            self._arrival = np.concatenate([plan.arrival for plan in self._plans])
            self._braking = np.concatenate([plan.braking for plan in self._plans])
            self._unit = np.tile(np.concatenate([plan.unit for plan in self._plans]), (3, 1))
        after, elapsed = state.copy(), state[5] + period
        for place, plan in zip(self._groups, self._plans, strict=True):
            after[:3, place] = plan.rows(elapsed.item(place.start))
        after[:3] *= self._unit
        after[3], after[4], after[5] = self._arrival <= elapsed, self._braking, elapsed
        return after


def check_groups(sizes: Sequence[int] | None, size: int) -> list[int]:
    """The sizes, one group of all when None; BadInputError unless they add up to `size`."""
    if sizes is None:
        return [size]
    if sum(check_count("groups", count) for count in sizes) != size:
        raise invalid("groups", list(sizes), f"numbers that add up to {size}")
    return list(sizes)

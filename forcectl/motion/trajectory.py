"""On-line trajectories with limited velocity, acceleration and jerk, planned by Ruckig from any state of motion.

A trajectory state is a plan from a state of motion (its origin) to a target, and the time elapsed along it. The plan is
used until the target or a limit changes; then the motion of this tick is the origin of a new plan. `Planner` keeps the
last plan only to save time: it can be computed from the numbers of a `TrajectoryState`.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.containers import namedview

from forcectl.arrays import Array, Mask
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values, check_count
from forcectl.framework.kernels import largest, smallest
from forcectl.motion.group_planner import GroupPlan, GroupPlanner

SLOWEST = 100.0  # longest time from rest to the velocity limit [s]
_SAME = 1e-9  # difference of two motions, relative to the size of the numbers, up to which they count as equal


class Motion(NamedTuple):
    """A state of motion of n components, each of shape (n,), in units u [m] or [rad] per component."""

    position: Array  # [u]
    velocity: Array  # [u/s]
    acceleration: Array  # [u/s^2]


class Limits(NamedTuple):
    """Limits of a trajectory in every component, each of shape (n,); see `limits_of`."""

    velocity: Array  # [u/s]
    acceleration: Array  # [u/s^2]
    jerk: Array  # [u/s^3]


class Target(NamedTuple):
    """Target of a trajectory, each of shape (n,).

    Attributes:
        position: [u].
        velocity: at that position [u/s].
        velocity_mode: above 0.5 in components that go to the velocity at any position; their target position is
            ignored [1].
    """

    position: Array
    velocity: Array
    velocity_mode: Array


_Rows: Any = namedview(
    "_Rows",
    [
        *("position", "velocity", "acceleration"),  # of this tick
        "arrived",  # 1 in components that have reached their target
        "braking",  # 1 in components that could not be planned
        "elapsed",  # since the origin [s]; what follows determines the plan
        "coasting",  # 1 in components that passed their target before this plan and keep its velocity
        *("target_position", "target_velocity", "velocity_mode"),
        *("velocity_limit", "acceleration_limit", "jerk_limit"),
        *("origin_position", "origin_velocity", "origin_acceleration"),
    ],
)
_ARRIVED, _BRAKING, _ELAPSED, _COASTING = 3, 4, 5, 6
_MOTION, _TARGET, _LIMITS, _ORIGIN = (slice(start, start + 3) for start in (0, 7, 10, 13))
_PROBLEM = slice(6, 16)  # all that determines a plan


class TrajectoryState(_Rows):
    """A motion of n components and the plan it follows, as rows of an array (16, n); from `begin` and `Planner.follow`.

    Rows by name: position, velocity, acceleration, arrived, braking; elapsed since the origin [s]; coasting,
    target_position and what else determines the plan. state[:] is the array.
    """

    @property
    def motion(self) -> Motion:
        """The motion of this tick."""
        return Motion(*self[_MOTION])


def time_to_speed(velocity: Any, acceleration: Any, jerk: Any) -> Any:
    """Time from rest to the velocity limit; numbers, or arrays of one shape [s]."""
    ramp = np.minimum(acceleration / jerk, np.sqrt(velocity / jerk))
    return ramp + velocity / (ramp * jerk)


def check_limits_together(limits: Limits) -> None:
    """BadInputError when the velocity limit is out of reach: more than 100 s from rest with the other two."""
    velocity, acceleration, jerk = limits
    slowest = float(np.max(time_to_speed(velocity, acceleration, jerk)))
    if not slowest <= SLOWEST:
        raise BadInputError(
            f"velocity_limit = {velocity.tolist()}: takes {slowest:.3g} s from rest with acceleration_limit = "
            f"{acceleration.tolist()} and jerk_limit = {jerk.tolist()}: must take at most {SLOWEST:g} s"
        )


def limits_of(size: int, velocity: ArrayLike, acceleration: ArrayLike, jerk: ArrayLike) -> Limits:
    """Limits of n components, checked; each one number or shape (n,) [u/s, u/s^2, u/s^3].

    Raises:
        BadInputError: wrong length, not positive and finite, or a velocity limit more than 100 s from rest.
    """
    given = {"velocity_limit": velocity, "acceleration_limit": acceleration, "jerk_limit": jerk}
    limits = Limits(*(batch_values(name, value, size, "positive and finite") for name, value in given.items()))
    check_limits_together(limits)
    for limit in limits:
        limit.flags.writeable = False  # planners do not notice a change
    return limits


def begin(position: ArrayLike, velocity: ArrayLike = 0.0, acceleration: ArrayLike = 0.0) -> TrajectoryState:
    """A trajectory state at this motion, each one number or shape (n,) [u, u/s, u/s^2], whose target is its position.

    It has no plan yet: the first `Planner.follow` makes one.

    Raises:
        BadInputError: a number that is not finite, or a wrong length.
    """
    size = np.size(position)
    given = {"position": position, "velocity": velocity, "acceleration": acceleration}
    p, v, a = (batch_values(name, value, size) for name, value in given.items())
    none = np.zeros(size)
    # Limits of zero mark a state without a plan.
    return TrajectoryState(np.array([p, v, a, none, none, none, none, p, none, none, none, none, none, p, v, a]))


class Plan:
    """Trajectories of groups of components, one after the other.

    Attributes:
        arrival, braking: as in `GroupPlan`.
        brakes: whether a component brakes.
    """

    def __init__(self, groups: Sequence[slice], plans: Sequence[GroupPlan]):
        self._trajectories = [(group, plan.trajectory) for group, plan in zip(groups, plans, strict=True)]
        self._unit, self.arrival, self.braking = (np.concatenate(rows) for rows in list(zip(*plans, strict=True))[1:])
        self.brakes = largest(self.braking) > 0.0

    @property
    def duration(self) -> float:
        """Time at which the last component is at its target, or at rest [s]."""
        return max(float(trajectory.duration) for _, trajectory in self._trajectories)

    def at(self, time: float) -> Motion:
        """The motion `time` [s] after the start; after the end it continues with the velocity of the target."""
        rows = np.empty((3, len(self.arrival)))
        self.put(rows, np.full(len(self.arrival), time))
        return Motion(*rows)

    def put(self, rows: Array, elapsed: Array) -> None:
        """Put the motion after a time [s] that is the same in a group, (n,), into the rows, (3, n)."""
        for group, trajectory in self._trajectories:
            rows[:, group] = trajectory.at_time(elapsed.item(group.start))
        rows *= self._unit


class Planner:
    """Plans for n components within limits, and follows them.

    Holds no state but the last plan, to save time: results depend on the arguments only.

    Args:
        limits: from `limits_of`.
        synchronized: the components of a group arrive together; from rest they move on a straight line if their limits
            are alike. A group that stops at any position (all in velocity mode, target velocity zero) also does so on a
            straight line. Other components in velocity mode are never synchronised. False: each arrives as early as
            it can.
        groups: how many components, one after the other, are planned together, and apart from those of the other
            groups; None: all of them.

    Raises:
        BadInputError: groups that do not add up to n.
    """

    def __init__(self, limits: Limits, synchronized: bool = True, groups: Sequence[int] | None = None):
        self._given, self._limits = (limits, synchronized, groups), np.array(limits)
        size = len(limits.velocity)
        self._sizes = [size] if groups is None else [check_count("groups", count) for count in groups]
        if sum(self._sizes) != size:
            raise invalid("groups", self._sizes, f"numbers that add up to {size}")
        self._starts = np.cumsum([0, *self._sizes[:-1]])
        self._groups = [slice(a, a + count) for a, count in zip(self._starts.tolist(), self._sizes, strict=True)]
        self._planners = [GroupPlanner(self._limits[:, group], synchronized) for group in self._groups]
        self._plans: list[Any] = [None] * len(self._groups)
        self._problem = np.full((10, size), np.nan)
        self._plan: Any = None
        _planners.add(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Planner:
        """A new planner without a plan."""
        return Planner(*self._given)

    def plan(self, start: Motion, target: Target) -> Plan:
        """The fastest trajectory; from outside the limits, it first returns to within them.

        A component that cannot be planned brakes to rest within the limits; the others continue. Where even braking
        would take more than two hours, the whole group stops at once.

        Args:
            start, target: finite. A target velocity beyond the limit is that limit.

        Raises:
            BadInputError: `start` is not finite.
        """
        self._solve(np.array((np.zeros(len(start[0])), *target, *self._limits, *start)))
        return self._plan

    def follow(
        self, state: TrajectoryState, target: Target, period: float, start: Motion | None = None
    ) -> TrajectoryState:
        """The trajectory state one `period` [s] later.

        Args:
            state: from `begin` or a planner, which may have had other limits.
            target: of this tick. A component with a number that is not finite keeps its last target.
            start: motion to continue from, with the same target. It counts in groups where it is finite and differs
                from the motion of the trajectory state by more than rounding. So a generator whose start is the motion
                after its last command follows one plan as long as its commands are executed exactly.
        """
        now = state[:] if start is None else self._restarted(state[:], np.array(start))
        goal = np.array(target)
        if largest(now[_PROBLEM] != self._problem) or largest(goal != now[_TARGET]) or self._plan.brakes:
            now = self._planned(now, goal)
        after, elapsed = now.copy(), now[_ELAPSED] + period
        self._plan.put(after[_MOTION], elapsed)
        after[_ARRIVED], after[_BRAKING], after[_ELAPSED] = self._plan.arrival <= elapsed, self._plan.braking, elapsed
        return TrajectoryState(after)

    def _restarted(self, state: Array, start: Array) -> Array:
        """The trajectory state, with the motion `start` and without a plan in groups where `start` counts."""
        now = state[_MOTION]
        if not largest(start != now):
            return state
        planned = state[_LIMITS][0] > 0.0
        own = (np.abs(start - now) <= _SAME * (1.0 + np.abs(start))).all(axis=0) & planned
        restarted = self._whole(~own) & ~self._whole(~np.isfinite(start).all(axis=0))
        if not largest(restarted):
            return state
        there = np.zeros(state.shape)
        there[_MOTION], there[_TARGET] = start, state[_TARGET]
        there[_TARGET][0] = np.where(planned, state[_TARGET][0], start[0])
        return np.where(restarted, there, state)

    def _planned(self, state: Array, target: Array) -> Array:
        """The trajectory state with a plan to the target within the limits: its own, or a new one from this motion."""
        target = _next_target(target, state[_TARGET])
        new = (target != state[_TARGET]).any(axis=0)
        again = new | (self._limits != state[_LIMITS]).any(axis=0) | (state[_BRAKING] > 0.0)
        if largest(again):
            here = np.zeros(state.shape)
            here[_MOTION] = here[_ORIGIN] = state[_MOTION]
            here[_COASTING] = np.where(new, 0.0, state[_ARRIVED] * (state[_TARGET][1] != 0.0))
            here[_TARGET], here[_LIMITS] = target, self._limits
            state = np.where(self._whole(again), here, state)
        self._solve(state[_PROBLEM])
        return state

    def _whole(self, some: Any) -> Mask:
        """All components of each group in which one is true."""
        return np.repeat(np.logical_or.reduceat(some, self._starts), self._sizes)

    def _solve(self, problem: Array) -> None:
        """Plan in groups whose problem differs from that of the last plan."""
        new = problem != self._problem
        if largest(new):
            self._plans = [
                planner.plan(problem[:, group]) if largest(new[:, group]) else plan
                for planner, group, plan in zip(self._planners, self._groups, self._plans, strict=True)
            ]
            self._problem, self._plan = problem.copy(), Plan(self._groups, self._plans)


_planners: WeakSet[Planner] = WeakSet()


@atexit.register
def _drop_plans() -> None:
    """Drop Ruckig's objects at exit: its binding prints a long list of those still alive, as in a script's diagram."""
    for planner in list(_planners):
        planner._planners, planner._plans, planner._plan = [], [], None


def _next_target(target: Array, last: Array) -> Array:
    """The target to plan for, finite and in standard form, rows as the fields of `Target`, (3, n)."""
    free = target[2] > 0.5
    if largest(free):
        target[0, free], target[2, free] = 0.0, 1.0
    good = np.isfinite(target)
    return target if smallest(good) else np.where(good.all(axis=0), target, last)

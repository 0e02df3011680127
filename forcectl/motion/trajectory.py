"""On-line trajectories with limited velocity, acceleration and jerk, planned by Ruckig from any state of motion.

A trajectory state is a plan from a state of motion (its origin) to a target, and how far along it the motion is. It
goes on until the target or a limit changes; then the motion of this tick is the origin of a new plan. `Planner` keeps
the last plan only to save time: it follows from the numbers of a `TrajectoryState`.

What Ruckig (0.19) alone does not do: from an arc of a time-optimal trajectory, where every new target finds the motion,
rounding makes it miss the fastest profile once in a hundred times, by up to five seconds. Planning with two jerk limits
that differ by 1e-9 and taking the faster profile finds it. One synchronised plan in 1e4 fails, and is planned without.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values, check_count

Array = NDArray[np.float64]

# Plans stay this far inside the limits, relatively, so that rounding does not break them; and the two limits of jerk.
_MARGIN, _LESS_JERK, _JERK = 1.0 - 1e-9, 1.0 - 2e-9, 1.0 - 1e-9
_POSITION, _VELOCITY = ControlInterface.Position, ControlInterface.Velocity
_TOGETHER, _ALONE = Synchronization.Phase, Synchronization.No
_FASTER = 1e-9  # what counts as a shorter duration [s]
_LONGEST = 7600.0  # a longer duration is an error to Ruckig [s]
_SLOWEST = 100.0  # longest time from rest to the velocity limit [s]
_SAME = 1e-9  # motions that differ by less, relative to the size of the numbers, are one


class Motion(NamedTuple):
    """A state of motion of n components, each of shape (n,), in units u [m] or [rad] per component."""

    position: Array  # [u]
    velocity: Array  # [u/s]
    acceleration: Array  # [u/s^2]


class Limits(NamedTuple):
    """What a trajectory keeps to in every component, each of shape (n,); see `limits_of`."""

    velocity: Array  # [u/s]
    acceleration: Array  # [u/s^2]
    jerk: Array  # [u/s^3]


class Target(NamedTuple):
    """Where to go, each of shape (n,).

    Attributes:
        position: [u].
        velocity: there [u/s].
        velocity_mode: above 0.5 in components that take on the velocity, wherever they are; their position counts for
            nothing [1].
    """

    position: Array
    velocity: Array
    velocity_mode: Array


class TrajectoryState(NamedTuple):
    """A motion and the plan it follows, as arrays of shape (n,); from `begin` and `Planner.follow`."""

    position: Array
    velocity: Array
    acceleration: Array
    arrived: Array  # 1 in components that have reached their target
    braking: Array  # 1 in components that could not be planned
    elapsed: Array  # since the origin [s]; what follows determines the plan
    coasting: Array  # 1 in components that passed their target before this plan and keep its velocity
    target_position: Array
    target_velocity: Array
    velocity_mode: Array
    velocity_limit: Array
    acceleration_limit: Array
    jerk_limit: Array
    origin_position: Array
    origin_velocity: Array
    origin_acceleration: Array

    @property
    def motion(self) -> Motion:
        """The motion of this tick."""
        return Motion(*self[:3])

    @property
    def target(self) -> Target:
        """The target of the plan."""
        return Target(*self[7:10])

    @property
    def limits(self) -> Limits:
        """The limits of the plan."""
        return Limits(*self[10:13])


def check_limits_together(limits: Limits) -> None:
    """BadInputError when the velocity limit is out of reach: more than 100 s from rest with the other two."""
    velocity, acceleration, jerk = limits
    ramp = np.minimum(acceleration / jerk, np.sqrt(velocity / jerk))
    slowest = float(np.max(ramp + velocity / (ramp * jerk)))
    if not slowest <= _SLOWEST:
        raise BadInputError(
            f"velocity_limit = {velocity.tolist()}: takes {slowest:.3g} s from rest with acceleration_limit = "
            f"{acceleration.tolist()} and jerk_limit = {jerk.tolist()}: must take at most {_SLOWEST:g} s"
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
        limit.flags.writeable = False  # trajectory states keep them
    return limits


def begin(position: ArrayLike, velocity: ArrayLike = 0.0, acceleration: ArrayLike = 0.0) -> TrajectoryState:
    """A trajectory state at this motion, each one number or shape (n,) [u, u/s, u/s^2], whose target is its position.

    It has no plan yet: the first `Planner.follow` makes one.

    Raises:
        BadInputError: a number that is not finite, or a wrong length.
    """
    size = np.size(position)
    p, v, a = (
        batch_values(name, value, size)
        for name, value in (("position", position), ("velocity", velocity), ("acceleration", acceleration))
    )
    none = np.zeros(size)
    return TrajectoryState(p, v, a, none, none, none, none, p, none, none, none, none, none, p, v, a)


def begin_again(state: TrajectoryState, motion: Motion) -> TrajectoryState:
    """The trajectory state if `motion` (finite) is its own but for rounding, else one that starts from `motion`.

    The target is kept, if there was a plan to one. So a generator that is led by what became of its last command
    follows one plan as long as that command is carried out.
    """
    if not state.velocity_limit.any():
        return begin(*motion)
    p, v, a = given = np.array(motion)  # a copy
    if (np.abs(given - np.array(state.motion)) <= _SAME * (1.0 + np.abs(given))).all():
        return state
    none = np.zeros(len(p))
    # Limits of zero are those of no plan.
    return TrajectoryState(p, v, a, none, none, none, none, *state.target, none, none, none, p, v, a)


class Plan:
    """A trajectory from one motion to one target.

    Attributes:
        arrival: when each component is at its target, shape (n,) [s]; never (infinite) where it brakes.
        braking: 1 in components that could not be planned and brake to rest, shape (n,).
        unit: what its numbers are multiples of, shape (n,) [u].
    """

    def __init__(self, trajectory: Any, arrival: Sequence[float], brakes: Sequence[bool], unit: Array | None = None):
        self._trajectory = trajectory
        self.unit: Array = np.ones(len(brakes)) if unit is None else unit
        self.arrival: Array = np.array([np.inf if no else time for time, no in zip(arrival, brakes, strict=True)])
        self.braking: Array = np.array(brakes, dtype=float)

    @property
    def duration(self) -> float:
        """When the last component is at its target, or at rest [s]."""
        return float(self._trajectory.duration)

    def at(self, time: float) -> Motion:
        """The motion `time` [s] after the start; after the end, on with the velocity of the target."""
        return Motion(*(np.array(self.rows(time)) * self.unit))

    def rows(self, time: float) -> Sequence[Sequence[float]]:
        """The same as three rows of numbers, in units of `unit`, at less cost."""
        return self._trajectory.at_time(time)


class Planner:
    """Plans for n components.

    Holds no state but the last plan, to save time: results depend on the arguments only.

    Args:
        size: components n.
        synchronized: the components arrive together, and from rest on a straight line if their limits are alike; False:
            each as early as it can. Components in velocity mode are always on their own.
    """

    def __init__(self, size: int, synchronized: bool = True):
        self.size, self.synchronized = check_count("size", size), bool(synchronized)
        self._ruckig, self._input = Ruckig(size), InputParameter(size)
        self._input.synchronization = _ALONE
        self._limits: Limits | None = None
        self._unit: Array | None = None
        self._known: tuple[Array, Plan] | None = None

    def plan(self, start: Motion, target: Target, limits: Limits) -> Plan:
        """The fastest trajectory; from outside the limits, it first returns to within them.

        A component that cannot be planned brakes to rest within the limits; the others go on. From where not even that
        takes less than two hours, all stand still at once.

        Args:
            start, target, limits: finite. A target velocity beyond the limit is that limit.

        Raises:
            BadInputError: `start` is not finite.
        """
        free: list[bool] = (target.velocity_mode > 0.5).tolist()
        brakes = [False] * self.size
        fastest = self._prepare(start, target, limits, free)
        if fastest is None:
            if not np.isfinite(start).all():
                raise invalid("start", [x.tolist() for x in start], "finite")
            brakes = self._out_of_reach(start, target, limits, free)
            target = target._replace(velocity=np.where(brakes, 0.0, target.velocity))
            free = [a or b for a, b in zip(free, brakes, strict=True)]
            fastest = self._prepare(start, target, limits, free)
            if fastest is None:
                brakes = free = [True] * self.size
                still = Motion(start.position, np.zeros(self.size), np.zeros(self.size))
                fastest = self._prepare(still, Target(*still), limits, free)
        arrival = fastest.independent_min_durations
        if self.synchronized and self.size > 1:
            self._input.per_dof_synchronization = [_ALONE if one else _TOGETHER for one in free]
            together = self._calculate()
            self._input.per_dof_synchronization = None
            if together is not None:
                end = together.duration
                arrival = [t if one else end for t, one in zip(arrival, free, strict=True)]
                return Plan(together, arrival, brakes, self._unit)
        return Plan(fastest, arrival, brakes, self._unit)

    def follow(self, state: TrajectoryState, target: Target, limits: Limits, period: float) -> TrajectoryState:
        """The trajectory state one `period` [s] later.

        Args:
            target: of this tick. A component with a number that is not finite keeps its last target.
            limits: of this tick, from `limits_of`.
        """
        target, new = _next_target(state, target)
        if not new.any() and np.array_equal(limits, state.limits) and not state.braking.any():
            return self._go_on(np.array(state), period)
        coasting = np.where(new, 0.0, state.arrived * (state.target_velocity != 0.0))
        unknown = 0.0 * coasting
        anew = (*state.motion, unknown, unknown, unknown, coasting, *target, *limits, *state.motion)
        return self._go_on(np.array(anew), period)

    def _go_on(self, state: Array, period: float) -> TrajectoryState:
        plan, elapsed = self.plan_of(state[6:]), state.item(5, 0) + period
        state[:3], state[3] = plan.at(elapsed), plan.arrival <= elapsed
        state[4], state[5] = plan.braking, elapsed
        return TrajectoryState(*state)

    def plan_of(self, rows: Array) -> Plan:
        """The plan that a trajectory state is on, from the fields of `TrajectoryState` that determine it, (10, n)."""
        if self._known is None or not np.array_equal(self._known[0], rows):
            rows = rows.copy()
            coasting, position, velocity, mode = rows[:4]
            target = Target(position, velocity, np.maximum(mode, coasting))
            self._known = rows, self.plan(Motion(*rows[7:]), target, Limits(*rows[4:7]))
        return self._known[1]

    def _prepare(self, start: Motion, target: Target, limits: Limits, free: list[bool]) -> Any:
        """The fastest trajectory of each component on its own, or None. Leaves all of it in the input."""
        self._take(limits)
        if self._unit is not None:
            start = Motion(*(x / self._unit for x in start))
            target = target._replace(position=target.position / self._unit, velocity=target.velocity / self._unit)
        inputs, fastest, reach = self._input, self._speeds, self._accelerations
        # Lists: they take a tenth of the time of arrays.
        position, velocity, acceleration = [x.tolist() for x in start]
        inputs.current_position, inputs.current_velocity, inputs.current_acceleration = position, velocity, acceleration
        # Outside the limits all of the acceleration is needed.
        inputs.max_acceleration = [
            full if abs(v) > limit or abs(a) > usable else usable
            for v, a, limit, (usable, full) in zip(velocity, acceleration, fastest, reach, strict=True)
        ]
        there = target.position.tolist()
        if any(free):
            there = [here if one else goal for one, here, goal in zip(free, position, there, strict=True)]
        inputs.target_position = there
        wanted = zip(target.velocity.tolist(), fastest, strict=True)
        inputs.target_velocity = [min(max(v, -limit), limit) for v, limit in wanted]
        inputs.per_dof_control_interface = [_VELOCITY if one else _POSITION for one in free]
        tries = []
        for jerk in self._jerks:
            inputs.max_jerk = jerk
            tries.append(self._calculate())
        if None in tries:
            inputs.max_jerk = self._jerks[tries[0] is None]
            return tries[tries[0] is None]
        durations = zip(*(one.independent_min_durations for one in tries), strict=True)
        faster = [full < less - _FASTER for less, full in durations]
        if all(faster):
            return tries[1]
        inputs.max_jerk = [full if better else less for better, less, full in zip(faster, *self._jerks, strict=True)]
        return self._calculate() if any(faster) else tries[0]

    def _take(self, limits: Limits) -> None:
        """Keep the limits as lists, with their margins; of acceleration also as much as can be of use."""
        if self._limits is not None and np.array_equal(limits, self._limits):
            return
        self._limits = limits
        # Ruckig has absolute tolerances, which large numbers miss by rounding: they get a unit, a power of two.
        unit = 2.0 ** np.maximum(np.round(np.log2(limits.velocity)), 0.0)
        self._unit = unit if (unit > 1.0).any() else None
        limits = Limits(*(limit / unit for limit in limits))
        velocity, acceleration, jerk = (limit * _MARGIN for limit in limits)
        # What the velocity limit leaves no room for only makes the numbers worse.
        usable = np.minimum(acceleration, 2.0 * np.sqrt(velocity * jerk))
        self._speeds = velocity.tolist()
        self._accelerations = list(zip(usable.tolist(), acceleration.tolist(), strict=True))
        self._jerks = (limits.jerk * _LESS_JERK).tolist(), (limits.jerk * _JERK).tolist()
        self._input.max_velocity = self._speeds

    def _calculate(self) -> Any:
        trajectory = Trajectory(self.size)
        try:
            result = self._ruckig.calculate(self._input, trajectory)
        except (RuckigError, ValueError):  # its Python side does not know every code of its failures
            return None
        return trajectory if result in (Result.Working, Result.Finished) else None

    def _out_of_reach(self, start: Motion, target: Target, limits: Limits, free: list[bool]) -> list[bool]:
        """Which components in position mode cannot be planned."""
        one, beyond = Planner(1), []
        for s, t, m in zip(*(np.transpose(group)[:, :, None] for group in (start, target, limits)), strict=True):
            trajectory = one._prepare(Motion(*s), Target(*t), Limits(*m), [False])
            # A duration that is too long for several components is given for one.
            beyond.append(trajectory is None or trajectory.duration >= _LONGEST)
        return [a and not b for a, b in zip(beyond, free, strict=True)]


def _next_target(state: TrajectoryState, target: Target) -> tuple[Target, NDArray[np.bool_]]:
    """The target that counts, and in which components it is not that of the trajectory state."""
    now, before = np.array(target), np.array(state.target)
    free = now[2] > 0.5
    now[0, free], now[2, free] = 0.0, 1.0
    now = np.where(np.isfinite(now).all(axis=0), now, before)
    return Target(*now), (now != before).any(axis=0)

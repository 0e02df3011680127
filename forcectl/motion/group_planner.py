"""Plans by Ruckig of components that are planned together.

Two workarounds for Ruckig (0.19). A new target usually comes while the motion is on a time-optimal trajectory. From
there, rounding makes Ruckig miss the fastest profile once in a hundred times, by up to five seconds. Planning with two
jerk limits that differ by 1e-9, and taking the faster profile, finds it. One synchronised plan in 1e4 fails; it is then
planned without synchronisation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from forcectl.arrays import Array
from forcectl.errors import invalid

# Plans stay this far inside the limits, relatively, so that rounding does not exceed them; and the two jerk limits.
_MARGIN, _LESS_JERK, _JERK = 1.0 - 1e-9, 1.0 - 2e-9, 1.0 - 1e-9
_POSITION, _VELOCITY = ControlInterface.Position, ControlInterface.Velocity
_TOGETHER, _ALONE = Synchronization.Phase, Synchronization.No
_LEAST_SHARE = 0.1  # smallest factor on the limits of a component that stops along with a slower one
_FASTER = 1e-9  # what counts as a shorter duration [s]
_LONGEST = 7600.0  # a longer duration is an error to Ruckig [s]


class GroupPlan(NamedTuple):
    """A trajectory of components that are planned together, of shape (n,).

    Attributes:
        trajectory: of Ruckig.
        unit: the unit of its numbers [u].
        arrival: time at which each component is at its target [s]; infinite where it brakes.
        braking: 1 in components that could not be planned and brake to rest.
    """

    trajectory: Any
    unit: Array
    arrival: Array
    braking: Array


class GroupPlanner:
    """Plans for components that are planned together; see `Planner`.

    Rows of limits, start and target are as the fields of `Limits`, `Motion` and `Target`, (3, n).
    """

    def __init__(self, limits: Array, synchronized: bool):
        self._limits, self._size, self._synchronized = limits, limits.shape[1], synchronized
        self._ruckig, self._input = Ruckig(self._size), InputParameter(self._size)
        # Rounding of large numbers exceeds Ruckig's absolute tolerances: they get a larger unit, a power of two.
        self._unit = 2.0 ** np.maximum(np.round(np.log2(limits[0])), 0.0)
        limits = limits / self._unit
        velocity, acceleration, jerk = limits * _MARGIN
        # Acceleration that cannot be reached below the velocity limit only makes the problem ill-conditioned.
        usable = np.minimum(acceleration, 2.0 * np.sqrt(velocity * jerk))
        # Lists: Ruckig takes them in a tenth of the time of arrays.
        self._speeds = velocity.tolist()
        self._accelerations = list(zip(usable.tolist(), acceleration.tolist(), strict=True))
        self._jerks = (limits[2] * _LESS_JERK).tolist(), (limits[2] * _JERK).tolist()
        self._input.synchronization, self._input.max_velocity = _ALONE, self._speeds

    def plan(self, problem: Array) -> GroupPlan:
        """The plan of a problem, rows as in `TrajectoryState` from `coasting` on, (10, n)."""
        coasting, target, start = problem[0], problem[1:4], problem[7:]
        free: list[bool] = (np.maximum(coasting, target[2]) > 0.5).tolist()
        brakes = [False] * self._size
        fastest = self._prepare(start, target, free)
        if fastest is None:
            if not np.isfinite(start).all():
                raise invalid("start", start.tolist(), "finite")
            brakes = self._out_of_reach(start, target, free)
            target = np.where(brakes, 0.0, target)
            free = [a or b for a, b in zip(free, brakes, strict=True)]
            fastest = self._prepare(start, target, free)
            if fastest is None:
                brakes = free = [True] * self._size
                start = np.array([start[0], *np.zeros((2, self._size))])
                fastest = self._prepare(start, start, free)
        arrival = fastest.independent_min_durations
        if self._synchronized and self._size > 1 and not any(brakes) and all(free) and not target[1].any():
            fastest = self._stopped_together(fastest)
            arrival = fastest.independent_min_durations
        elif self._synchronized and self._size > 1:
            self._input.per_dof_synchronization = [_ALONE if one else _TOGETHER for one in free]
            together = self._calculate()
            self._input.per_dof_synchronization = None
            if together is not None:
                fastest, end = together, together.duration
                arrival = [t if one else end for t, one in zip(arrival, free, strict=True)]
        arrival = np.where(brakes, np.inf, arrival)
        return GroupPlan(fastest, self._unit, arrival, np.array(brakes, dtype=float))

    def _prepare(self, start: Array, target: Array, free: list[bool]) -> Any:
        """The fastest trajectory of each component on its own, or None. Leaves all of it in the input."""
        inputs, fastest, reach = self._input, self._speeds, self._accelerations
        position, velocity, acceleration = (start / self._unit).tolist()
        inputs.current_position, inputs.current_velocity, inputs.current_acceleration = position, velocity, acceleration
        # From outside the limits the full acceleration is needed.
        inputs.max_acceleration = [
            full if abs(v) > limit or abs(a) > usable else usable
            for v, a, limit, (usable, full) in zip(velocity, acceleration, fastest, reach, strict=True)
        ]
        there, wanted = (target[:2] / self._unit).tolist()
        if any(free):
            there = [here if one else goal for one, here, goal in zip(free, position, there, strict=True)]
        inputs.target_position = there
        inputs.target_velocity = [min(max(v, -limit), limit) for v, limit in zip(wanted, fastest, strict=True)]
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

    def _stopped_together(self, fastest: Any) -> Any:
        """All stop as slowly as the slowest: scaled jerk and acceleration keep profiles alike and the path straight."""
        inputs, times = self._input, np.array(fastest.independent_min_durations)
        share = np.maximum(times / max(times.max(), _FASTER), _LEAST_SHARE)
        reach = share * inputs.max_acceleration
        inputs.max_acceleration = np.maximum(reach, np.abs(inputs.current_acceleration)).tolist()
        inputs.max_jerk = (share**2 * inputs.max_jerk).tolist()
        together = self._calculate()
        return fastest if together is None else together

    def _calculate(self) -> Any:
        trajectory = Trajectory(self._size)
        try:
            result = self._ruckig.calculate(self._input, trajectory)
        except (RuckigError, ValueError):  # its Python binding lacks some of its error codes
            return None
        return trajectory if result in (Result.Working, Result.Finished) else None

    def _out_of_reach(self, start: Array, target: Array, free: list[bool]) -> list[bool]:
        """Which components in position mode cannot be planned."""
        beyond = []
        for i in range(self._size):
            trajectory = GroupPlanner(self._limits[:, [i]], False)._prepare(start[:, [i]], target[:, [i]], [False])
            # A duration that is too long for several components is given for one.
            beyond.append(trajectory is None or trajectory.duration >= _LONGEST)
        return [a and not b for a, b in zip(beyond, free, strict=True)]

"""Quadratic programs of the reactive controller at one tick: tasks by priority, then null space; (5.14), (5.18)::

    level 1, 2, ...   L of the tasks of that priority (5.16) + damping |u - u_rest|^2/2
    level 1           also w |N (u - u_calm)|^2/2, with the projection N onto the null space of its tasks, w = 0.2
    last level        the criterion, (5.19), (5.20)

The damping makes the optimum unique. It is small (a task moves 0.1 % slower where its singular value is 0.3) except
near a singular posture of the first level, where it grows as in a damped inverse. u_rest = -q'/Ts leads to rest at the
next tick. The term with N changes the optimum only where a row or bound is active: then the tasks deviate, instead of a
strong acceleration of the arm in its null space. With a larger w the tasks deviate more where the null-space motion has
to brake. N u_calm is N u of the tick before, reduced towards zero by half of the change that is allowed for u. The term
is left out where level 1 settles the criterion as well, see `TaskProgram.pose`.

Rows of the joint torques are in the programs only in ticks in which a solution without them exceeds a limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy, deepcopy
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.linalg.lapack import dsyev

from forcectl.arrays import Indices, Vector
from forcectl.errors import BadInputError
from forcectl.framework.kernels import all_finite, is_definite, left_free, smallest
from forcectl.qp.constrained_program import ConstrainedProgram, Outcome, Problem, Smooth
from forcectl.qp.prioritized_program import Level
from forcectl.qp.solvers import Solver
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.constraints.base import ConstraintSet, Rows
from forcectl.tasks.coordinates import ArmTask, TaskState
from forcectl.tasks.cost import Deviation, TaskCost, Weights
from forcectl.tasks.null_space import AnyCriterion, JointSpeed, stepped

_NO_MEMORY = np.zeros(0)
_BESIDE = 0.2  # weight of accelerations in the null space; of those of the tasks about 1
_CALMING = 0.5  # share of the allowed change of u; the other half is left to the tasks
_TINY = 1e-12  # [rad/s^2]
_LEAST_DAMPING = 1e-4
_DAMPING = 0.05  # lambda_max of the damped inverse [1]
_SINGULAR = 0.05  # smallest singular value of the tasks without damping, in characteristic lengths [1]


class Posed(NamedTuple):
    """The problem of one tick, whether its tasks are damped, and the criterion's memory for the next tick."""

    problem: Problem
    near_singular: bool
    criterion_memory: Vector


class TaskLevel:
    """The tasks of one priority.

    Args:
        rows: indices of its coordinates among all task coordinates, (k,).
        names: of its coordinates, (k,).
        cost: of its coordinates.
        scale: makes its coordinates comparable, (k,) [1/m or 1/rad].
    """

    def __init__(self, rows: Indices, names: Sequence[str], cost: TaskCost, scale: Vector):
        # Adjacent indices, the usual case, become a slice, which makes no copy.
        together = np.array_equal(rows, np.arange(rows[0], rows[0] + len(rows)))
        self.rows = slice(int(rows[0]), int(rows[-1]) + 1) if together else rows
        self.size, self.names, self.cost, self._scales = len(rows), tuple(names), cost, np.outer(scale, scale)
        # Divided by its largest eigenvalue, the scaled curvature is at most one.
        compared = cost.curvature / self._scales
        self._unit = 1.0 / np.linalg.eigvalsh(compared)[-1].item()
        self._curvature = self._unit * cost.curvature
        self._limit = _SINGULAR**2 * np.eye(self.size)

    def part(self, state: TaskState) -> TaskState:
        """The state of its coordinates, from that of all."""
        return state if len(state.value) == self.size else TaskState(*(whole[self.rows] for whole in state))

    def objective(self, part: TaskState, position: Vector, velocity: Vector, deviation: Deviation) -> Level:
        """L of this level, scaled, without damping; the arguments are those of all coordinates, but for `part`."""
        J, rows = part.jacobian, self.rows
        weighted = self._curvature @ J
        own = Deviation(deviation.value[rows], deviation.rate[rows])
        slope = self._unit * self.cost.slope(part, position[rows], velocity[rows], own)
        return Level(J.T @ weighted, part.bias @ weighted + slope @ J, J)

    def damping(self, J: Vector) -> float:
        """lambda^2 of the damped inverse, from the smallest singular value of J."""
        square = self._scales * (J @ J.T)
        if is_definite(square - self._limit):  # the usual case: far from singular
            return 0.0
        smallest = max(dsyev(square, compute_v=0)[0].item(0), 0.0)
        return max(_DAMPING**2 * (1.0 - smallest / _SINGULAR**2), 0.0)


class TaskProgram:
    """Built once, solved at every tick; a copy has programs of its own.

    Args:
        levels: in order of priority.
        criterion: of the last level.
        constraints: give rows and bounds.
        torque: limits of the joint torques, infinite for none (n,) [Nm].
        period: tick [s].
        solver: of the programs: its name, or the solver.
        joints: names of the joints, (n,); numbered when left out.
    """

    def __init__(
        self,
        levels: Sequence[TaskLevel],
        criterion: AnyCriterion,
        constraints: ConstraintSet,
        torque: Vector,
        period: float,
        solver: str | Solver,
        joints: Sequence[str] = (),
    ):
        self._levels, self._period, self._last_level = tuple(levels), period, stepped(criterion)
        self._joints, self._eye = constraints.joints, np.eye(len(torque))
        rests = isinstance(criterion, JointSpeed) and criterion.rests_in(period)
        self._settled = len(self._levels) == 1 and rests
        self._beside = self._eye[:, self._levels[0].size :]  # start value of `left_free`
        self._program = ConstrainedProgram(
            constraints,
            torque,
            solver,
            joints=joints or [f"joint {i + 1}" for i in range(len(torque))],
            slack_weights=constraints.slack_weights,
            tasks=[level.names for level in levels],
            costs=[*(f"tasks of level {i + 1}" for i in range(len(levels))), "criterion of the null space"],
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> TaskProgram:
        made = copy(self)
        made._program = deepcopy(self._program)
        return made

    @property
    def size(self) -> int:
        """Number of levels, the criterion included."""
        return len(self._levels) + 1

    @property
    def num_rows(self) -> int:
        """Number of rows, besides the bounds of the joints."""
        return self._program.num_rows

    def pose(
        self,
        motion: ArmsMotion,
        rows: Rows,
        state: TaskState,
        position: Vector,
        velocity: Vector,
        deviation: Deviation,
        smooth: Smooth | None = None,
        memory: Vector = _NO_MEMORY,
    ) -> Posed:
        """The problem of a tick.

        With a single level of tasks, and a criterion equal to the damping `|u - u_rest|^2`, level 1 settles both: its
        optimum minimises the criterion in the null space of J as well, unless a row is active.

        Args:
            motion: the commanded one.
            rows: of the constraints at this tick.
            state: of all task coordinates.
            position: x_gen at the next tick.
            velocity: x'_gen at the next tick.
            deviation: of all task coordinates from x_gen at this tick.
            smooth: see `Problem`.
            memory: of the criterion.
        """
        parts = [level.part(state) for level in self._levels]
        # A joint at its position limit cannot move the task any more.
        first, mobility = parts[0].jacobian, self._joints.mobility(motion.q)
        near = self._levels[0].damping(first if mobility is None else first * mobility)
        found, damping, rest = [], max(near, _LEAST_DAMPING), motion.v / self._period
        for level, part in zip(self._levels, parts, strict=True):
            hessian, gradient, J = level.objective(part, position, velocity, deviation)
            found.append(Level(hessian + damping * self._eye, gradient + damping * rest, J))
            damping = _LEAST_DAMPING
        if not self._settled and self._beside.size:
            found[0] = self._calmed(found[0], smooth)
        cost, memory = self._last_level(motion, self._period, memory)
        problem = Problem(motion, rows, [*found, Level(*cost)], settled=self._settled, smooth=smooth)
        return Posed(problem, near > 0.0, memory)

    def _calmed(self, level: Level, smooth: Smooth | None) -> Level:
        """Level 1 with the term `w |N (u - u_calm)|^2/2`, see this module."""
        hessian, gradient, J = level
        assert J is not None
        free = left_free(J, self._beside) if all_finite(J) else None
        if free is None:
            return level
        share = free @ free.T
        if smooth is not None:
            before = share @ smooth.last
            margin = np.where(before > 0.0, smooth.last - smooth.lower, smooth.upper - smooth.last)
            least = smallest(margin / np.maximum(np.abs(before), _TINY))
            gradient = gradient - _BESIDE * (1.0 - min(max(_CALMING * least, 0.0), 1.0)) * before
        return Level(hessian + _BESIDE * share, gradient, J)

    def solve(self, posed: Posed) -> Outcome:
        """The optimum, one with slack, or braking; see `Status`."""
        return self._program.solve(posed.problem)

    def program(self, posed: Posed, level: int | None) -> MathematicalProgram:
        """The program of a level, see `ConstrainedProgram.program`."""
        return self._program.program(posed.problem, level)

    def criterion(self, posed: Posed, u: Vector) -> float:
        """u'H u/2 + g'u of the last level."""
        last = posed.problem.levels[-1]
        return float((0.5 * (last.hessian @ u) + last.gradient) @ u)

    def costs(self, error: Vector, rate: Vector) -> list[float]:
        """L of every level but the last (5.16), of the errors e, e' of all task coordinates at the next tick."""
        return [level.cost.value(error[level.rows], rate[level.rows]) for level in self._levels]


def task_levels(
    tasks: Sequence[ArmTask],
    weights: Weights | Sequence[Weights],
    length: float,
    period: float,
    active: Sequence[bool] | None = None,
) -> list[TaskLevel]:
    """The levels of tasks by their priority.

    Args:
        tasks: all tasks of the controller, of any priorities.
        weights: one for every level, or one for all.
        length: characteristic length that makes lengths and angles comparable [m].
        period: tick [s].
        active: for each task, whether it is followed; None: all are.

    Raises:
        BadInputError: not as many weights as levels, or weights that do not fit, see `TaskCost`.
    """
    scale = np.where(np.concatenate([task.angular for task in tasks]), 1.0, 1.0 / length)
    chosen = [True] * len(tasks) if active is None else active
    levels_of = [task.priority if there else 0 for task, there in zip(tasks, chosen, strict=True)]  # 0: no level
    priority = np.repeat(levels_of, [task.size for task in tasks])
    found = np.unique(priority[priority > 0])
    given = [weights] * len(found) if isinstance(weights, Weights) else list(weights)
    if len(given) != len(found):
        raise BadInputError(f"weights: {len(given)} given: must be one, or one for each of {len(found)} priorities")
    names = [f"{task.arm} {coordinate}" for task in tasks for coordinate in task.coordinates]
    levels = []
    for level, own in zip(found, given, strict=True):
        rows = np.flatnonzero(priority == level)
        cost = TaskCost(own, scale[rows], period)
        levels.append(TaskLevel(rows, [names[row] for row in rows], cost, scale[rows]))
    return levels

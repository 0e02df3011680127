"""The programs of the reactive controller at one tick: tasks by priority, then the null space; (5.14), (5.18).

    level 1, 2, ...   L of the tasks of that priority (5.16) + damping |u - u_rest|^2/2
    last level        the criterion, (5.19), (5.20)

The damping makes the optimum unique and keeps joint speeds in bounds where a joint limit leaves an arm little to move
with. It is small (a task moves 0.1 % slower where its singular value is 0.3) except near a singular posture of the
first level, where it grows as in a damped inverse. u_rest = -q'/Ts is rest at the next tick: with less of it, an arm
stretched towards a target out of its reach trembles in the direction that it cannot move in.

The rows of the joint torques are in the programs only in ticks in which the answer of a level without them exceeds a
limit: then all levels are solved again, with these rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dsyev

from forcectl.errors import BadInputError
from forcectl.framework.kernels import is_definite, largest
from forcectl.qp.prioritized_program import Level, PrioritizedProgram
from forcectl.qp.quadratic_program import SolverFactory, Status, identity
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.constraints.base import ConstraintSet, JointTorqueLimit, Rows
from forcectl.tasks.coordinates import ArmTask, TaskState
from forcectl.tasks.cost import TaskCost, Weights
from forcectl.tasks.null_space import Criterion

Vector = NDArray[np.float64]

_LEAST_DAMPING = 1e-4
_DAMPING = 0.05  # lambda_max of the damped inverse [1]
_SINGULAR = 0.05  # smallest singular value of the tasks, with lengths in characteristic lengths, that is undamped [1]
_HOLDS = -1e-9  # a row that is missed by less holds with equality


class Outcome(NamedTuple):
    """u: (n,); brakes and holds when `status` says so. slack, levels: see `PrioritizedSolution`.

    active: rows and bounds that hold with equality. beyond: the largest violation of a row of relative degree 0.
    near_singular: whether the tasks are damped. criterion: u'H u/2 + g'u of the last level.
    """

    u: Vector
    status: Status
    slack: float
    levels: int
    active: int
    beyond: float
    near_singular: bool
    criterion: float


class TaskLevel:
    """The tasks of one priority.

    Args:
        rows: which of all task coordinates they are, (k,). cost: of them. scale: what makes them comparable, (k,)
            [1/m or 1/rad].
    """

    def __init__(self, rows: NDArray[np.intp], cost: TaskCost, scale: Vector):
        # Neighbours, as they usually are, are picked without a copy.
        together = np.array_equal(rows, np.arange(rows[0], rows[0] + len(rows)))
        self.rows = slice(int(rows[0]), int(rows[-1]) + 1) if together else rows
        self.size, self.cost, self._scales = len(rows), cost, np.outer(scale, scale)
        # Divided by that, the curvature is at most one for coordinates of comparable size.
        compared = cost.curvature / self._scales
        self._unit = 1.0 / np.linalg.eigvalsh(compared)[-1].item()
        self._curvature = self._unit * cost.curvature
        self._limit = _SINGULAR**2 * np.eye(self.size)

    def part(self, state: TaskState) -> TaskState:
        """Its coordinates among all."""
        return state if len(state.value) == self.size else TaskState(*(whole[self.rows] for whole in state))

    def objective(self, part: TaskState, position: Vector, velocity: Vector) -> Level:
        """L of this level without damping."""
        J = part.jacobian
        weighted = self._curvature.dot(J)
        slope = self._unit * self.cost.slope(part, position, velocity)
        return Level(J.T.dot(weighted), part.bias.dot(weighted) + slope.dot(J), J)

    def damping(self, J: Vector) -> float:
        """lambda^2 of the damped inverse, from the smallest singular value of J."""
        square = self._scales * J.dot(J.T)
        if is_definite(square - self._limit):  # usually far from singular
            return 0.0
        smallest = max(dsyev(square, compute_v=0)[0].item(0), 0.0)
        return max(_DAMPING**2 * (1.0 - smallest / _SINGULAR**2), 0.0)


class TaskProgram:
    """Built once, solved at every tick.

    Args:
        levels: in order of priority. criterion: of the last level. constraints: rows and bounds.
        torque: limit of the joints, infinite where there is none (n,) [Nm]. period: tick [s]. solver: of the programs.
    """

    def __init__(
        self,
        levels: Sequence[TaskLevel],
        criterion: Criterion,
        constraints: ConstraintSet,
        torque: Vector,
        period: float,
        solver: SolverFactory,
    ):
        self._levels, self._criterion, self._constraints, self._period = tuple(levels), criterion, constraints, period
        n, m = len(torque), constraints.size
        self._eyes, self._tick = (identity(n), _LEAST_DAMPING * identity(n)), np.array(period)
        # A program has at least one row.
        self._nothing = (np.zeros((1, n)), np.array([np.inf])) if m == 0 else None
        weights = constraints.slack_weights if m else np.full(1, np.inf)
        sizes = [level.size for level in levels]
        self._program = PrioritizedProgram(n, len(weights), sizes, slack_weight=weights, solver=solver)
        self._torque = JointTorqueLimit(torque) if np.isfinite(torque).any() else None
        if self._torque is not None:
            weights = np.append(weights, np.full(self._torque.size, np.inf))
            self._limited = PrioritizedProgram(n, len(weights), sizes, slack_weight=weights, solver=solver)

    @property
    def size(self) -> int:
        """Number of levels, the criterion included."""
        return len(self._levels) + 1

    @property
    def num_rows(self) -> int:
        """How many rows there are, besides the bounds of the joints."""
        return self._constraints.size + (0 if self._torque is None else self._torque.size)

    def levels(
        self, motion: ArmsMotion, state: TaskState, position: Vector, velocity: Vector
    ) -> tuple[list[Level], bool, bool]:
        """What is minimised, in order of priority, the criterion last.

        And whether the tasks are near a singularity, and whether the criterion, of one level of tasks, is what damps
        them: |u - u_rest|^2. What J leaves free is then where both want it already, unless a row stops it.
        """
        parts = [level.part(state) for level in self._levels]
        near = self._levels[0].damping(parts[0].jacobian)
        programs, damping, (eye, least), rest = [], max(near, _LEAST_DAMPING), self._eyes, motion.v / self._tick
        for level, part in zip(self._levels, parts, strict=True):
            hessian, gradient, J = level.objective(part, position[level.rows], velocity[level.rows])
            hessian += least if damping == _LEAST_DAMPING else damping * eye
            programs.append(Level(hessian, gradient + damping * rest, J))
            damping = _LEAST_DAMPING
        last = Level(*self._criterion.cost(motion, self._period))
        settled = len(programs) == 1 and last.hessian is eye and last.gradient.tobytes() == rest.tobytes()
        return [*programs, last], near > 0.0, settled

    def solve(self, motion: ArmsMotion, rows: Rows, state: TaskState, position: Vector, velocity: Vector) -> Outcome:
        """The optimum, the nearest to it, or braking.

        Args:
            rows: of the constraints at this tick. state: of all task coordinates. position, velocity: x_gen, x'_gen at
                the next tick.
        """
        programs, near, settled = self.levels(motion, state, position, velocity)
        matrix, limit = (rows.matrix, rows.limit) if self._nothing is None else self._nothing
        lower, upper, torque, direct = rows.lower, rows.upper, self._torque, 0.0
        found = self._program.solve(
            programs, matrix, limit, u_lower=lower, u_upper=upper, fallback=motion.v, settled=settled
        )
        if torque is not None and any(torque.excess(motion, answer) > 0.0 for answer in _different(found.answers)):
            more, allowed = torque.rows(motion)
            matrix, limit = np.concatenate([matrix, more]), np.concatenate([limit, allowed])
            found = self._limited.solve(programs, matrix, limit, u_lower=lower, u_upper=upper, fallback=motion.v)
            direct = max(torque.excess(motion, found.u), 0.0)
        u = found.u
        if found.levels == 0:
            u = self._constraints.brake(motion.v, rows)
            direct = 0.0 if torque is None else max(torque.excess(motion, u), 0.0)
        active = 0
        if found.touches:
            beyond = matrix.dot(u) - limit
            binding = (beyond > _HOLDS, u >= upper, u <= lower)
            active = sum(int(np.count_nonzero(part)) for part in binding)
            if rows.direct:
                direct = max(direct, largest(beyond[: rows.direct]))
        last = programs[-1]
        bent = u if last.hessian is identity(len(u)) else last.hessian.dot(u)
        cost = (0.5 * bent + last.gradient).dot(u).item()
        return Outcome(u, found.status, found.slack, found.levels, active, direct, near, cost)

    def costs(self, error: Vector, rate: Vector) -> list[float]:
        """L of every level but the last (5.16), of the errors e, e' of all task coordinates at the next tick."""
        return [level.cost.value(error[level.rows], rate[level.rows]) for level in self._levels]


def _different(answers: Sequence[Vector]) -> Iterator[Vector]:
    """The answers, without those that the level below leaves as they are."""
    below = None
    for answer in reversed(answers):
        if answer is not below:
            yield answer
        below = answer


def task_levels(
    tasks: Sequence[ArmTask], weights: Weights | Sequence[Weights], length: float, period: float
) -> list[TaskLevel]:
    """The levels of tasks by their priority.

    Args:
        weights: of every level, or one for all. length: makes lengths and angles comparable [m]. period: tick [s].

    Raises:
        BadInputError: not as many weights as levels, or weights that do not fit, see `TaskCost`.
    """
    scale = np.where(np.concatenate([task.angular for task in tasks]), 1.0, 1.0 / length)
    priority = np.repeat([task.priority for task in tasks], [task.size for task in tasks])
    found = np.unique(priority)
    given = [weights] * len(found) if isinstance(weights, Weights) else list(weights)
    if len(given) != len(found):
        raise BadInputError(f"weights: {len(given)} given: must be one, or one for each of {len(found)} priorities")
    levels = []
    for level, own in zip(found, given, strict=True):
        rows = np.flatnonzero(priority == level)
        levels.append(TaskLevel(rows, own.cost(scale[rows], period), scale[rows]))
    return levels

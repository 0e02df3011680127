"""The quadratic programs of all controllers in joint accelerations u, under the constraints of a robot::

    level 1         min  u'H_1 u/2 + g_1'u    s.t.  R u <= r,  E u <= f,  lower <= u <= upper,  |M u + h| <= limit
    level 2, ...    see `PrioritizedProgram`

R u <= r are further rows of the controller, E u <= f those of the constraints, lower and upper the joint limits. Where
there is no answer the joints brake together.

The torque rows seldom bind, and would take a quarter of the time of a tick. So they are added only in ticks in which an
answer without them exceeds a limit. The program that `ConstrainedProgram.program` shows always has all rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram

from forcectl.arrays import Vector
from forcectl.errors import invalid
from forcectl.framework.kernels import largest
from forcectl.qp.prioritized_program import Level, PrioritizedProgram, PrioritizedSolution
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import Solver, make_solver
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import ConstraintSet, JointTorqueLimit, Rows

_CHANGE = 10.0  # weight of the change of u where it cannot be bounded, beside a curvature of about one
_HOLDS = -1e-9  # a row whose left side minus right side is above this counts as active


class Smooth(NamedTuple):
    """Bounds of the change of u. Where they would need slack or leave no answer, the change is weighted instead.

    Attributes:
        lower, upper: of u, within those of the rows (n,) [rad/s^2].
        last: u of the tick before (n,) [rad/s^2].
    """

    lower: Vector
    upper: Vector
    last: Vector


class Problem(NamedTuple):
    """The problem of one tick.

    Attributes:
        motion: the commanded motion.
        rows: of the constraints.
        levels: in order of priority.
        further: R (k, n) and r (k,), in the order of their names; None where there are none.
        settled: see `PrioritizedProgram.solve`.
        smooth: bounds of the change of u; None: there are none.
    """

    motion: RobotMotion
    rows: Rows
    levels: Sequence[Level]
    further: tuple[Vector, Vector] | None = None
    settled: bool = False
    smooth: Smooth | None = None


class Outcome(NamedTuple):
    """Result of the programs of one tick.

    Attributes:
        u: (n,) [rad/s^2]; braking and holding where `status.brakes`.
        status, slack, levels: see `PrioritizedSolution`.
        active: rows and bounds that hold with equality.
        beyond: the largest violation of a row of relative degree 0 [its unit], torques included; 0: no violation.
    """

    u: Vector
    status: Status
    slack: float = 0.0
    levels: int = 0
    active: int = 0
    beyond: float = 0.0


class ConstrainedProgram:
    """Built once, solved at every tick; a copy has programs of its own.

    Args:
        constraints: hard rows, soft ones where they are given a weight, and bounds.
        torque: limit of the joints, infinite where there is none (n,) [Nm].
        solver: its name, or the solver.
        joints: names of the joints, (n,).
        further: slack weights of the further rows by name.
        slack_weights: of the rows of the constraints, infinite for hard ones; all are hard when left out.
        tasks: names of the rows of the task of each level but the last.
        costs: what each level minimises.
        often_free: see `PrioritizedProgram`.
    """

    def __init__(
        self,
        constraints: ConstraintSet,
        torque: Vector,
        solver: str | Solver,
        *,
        joints: Sequence[str],
        further: Mapping[str, float] | None = None,
        slack_weights: Vector | None = None,
        tasks: Sequence[Sequence[str]] = (),
        costs: Sequence[str] = ("objective",),
        often_free: bool = True,
    ):
        self._constraints, self._further = constraints, dict(further or {})
        self._torque = JointTorqueLimit(torque) if np.isfinite(torque).any() else None
        hard = np.full(constraints.size, np.inf)
        names, weights = [*self._further, *constraints.row_names], [*self._further.values()]
        weights += (hard if slack_weights is None else slack_weights).tolist()
        # A program has at least one row.
        self._nothing = None if names else (np.zeros((1, len(torque))), np.array([np.inf]))
        if self._nothing is not None:
            names, weights = ["no constraint"], [np.inf]
        if self._torque is not None:
            names += self._torque.names(joints)
            weights += [np.inf] * self._torque.size
        self._make = partial(
            PrioritizedProgram,
            len(torque),
            len(names),
            [len(rows) for rows in tasks],
            slack_weight=weights,
            solver=make_solver(solver),
            variables=[f"u[{joint}]" for joint in joints],
            rows=names,
            costs=costs,
            task_rows=[name for rows in tasks for name in rows],
            bounds="position, speed and acceleration limits of the joints",
            often_free=often_free,
        )
        self._programs = self._make()

    def __deepcopy__(self, memo: dict[int, Any]) -> ConstrainedProgram:
        made = object.__new__(ConstrainedProgram)
        vars(made).update(vars(self), _programs=self._make())
        return made

    @property
    def num_rows(self) -> int:
        """How many rows there are, besides the bounds of the joints and the further rows."""
        return self._constraints.size + (0 if self._torque is None else self._torque.size)

    def solve(self, problem: Problem) -> Outcome:
        """The optimum, the nearest to it, or braking."""
        found, matrix, limit, problem = self._answer(problem)
        motion, rows, torque = problem.motion, problem.rows, self._torque
        u, beyond = found.u, 0.0
        if found.levels == 0:
            u = self._constraints.brake(motion.v, rows, None if problem.smooth is None else problem.smooth.last)
        if torque is not None and (found.levels == 0 or len(limit) > self._rows_without_torque(problem)):
            beyond = max(torque.excess(motion, u), 0.0)
        active = 0
        if found.touches:
            missed = matrix @ u - limit
            bounded = (u >= rows.upper) | (u <= rows.lower)
            active = int(np.count_nonzero(missed > _HOLDS)) + int(np.count_nonzero(bounded))
            if rows.direct:
                ahead = len(self._further)
                beyond = max(beyond, largest(missed[ahead : ahead + rows.direct]))
        return Outcome(u, found.status, found.slack, found.levels, active, beyond)

    def program(self, problem: Problem, level: int | None = None) -> MathematicalProgram:
        """The program that gives the answer of a level, with all rows.

        Args:
            problem: as it was solved.
            level: 1 is the first; the last one that was solved when left out.

        Raises:
            BadInputError: there is no such level, it was not solved, or the problem holds what is no number.
        """
        found, matrix, limit, problem = self._answer(problem)
        if level is not None and (isinstance(level, bool) or level not in range(1, len(problem.levels) + 1)):
            raise invalid("level", level, f"from 1 to {len(problem.levels)}")
        if self._torque is not None and len(limit) == self._rows_without_torque(problem):
            matrix, limit = self._with_torque(problem.motion, matrix, limit)
        program = self._programs.program(
            max(found.levels, 1) if level is None else level,
            found,
            problem.levels,
            matrix,
            limit,
            u_lower=problem.rows.lower,
            u_upper=problem.rows.upper,
        )
        names = [*self._further, *self._constraints.names_at(problem.motion)]
        for row, name in zip(program.linear_constraints(), names, strict=False):  # the torques are behind them
            row.evaluator().set_description(name)
        return program

    def _rows_without_torque(self, problem: Problem) -> int:
        """Number of rows without those of the torques."""
        return 1 if self._nothing is not None else len(self._further) + len(problem.rows.limit)

    def _answer(self, problem: Problem) -> tuple[PrioritizedSolution, Vector, Vector, Problem]:
        """Result of the programs, the rows that were used, and the problem that was solved in the end."""
        smooth, rows = problem.smooth, problem.rows
        if smooth is None:
            return self._solved(problem)
        answer = self._solved(problem._replace(rows=rows._replace(lower=smooth.lower, upper=smooth.upper)))
        if answer[0].status == Status.OPTIMAL:
            return answer
        eye = _CHANGE * np.eye(len(smooth.last))
        levels = [
            Level(hessian + eye, gradient - _CHANGE * smooth.last, task) for hessian, gradient, task in problem.levels
        ]
        return self._solved(problem._replace(levels=levels, settled=False))

    def _solved(self, problem: Problem) -> tuple[PrioritizedSolution, Vector, Vector, Problem]:
        motion, rows, levels, further, settled, _ = problem
        matrix, limit = (rows.matrix, rows.limit) if self._nothing is None else self._nothing
        if further is not None:
            matrix, limit = np.concatenate([further[0], matrix]), np.concatenate([further[1], limit])
        solve, lower, upper = self._programs.solve, rows.lower, rows.upper
        found = solve(levels, matrix, limit, u_lower=lower, u_upper=upper, fallback=motion.v, settled=settled)
        if self._torque is not None and self._exceeds_torque(motion, found.answers):
            matrix, limit = self._with_torque(motion, matrix, limit)
            found = solve(levels, matrix, limit, u_lower=lower, u_upper=upper, fallback=motion.v)
        return found, matrix, limit, problem

    def _exceeds_torque(self, motion: RobotMotion, answers: Sequence[Vector]) -> bool:
        """Whether the answer of a level exceeds a torque."""
        assert self._torque is not None
        below = None
        for answer in reversed(answers):
            # A level may leave the answer of the one above as it is.
            if answer is not below and self._torque.excess(motion, answer) > 0.0:
                return True
            below = answer
        return False

    def _with_torque(self, motion: RobotMotion, matrix: Vector, limit: Vector) -> tuple[Vector, Vector]:
        assert self._torque is not None
        more, allowed = self._torque.rows(motion)
        return np.concatenate([matrix, more]), np.concatenate([limit, allowed])

"""Quadratic programs in order of priority, with the same rows and bounds at every level: (5.14), (5.18), any number::

    level 1      min  u'H_1 u/2 + g_1'u    s.t.  E u <= f,  u_lower <= u <= u_upper
    level k+1    min  u'H u/2 + g'u        s.t.  the same,  and  J_i u = J_i u_i  of all levels i above

The equalities of a level are met by its variables: u = u_above + N z, with N an orthonormal basis of what all J_i leave
free. So they hold to rounding, also where a J_i loses rank, and z = 0 is feasible at every level: a level that cannot
be solved leaves the answer of those above. `program` shows a level as (5.18) in u, as it is printed.

Rows that level 1 could keep only with a slack are kept below it as far as it kept them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram
from scipy.linalg.lapack import dposv

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check_count
from forcectl.framework.kernels import all_finite, free_optimum, keeps, largest, left_free
from forcectl.qp.named_program import Coefficients, NamedProgram
from forcectl.qp.quadratic_program import QuadraticProgram, Status
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver, make_solver

# Smallest margin of rows and bounds at the levels below the first, in their unit. Without a margin, rounding would
# decide whether a solver finds a feasible point. It is a tenth of the accepted violation.
_ROOM = 1e-9
_STEP_TOLERANCE = 1e-9  # a smaller step counts as none


class Level(NamedTuple):
    """What one level minimises, u'H u/2 + g'u, and the rows J whose J u the levels below it must not change.

    Attributes:
        hessian: positive definite (n, n).
        gradient: (n,).
        task: J, (k, n); not used of the last level.
    """

    hessian: Array
    gradient: Array
    task: Array | None = None


class PrioritizedSolution(NamedTuple):
    """u: (n,). status, slack: of level 1, see `Solution`. levels: how many were solved.

    levels is the number of levels unless the solver failed or there is no freedom left, and 0 for the fallback.
    answers: u after each of them, the same array where a level leaves it as it is. touches: whether a row or bound may
    hold with equality.
    """

    u: Array
    status: Status
    slack: float
    levels: int
    answers: Sequence[Array] = ()
    touches: bool = True


class PrioritizedProgram:
    """Programs of n variables and m rows in order of priority; built once, solved anew at every tick.

    Nothing is kept from one `solve` to the next, except the programs that `program` fills. `levels` is the number of
    levels.

    Args:
        n: variables.
        m: rows.
        tasks: how many rows the task of each level but the last has.
        slack_weight: see `QuadraticProgram`.
        solver: see `QuadraticProgram`.
        variables: names of u, (n,); numbered when left out.
        rows: names of the rows, (m,); numbered when left out.
        costs: what each level minimises; numbered when left out.
        task_rows: names of the rows of the tasks, one after the other; numbered when left out.
        bounds: what bounds u.
        often_free: whether the optimum without rows is tried first; that wastes time where rows bind at most ticks.

    Raises:
        BadInputError: as `QuadraticProgram`, or a task of no rows.
    """

    def __init__(
        self,
        n: int,
        m: int,
        tasks: Sequence[int] = (),
        *,
        slack_weight: ArrayLike = np.inf,
        solver: str | Solver = DEFAULT_SOLVER,
        variables: Sequence[str] = (),
        rows: Sequence[str] = (),
        costs: Sequence[str] = (),
        task_rows: Sequence[str] = (),
        bounds: str = "bounds of the variables",
        often_free: bool = True,
    ):
        self._n, self._m = check_count("n", n), check_count("m", m)
        for size in tasks:
            if not check_count("tasks", size) <= n:
                raise invalid("tasks", size, f"at most n = {n} rows")
        self.levels = len(tasks) + 1
        self._eye = np.eye(self._n)
        self._tasks, self._often_free = tuple(tasks), often_free
        of_u = variables or [f"u[{i + 1}]" for i in range(n)]
        of_rows = rows or [f"row {i + 1}" for i in range(m)]
        of_cost = costs or [f"objective {k + 1}" for k in range(self.levels)]
        of_task = task_rows or [f"row {i + 1} of task {k + 1}" for k, size in enumerate(tasks) for i in range(size)]
        solver = make_solver(solver)
        self._first = QuadraticProgram(
            n,
            m,
            slack_weight=slack_weight,
            solver=solver,
            variables=of_u,
            rows=of_rows,
            cost=of_cost[0],
            bounds=bounds,
        )
        # Below the first level the bounds of u are rows, too. The null space of J_1 ... has the columns after theirs.
        taken = [sum(tasks[: k + 1]) for k in range(len(tasks))]
        free = [n - k for k in taken]
        self._below = [QuadraticProgram(d, m + n, solver=solver) for d in free if d > 0]
        above = [n, *free]
        self._picks = [np.vstack([np.zeros((above[k] - d, d)), np.eye(d)]) for k, d in enumerate(free) if d > 0]
        # (5.18) in u, for `program`.
        self._shown = [
            NamedProgram(
                of_u, of_rows, cost=name, bounds=bounds, equalities=[f"{each} as above" for each in of_task[:k]]
            )
            for k, name in zip(taken, of_cost[1:], strict=True)
        ]

    def solve(
        self,
        levels: Sequence[Level],
        matrix: Array,
        upper: Array,
        *,
        u_lower: Array,
        u_upper: Array,
        fallback: Array,
        settled: bool = False,
    ) -> PrioritizedSolution:
        """Solve with these coefficients; no values of them make it raise, and only a fallback with NaN gives NaN.

        Args:
            levels: in order of priority.
            matrix: E, (m, n); with fewer rows, the last ones, which must be hard, are left out.
            upper: f, (m,).
            u_lower: bounds of u, (n,).
            u_upper: the same.
            fallback: u when level 1 has no solution. (n,), returned as it is.
            settled: whether an optimum of level 1 with no active row or bound is optimal for all further levels, too.

        Raises:
            BadInputError: the number of levels, or the shape of a task, is not the one the program was made for.
        """
        self._check(levels)
        hessian, gradient, _ = levels[0]
        first, status, slack = None, Status.OPTIMAL, 0.0
        if self._often_free:
            first = free_optimum(hessian, gradient, matrix, upper, u_lower, u_upper)
        touches = first is None
        if first is not None and settled:
            answers = [first] * (1 + len(self._below))
            return PrioritizedSolution(first, status, slack, len(answers), answers, touches)
        if first is None:
            first, status, slack = self._first.solve(
                hessian, gradient, matrix, upper, u_lower=u_lower, u_upper=u_upper, fallback=fallback
            )
            if status.brakes:
                return PrioritizedSolution(fallback, status, 0.0, 0)
        answers, basis = [first], None
        for above, level, program, pick in zip(levels, levels[1:], self._below, self._picks, strict=False):
            basis = _free_of(above.task, basis, pick)
            if basis is None:
                break
            u = self._descend(program, level, basis, answers[-1], matrix, upper, u_lower, u_upper)
            if u is None:
                break
            answers.append(u)
        touches = touches or answers[-1] is not first
        return PrioritizedSolution(answers[-1], status, slack, len(answers), answers, touches)

    def program(
        self,
        level: int,
        found: PrioritizedSolution,
        levels: Sequence[Level],
        matrix: Array,
        upper: Array,
        *,
        u_lower: Array,
        u_upper: Array,
    ) -> MathematicalProgram:
        """The program of one level in u that gave the answer with these coefficients.

        Args:
            level: 1 is the first.
            found: what `solve` gave.
            levels: as for `solve`, like the others.

        Raises:
            BadInputError: the level was not solved, or a coefficient is not a number.
        """
        hessian, gradient, _ = levels[level - 1]
        if level == 1:
            return self._first.program(found.status, hessian, gradient, matrix, upper, u_lower=u_lower, u_upper=u_upper)
        if level > found.levels:
            raise BadInputError(f"level = {level}: must be at most {found.levels}: the last tick solved only these")
        above = found.answers[level - 2]
        rows, far = matrix @ above, np.full(len(matrix), np.inf)
        tasks = np.concatenate([each.task for each in levels[: level - 1] if each.task is not None])
        numbers = Coefficients(
            hessian,
            gradient,
            matrix,
            -far,
            np.maximum(upper, rows) + _ROOM,
            np.minimum(u_lower, above) - _ROOM,
            np.maximum(u_upper, above) + _ROOM,
        )
        return self._shown[level - 2].fill(numbers, equal=(tasks, tasks @ above))

    def _descend(
        self,
        program: QuadraticProgram,
        level: Level,
        basis: Array,
        u: Array,
        matrix: Array,
        upper: Array,
        u_lower: Array,
        u_upper: Array,
    ) -> Array | None:
        """The answer of one level, found from u, the answer of the level above; None when there is none."""
        hessian, gradient, _ = level
        steepness = (hessian @ u + gradient) @ basis
        if not all_finite(steepness):
            return None
        # The step without rows and bounds is taken where it violates none.
        # In an orthonormal basis the curvature of |u|^2 is that of |z|^2, exactly.
        bent = np.eye(len(steepness)) if np.array_equal(hessian, self._eye) else basis.T @ hessian @ basis
        _, free, failed = dposv(bent, -steepness)
        if failed == 0:
            if largest(np.abs(free)) <= _STEP_TOLERANCE:
                return u
            there: Array = u + basis @ free
            if keeps(there, matrix @ there, upper, u_lower, u_upper, _ROOM):
                return there
        room = np.concatenate([upper - matrix @ u, u_upper - u])
        below = np.concatenate([np.full(len(matrix), -np.inf), np.minimum(u_lower - u, 0.0)])
        found = program.solve(
            bent,
            steepness,
            np.concatenate([matrix @ basis, basis]),
            np.maximum(room, 0.0) + _ROOM,
            lower=below - _ROOM,
            fallback=steepness,
        )
        return None if found.status.brakes else u + basis @ found.u

    def _check(self, levels: Sequence[Level]) -> None:
        if len(levels) != self.levels:
            raise BadInputError(f"levels: {len(levels)} given: must be {self.levels}")
        for level, rows in zip(levels, self._tasks, strict=False):
            shape = None if level.task is None else level.task.shape
            if shape != (rows, self._n):
                raise BadInputError(f"levels: a task has shape {shape}: must be ({rows}, {self._n})")


def _free_of(task: Array | None, basis: Array | None, pick: Array) -> Array | None:
    """Orthonormal columns that span the part of `basis` (None: all of space) that the rows of `task` map to zero.

    Args:
        pick: the last columns of the identity, as many as there are after those of the task.
    """
    assert task is not None  # checked by `PrioritizedProgram`
    rows = task if basis is None else task @ basis
    if not all_finite(rows):
        return None
    columns = left_free(rows, pick)
    return columns if columns is None or basis is None else basis @ columns

"""The quadratic programs of controllers: built once, coefficients updated per tick, a result in every case.

    min  u'H u/2 + f'u    s.t.  lower <= E u <= upper,    u_lower <= u <= u_upper

What is returned, in this order::

    OPTIMAL        the optimum
    SLACK          no point satisfies all rows: the soft rows were given a slack, weighted against the objective
    INFEASIBLE     the hard rows and bounds alone contradict each other: the caller's fallback
    SOLVER_FAILED  the solver raised, gave up, or its answer does not satisfy the rows: the caller's fallback
    NOT_FINITE     a coefficient is not a number, or infinite where it must not be: the caller's fallback

An answer is accepted when it is finite and satisfies the rows, whatever status the solver reports. Every program is
solved from a cold start, so that a result depends on its coefficients only; a warm start of DAQP saves one microsecond
in eight.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check_count
from forcectl.framework.kernels import all_finite, keeps, largest
from forcectl.qp.named_program import Coefficients, NamedProgram
from forcectl.qp.solvers import DEFAULT_SOLVER, Solver, make_solver

_TOLERANCE = 1e-8  # largest accepted violation of a row, relative to its terms [1]


class Status(IntEnum):
    """Kind of a solution; its number is the value of the status ports. See the module's documentation."""

    OPTIMAL = 0
    SLACK = 1
    INFEASIBLE = 2
    SOLVER_FAILED = 3
    NOT_FINITE = 4

    @property
    def brakes(self) -> bool:
        """Whether the solution is the caller's fallback."""
        return self >= Status.INFEASIBLE


class Solution(NamedTuple):
    """u: shape (n,), always finite when the fallback is. status: where it comes from.

    Attributes:
        slack: largest violation of a soft row by u, in the unit of that row; 0 unless status is SLACK.
    """

    u: Array
    status: Status
    slack: float


class QuadraticProgram:
    """A program of n variables and m rows, solved anew with other coefficients at every tick.

    A row that is not wanted has infinite bounds. Nothing is kept from one `solve` to the next, except the program that
    `program` fills.

    Args:
        n: variables.
        m: rows.
        slack_weight: shape (m,) or a number; > 0, infinite for a hard row. Cost of one unit of slack squared, in units
            of the mean diagonal of H: 1e4 and more keeps the slack near the smallest possible, and rows with a hundred
            times the weight give way only after the others.
        solver: its name, or the solver.
        variables: names of u, (n,); numbered when left out.
        rows: names of the rows, (m,); numbered when left out.
        cost: what is minimised.
        bounds: what bounds u.

    Raises:
        BadInputError: a size below one, a weight that is not positive, or an unknown solver.
    """

    def __init__(
        self,
        n: int,
        m: int,
        *,
        slack_weight: ArrayLike = np.inf,
        solver: str | Solver = DEFAULT_SOLVER,
        variables: Sequence[str] = (),
        rows: Sequence[str] = (),
        cost: str = "objective",
        bounds: str = "bounds of the variables",
    ):
        self._n, self._m = check_count("n", n), check_count("m", m)
        weight = np.asarray(slack_weight, dtype=float)
        if weight.ndim > 1 or weight.size not in (1, self._m):
            raise BadInputError(f"slack_weight has shape {weight.shape}: must be one number or shape ({self._m},)")
        if not (weight > 0).all():
            raise invalid("slack_weight", weight.tolist(), "positive")
        weight = np.broadcast_to(weight, self._m)
        self._soft = np.flatnonzero(np.isfinite(weight))
        self._weight = weight[self._soft]
        self._solver = make_solver(solver)
        self._no_row, self._no_lower = np.full(self._m, -np.inf), np.full(self._n, -np.inf)
        self._no_upper = -self._no_lower
        # The second program has one more variable per soft row: E u - s.
        k = len(self._soft)
        self._slack_columns = np.zeros((self._m, k))
        self._slack_columns[self._soft, np.arange(k)] = -1.0
        of_u = variables or [f"u[{i + 1}]" for i in range(self._n)]
        of_rows = rows or [f"row {i + 1}" for i in range(self._m)]
        self._hard = NamedProgram(of_u, of_rows, cost=cost, bounds=bounds)
        self._softened = NamedProgram(of_u, of_rows, cost=cost, bounds=bounds, soft=self._soft.tolist())

    def solve(
        self,
        hessian: Array,
        gradient: Array,
        matrix: Array,
        upper: Array,
        *,
        lower: Array | None = None,
        u_lower: Array | None = None,
        u_upper: Array | None = None,
        fallback: Array,
    ) -> Solution:
        """Solve with these coefficients; no values of them make it raise, and only a fallback with NaN gives NaN.

        Args:
            hessian: H, symmetric, positive definite, shape (n, n).
            gradient: f, shape (n,).
            matrix: E, shape (m, n); with fewer rows, the last ones, which must be hard, are left out.
            upper: bounds of E u, shape (m,).
            lower: the same; no lower bounds when None.
            u_lower: bounds of u, shape (n,); none when None.
            u_upper: the same.
            fallback: u when there is no solution: hold-and-brake, say. Shape (n,), returned as it is.
        """
        program = self._coefficients(hessian, gradient, matrix, upper, lower=lower, u_lower=u_lower, u_upper=u_upper)
        if not all_finite(hessian, gradient, matrix):
            return Solution(fallback, Status.NOT_FINITE, 0.0)
        u, infeasible = self._attempt(self._hard, program, lower is not None)
        if u is not None:
            return Solution(u, Status.OPTIMAL, 0.0)
        if not _bounded(program):
            return Solution(fallback, Status.NOT_FINITE, 0.0)
        if len(self._soft):
            u, infeasible = self._attempt(self._softened, self._with_slack(program), lower is not None)
        if u is None:
            return Solution(fallback, Status.INFEASIBLE if infeasible else Status.SOLVER_FAILED, 0.0)
        u = u[: self._n]
        reached = matrix[self._soft] @ u
        slack = np.maximum(reached - upper[self._soft], program.lower[self._soft] - reached)
        return Solution(u, Status.SLACK, max(0.0, slack.max().item()))

    def program(self, status: Status, *coefficients: Array, **bounds: Any) -> MathematicalProgram:
        """The program that gave an answer of that status; with slack variables unless it is the optimum without them.

        Args:
            status: of the answer.
            coefficients: H, f, E and the upper bounds, as for `solve`.
            bounds: the others, by their names there.

        Raises:
            BadInputError: a coefficient is not a number: then there was no program.
        """
        program = self._coefficients(*coefficients, **bounds)
        if status is Status.NOT_FINITE or not (all_finite(*coefficients[:3]) and _bounded(program)):
            raise BadInputError("program: the last tick had none: a coefficient is not a number")
        if status is Status.OPTIMAL or not len(self._soft):
            return self._hard.fill(program)
        return self._softened.fill(self._with_slack(program))

    def _coefficients(
        self,
        hessian: Array,
        gradient: Array,
        matrix: Array,
        upper: Array,
        *,
        lower: Array | None = None,
        u_lower: Array | None = None,
        u_upper: Array | None = None,
    ) -> Coefficients:
        return Coefficients(
            hessian,
            gradient,
            matrix,
            self._no_row[: len(matrix)] if lower is None else lower,
            upper,
            self._no_lower if u_lower is None else u_lower,
            self._no_upper if u_upper is None else u_upper,
        )

    def _with_slack(self, program: Coefficients) -> Coefficients:
        """The program with one more variable s per soft row, E u - s, and its cost."""
        n, k = self._n, len(self._soft)
        hessian = np.zeros((n + k, n + k))
        hessian[:n, :n] = program.hessian
        hessian[range(n, n + k), range(n, n + k)] = self._weight * (np.trace(program.hessian) / n)
        free = np.full(k, np.inf)
        return program._replace(
            hessian=hessian,
            gradient=np.concatenate([program.gradient, np.zeros(k)]),
            matrix=np.hstack([program.matrix, self._slack_columns[: len(program.matrix)]]),
            v_lower=np.concatenate([program.v_lower, -free]),
            v_upper=np.concatenate([program.v_upper, free]),
        )

    def _attempt(self, named: NamedProgram, program: Coefficients, lower: bool) -> tuple[Array | None, bool]:
        """The solver's answer if accepted, and whether the program is infeasible; `lower`: rows have lower bounds."""
        try:
            u, infeasible = self._solver(named, program)
        except Exception:  # a solver of Drake, of a package or of a test: whatever it raises, the tick goes on
            return None, False
        if u is None or u.shape != program.gradient.shape:
            return None, infeasible
        reached = program.matrix @ u
        if self._plainly(program, u, reached, lower) or self._holds(program, u, reached):
            return u, False
        return None, infeasible

    def _plainly(self, program: Coefficients, u: Array, reached: Array, lower: bool) -> bool:
        """Whether u satisfies every row and bound, to the tolerance."""
        inside = keeps(u, reached, program.upper, program.v_lower, program.v_upper, _TOLERANCE)
        return inside and (not lower or largest(program.lower - reached) <= _TOLERANCE)

    def _holds(self, program: Coefficients, u: Array, reached: Array) -> bool:
        """Whether u is finite and satisfies every row and bound, to the tolerance relative to its terms."""
        if not np.isfinite(u).all():
            return False
        rows = _TOLERANCE * (1.0 + np.abs(program.matrix) @ np.abs(u))
        bounds = _TOLERANCE * (1.0 + np.abs(u))
        above = (reached <= program.upper + rows).all() and (u <= program.v_upper + bounds).all()
        below = (reached >= program.lower - rows).all() and (u >= program.v_lower - bounds).all()
        return bool(above and below)


def _bounded(program: Coefficients) -> bool:
    """Whether no bound is NaN or infinite on the wrong side. No answer satisfies such a bound, so this can wait."""
    upper, lower = np.append(program.upper, program.v_upper), np.append(program.lower, program.v_lower)
    return bool((upper > -np.inf).all() and (lower < np.inf).all())

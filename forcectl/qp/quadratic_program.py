"""The quadratic programs of controllers: built once, coefficients updated per tick, an answer in every case.

    min  u'H u/2 + f'u    s.t.  lower <= E u <= upper,    u_lower <= u <= u_upper

What is returned, in this order:

    OPTIMAL        the optimum
    SLACK          no point satisfies all rows: the soft rows were given a slack, weighted against the objective
    INFEASIBLE     the hard rows and bounds alone contradict each other: the caller's fallback
    SOLVER_FAILED  the solver raised, gave up, or its answer does not satisfy the rows: the caller's fallback
    NOT_FINITE     a coefficient is not a number, or infinite where it must not be: the caller's fallback

An answer counts when it is finite and satisfies the rows, whatever the solver says of it. Every program is solved from
a cold start, so that a result depends on its coefficients only; a warm start of DAQP saves one microsecond in eight.

Solvers, by measurement (6 variables, 20 rows; `python -m benchmarks.quadratic_program`): DAQP is active-set, exact to
rounding and ten times as fast as the interior-point solvers. Drake has it from some version on; before that the same
solver comes from the `daqp` package.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import NamedTuple, Protocol

import daqp
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake import solvers
from pydrake.solvers import MathematicalProgram, SolutionResult, SolverOptions
from scipy.linalg.lapack import dposv

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check_count
from forcectl.framework.kernels import largest

Array = NDArray[np.float64]

_DAQP_INFEASIBLE = -1
_EQUALITY = np.int32(5)  # kind of a row, to DAQP
# Rows are normalised inside DAQP, so this holds in the units of u; its default 1e-6 would be micrometres per s^2.
_PRIMAL_TOLERANCE = 1e-10
_TOUCHES = 1e-9  # a row that is missed by less holds with equality


class Status(IntEnum):
    """What a solution is; the number is what a status port puts out. See the module's documentation."""

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

    slack: furthest that u is outside a soft row, in the unit of that row; 0 unless status is SLACK.
    """

    u: Array
    status: Status
    slack: float


class Coefficients(NamedTuple):
    """The numbers of a program, see the module's documentation; bounds that are not wanted are infinite."""

    hessian: Array
    gradient: Array
    matrix: Array
    lower: Array
    upper: Array
    u_lower: Array
    u_upper: Array


class Solver(Protocol):
    """A solver for programs of one size."""

    def __call__(self, program: Coefficients) -> tuple[Array | None, bool]:
        """The optimum, or None; and whether the program was found infeasible. May raise."""
        ...


# Makes the solver for n variables and m rows.
SolverFactory = Callable[[int, int], Solver]


class DrakeSolver:
    """A `MathematicalProgram` of n variables and m rows and one of Drake's solvers.

    Args:
        solver: name of a class in `pydrake.solvers`. options: of that solver.
    """

    def __init__(self, n: int, m: int, solver: str, options: dict[str, float]):
        self._program = MathematicalProgram()
        self._u = self._program.NewContinuousVariables(n, "u")
        cost = self._program.AddQuadraticCost(np.eye(n), np.zeros(n), self._u, is_convex=True)
        self._cost = cost.evaluator()
        bounds = self._program.AddBoundingBoxConstraint(np.full(n, -np.inf), np.full(n, np.inf), self._u)
        self._bounds = bounds.evaluator()
        rows = self._program.AddLinearConstraint(np.ones((m, n)), np.full(m, -np.inf), np.full(m, np.inf), self._u)
        self._rows = rows.evaluator()
        self._solver = getattr(solvers, solver)()
        self._options = SolverOptions()
        for name, value in options.items():
            self._options.SetOption(self._solver.solver_id(), name, value)

    def __call__(self, program: Coefficients) -> tuple[Array | None, bool]:
        """See `Solver`."""
        self._cost.UpdateCoefficients(program.hessian, program.gradient, 0.0, is_convex=True)
        self._rows.UpdateCoefficients(program.matrix, program.lower, program.upper)
        self._bounds.UpdateLowerBound(program.u_lower)
        self._bounds.UpdateUpperBound(program.u_upper)
        result = self._solver.Solve(self._program, None, self._options)
        if result.is_success():
            return result.get_x_val(), False
        return None, result.get_solution_result() == SolutionResult.kInfeasibleConstraints


class DaqpPackage:
    """DAQP without Drake."""

    def __init__(self, n: int, m: int):
        self._kinds = np.zeros(n + m, dtype=np.int32)

    def __call__(self, program: Coefficients) -> tuple[Array | None, bool]:
        """See `Solver`."""
        hessian, gradient, matrix, lower, upper, u_lower, u_upper = program
        if not hessian.flags.writeable:  # the package takes no other
            hessian = hessian.copy()
        above, below = np.concatenate([u_upper, upper]), np.concatenate([u_lower, lower])
        equal = above == below
        kinds = np.where(equal, _EQUALITY, self._kinds) if largest(equal) else self._kinds
        u, _, flag, _ = daqp.solve(hessian, gradient, matrix, above, below, kinds, primal_tol=_PRIMAL_TOLERANCE)
        return (u, False) if flag > 0 else (None, flag == _DAQP_INFEASIBLE)


def drake_daqp(n: int, m: int) -> Solver:
    """DAQP through Drake, where Drake has it."""
    return DrakeSolver(n, m, "DaqpSolver", {"primal_tol": _PRIMAL_TOLERANCE})


def drake_clarabel(n: int, m: int) -> Solver:
    """Clarabel through Drake: an independent second opinion; ten times slower and good to 1e-6."""
    return DrakeSolver(n, m, "ClarabelSolver", {})


def fastest(n: int, m: int) -> Solver:
    """The solver to use with this Drake."""
    return drake_daqp(n, m) if hasattr(solvers, "DaqpSolver") else DaqpPackage(n, m)


class QuadraticProgram:
    """A program of n variables and m rows, solved anew with other coefficients at every tick.

    A row that is not wanted has infinite bounds. Keeps nothing from one `solve` to the next.

    Args:
        n: variables. m: rows. slack_weight: shape (m,) or a number; > 0, infinite for a hard row. What one unit of
            slack squared costs, in units of the mean diagonal of H: 1e4 and more keeps the slack near the smallest
            possible, and rows with a hundred times the weight give way only after the others.
        solver: makes the solver. tolerance: by how much a row may be missed, relative to its terms [1].

    Raises:
        BadInputError: a size below one, or a weight that is not positive.
    """

    def __init__(
        self,
        n: int,
        m: int,
        *,
        slack_weight: ArrayLike = np.inf,
        solver: SolverFactory = fastest,
        tolerance: float = 1e-8,
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
        self._tolerance = tolerance
        self._no_lower, self._no_u_lower = np.full(self._m, -np.inf), np.full(self._n, -np.inf)
        self._no_u_upper = -self._no_u_lower
        self._solver = solver(self._n, self._m)
        # The second program has one more variable per soft row: E u - s.
        k = len(self._soft)
        self._slack_solver = solver(self._n + k, self._m) if k else None
        self._slack_columns = np.zeros((self._m, k))
        self._slack_columns[self._soft, np.arange(k)] = -1.0

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
        """Solve with these coefficients; never raises for what is in them, and never returns a NaN of its own.

        Args:
            hessian: H, symmetric, positive definite, shape (n, n). gradient: f, shape (n,). matrix: E, shape (m, n).
            upper, lower: bounds of E u, shape (m,); no lower bounds when None.
            u_lower, u_upper: bounds of u, shape (n,); none when None.
            fallback: u when there is no solution: hold-and-brake, say. Shape (n,), returned as it is.
        """
        program = Coefficients(
            hessian,
            gradient,
            matrix,
            self._no_lower if lower is None else lower,
            upper,
            self._no_u_lower if u_lower is None else u_lower,
            self._no_u_upper if u_upper is None else u_upper,
        )
        if not _finite(program):
            return Solution(fallback, Status.NOT_FINITE, 0.0)
        u, infeasible = self._attempt(self._solver, program)
        if u is not None:
            return Solution(u, Status.OPTIMAL, 0.0)
        if not _bounded(program):
            return Solution(fallback, Status.NOT_FINITE, 0.0)
        if self._slack_solver is not None:
            u, infeasible = self._attempt(self._slack_solver, self._with_slack(program))
        if u is None:
            return Solution(fallback, Status.INFEASIBLE if infeasible else Status.SOLVER_FAILED, 0.0)
        u = u[: self._n]
        reached = matrix[self._soft] @ u
        slack = np.maximum(reached - upper[self._soft], program.lower[self._soft] - reached)
        return Solution(u, Status.SLACK, max(0.0, slack.max().item()))

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
            matrix=np.hstack([program.matrix, self._slack_columns]),
            u_lower=np.concatenate([program.u_lower, -free]),
            u_upper=np.concatenate([program.u_upper, free]),
        )

    def _attempt(self, solver: Solver, program: Coefficients) -> tuple[Array | None, bool]:
        """The solver's answer if it holds, and whether the program was found infeasible."""
        try:
            u, infeasible = solver(program)
        except Exception:  # a solver of Drake, of a package or of a test: whatever it raises, the tick goes on
            return None, False
        if u is None or u.shape != program.gradient.shape:
            return None, infeasible
        reached = program.matrix.dot(u)
        if self._plainly(program, u, reached) or self._holds(program, u, reached):
            return u, False
        return None, infeasible

    def _plainly(self, program: Coefficients, u: Array, reached: Array) -> bool:
        """Whether u satisfies every row and bound, to the tolerance."""
        tolerance = self._tolerance
        inside = keeps(u, reached, program.upper, program.u_lower, program.u_upper, tolerance)
        return inside and (program.lower is self._no_lower or largest(program.lower - reached) <= tolerance)

    def _holds(self, program: Coefficients, u: Array, reached: Array) -> bool:
        """Whether u is finite and satisfies every row and bound, to the tolerance relative to its terms."""
        if not np.isfinite(u).all():
            return False
        rows = self._tolerance * (1.0 + np.abs(program.matrix) @ np.abs(u))
        bounds = self._tolerance * (1.0 + np.abs(u))
        above = (reached <= program.upper + rows).all() and (u <= program.u_upper + bounds).all()
        below = (reached >= program.lower - rows).all() and (u >= program.u_lower - bounds).all()
        return bool(above and below)


@cache
def identity(n: int) -> Array:
    """The identity (n, n), always the same one: a Hessian that is it need not be multiplied by."""
    eye = np.eye(n)
    eye.flags.writeable = False
    return eye


def free_optimum(
    hessian: Array, gradient: Array, matrix: Array, upper: Array, u_lower: Array, u_upper: Array
) -> Array | None:
    """The optimum without rows E u <= upper and bounds if it keeps off all of them by 1e-9, else None.

    Where they seldom bind it saves a solver half of its time. Arguments: see `QuadraticProgram.solve`; any numbers.
    """
    if not math.isfinite(np.vdot(hessian, hessian) + np.vdot(matrix, matrix)):
        return None
    _, free, failed = dposv(hessian, -gradient)
    apart = failed == 0 and keeps(free, matrix.dot(free), upper, u_lower, u_upper, -_TOUCHES)
    return free if apart else None


def keeps(u: Array, reached: Array, upper: Array, u_lower: Array, u_upper: Array, tolerance: float) -> bool:
    """Whether u, with E u = `reached`, is beyond no upper row or bound by more than the tolerance."""
    # NaN fails every comparison.
    return bool(
        largest(reached - upper) <= tolerance
        and largest(u - u_upper) <= tolerance
        and largest(u_lower - u) <= tolerance
    )


def _finite(program: Coefficients) -> bool:
    """Whether the coefficients that are no bounds are finite."""
    parts = program[:3]
    # A sum of squares tells in a fifth of the time, unless it overflows.
    if math.isfinite(np.vdot(parts[0], parts[0]) + parts[1].dot(parts[1]) + np.vdot(parts[2], parts[2])):
        return True
    return all(np.isfinite(part).all() for part in parts)


def _bounded(program: Coefficients) -> bool:
    """Whether no bound is NaN or infinite on the wrong side. No answer satisfies such a bound, so this can wait."""
    upper, lower = np.append(program.upper, program.u_upper), np.append(program.lower, program.u_lower)
    return bool((upper > -np.inf).all() and (lower < np.inf).all())

"""The solvers of the quadratic programs of controllers, by name: Drake's, and DAQP also where Drake has none.

Every solver solves the same `NamedProgram`. By measurement (6 variables, 20 rows; `python -m
benchmarks.quadratic_program`) DAQP is active-set, exact to rounding and ten times as fast as the interior-point
solvers. Drake has it from some version on; before that the same solver comes from the `daqp` package.
"""

from __future__ import annotations

from functools import cache
from typing import Protocol

import daqp
import numpy as np
from pydrake import solvers
from pydrake.solvers import SolutionResult, SolverOptions

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.qp.named_program import Coefficients, NamedProgram

DEFAULT_SOLVER = "daqp"

_DAQP_INFEASIBLE = -1
_DAQP_EQUALITY = np.int32(5)  # DAQP's code for an equality row
# Rows are normalised inside DAQP, so this holds in the units of u; its default 1e-6 would be micrometres per s^2.
_PRIMAL_TOLERANCE = 1e-10

# To reach these tolerances, Clarabel needs more iterative refinement of its linear equations than by default.
_CLARABEL: dict[str, float] = {
    "tol_gap_abs": 1e-12,
    "tol_gap_rel": 1e-12,
    "tol_feas": 1e-12,
    "iterative_refinement_reltol": 1e-16,
    "iterative_refinement_abstol": 1e-16,
    "iterative_refinement_max_iter": 50,
}
_DAQP = ("DaqpSolver", {"primal_tol": _PRIMAL_TOLERANCE})
# Classes of Drake, with the options that make them exact enough to command a robot.
_OF_DRAKE: dict[str, tuple[str, dict[str, float]]] = {
    "clarabel": ("ClarabelSolver", _CLARABEL),
    "gurobi": ("GurobiSolver", {"FeasibilityTol": 1e-9, "OptimalityTol": 1e-9, "BarConvTol": 1e-12}),
    "mosek": ("MosekSolver", {"MSK_DPAR_INTPNT_QO_TOL_REL_GAP": 1e-12, "MSK_DPAR_INTPNT_QO_TOL_PFEAS": 1e-12}),
    "osqp": ("OsqpSolver", {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 100_000}),
}
# A solver that stops after one iteration, to test controllers with: see `forcectl faults`.
UNCONVERGED = "osqp_one_step"
_UNCONVERGED = ("OsqpSolver", {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 1, "polish": 0})


class Solver(Protocol):
    """Solves named programs; keeps nothing from one to the next."""

    def __call__(self, program: NamedProgram, numbers: Coefficients) -> tuple[Array | None, bool]:
        """The optimum, or None; and whether the program was found infeasible. May raise.

        Args:
            program: to be filled with the numbers by a solver that reads it.
            numbers: of the program at this tick.
        """
        ...


class DrakeSolver:
    """One of Drake's solvers.

    Args:
        kind: name of a class in `pydrake.solvers`.
        options: of that solver.

    Raises:
        BadInputError: this Drake has no such solver, or may not use it.
    """

    def __init__(self, kind: str, options: dict[str, float]):
        if not _has(kind):
            raise BadInputError(f"solver {kind}: Drake has none, or may not use it here")
        self._solver = getattr(solvers, kind)()
        self._options = _options(kind, options)

    def __call__(self, program: NamedProgram, numbers: Coefficients) -> tuple[Array | None, bool]:
        """See `Solver`."""
        result = self._solver.Solve(program.fill(numbers), None, self._options)
        if result.is_success():
            return result.get_x_val(), False
        return None, result.get_solution_result() == SolutionResult.kInfeasibleConstraints


class DaqpPackage:
    """DAQP without Drake's `DaqpSolver`.

    It reads the numbers only: to fill the program with them would cost more than to solve it.
    """

    def __call__(self, program: NamedProgram, numbers: Coefficients) -> tuple[Array | None, bool]:
        """See `Solver`."""
        hessian, gradient, matrix, lower, upper, v_lower, v_upper = numbers
        if not hessian.flags.writeable:  # the package refuses read-only arrays
            hessian = hessian.copy()
        above, below = np.concatenate([v_upper, upper]), np.concatenate([v_lower, lower])
        kinds = _DAQP_EQUALITY * (above == below)
        v, _, flag, _ = daqp.solve(hessian, gradient, matrix, above, below, kinds, primal_tol=_PRIMAL_TOLERANCE)
        return (v, False) if flag > 0 else (None, flag == _DAQP_INFEASIBLE)


def drake_daqp() -> DrakeSolver:
    """DAQP through Drake, where Drake has it."""
    return DrakeSolver(*_DAQP)


def exact_options(name: str) -> SolverOptions:
    """Options of Drake's solver of that name with which it solves the programs of controllers to 1e-6 in u.

    Raises:
        BadInputError: Drake has none of this name, or may not use it here.
    """
    known = {each: of for each, of in {DEFAULT_SOLVER: _DAQP, **_OF_DRAKE}.items() if _has(of[0])}
    if name not in known:
        raise BadInputError(f" = {name!r}: must be one of {', '.join(known)}, Drake's available here", key="solver")
    return _options(*known[name])


@cache
def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that can be used here."""
    return (DEFAULT_SOLVER, *(name for name, (kind, _) in _OF_DRAKE.items() if _has(kind)))


def solver_choices() -> tuple[str, ...]:
    """The available solvers and, where there is one, the solver that stops after one iteration."""
    return (*available_solvers(), *[UNCONVERGED] * ("osqp" in available_solvers()))


def check_solver(name: str) -> str:
    """The name of a solver that can be used here.

    Raises:
        BadInputError: it is unknown, or this Drake lacks it or may not use it.
    """
    if not isinstance(name, str) or name not in solver_choices():
        raise BadInputError(f" = {name!r}: must be one of {', '.join(solver_choices())} (available here)", key="solver")
    return name


def make_solver(name: str | Solver) -> Solver:
    """The solver of that name, or the solver itself; "daqp" is Drake's where Drake has it, else the package's.

    Raises:
        BadInputError: see `check_solver`.
    """
    if callable(name):
        return name
    if check_solver(name) == DEFAULT_SOLVER:
        return drake_daqp() if _has("DaqpSolver") else DaqpPackage()
    return DrakeSolver(*(_UNCONVERGED if name == UNCONVERGED else _OF_DRAKE[name]))


def _options(kind: str, options: dict[str, float]) -> SolverOptions:
    """Options of one of Drake's solvers, by the name of its class."""
    made = SolverOptions()
    for name, value in options.items():
        made.SetOption(getattr(solvers, kind).id(), name, value)
    return made


def _has(kind: str) -> bool:
    if not hasattr(solvers, kind):
        return False
    solver = getattr(solvers, kind)()
    return bool(solver.available() and solver.enabled())

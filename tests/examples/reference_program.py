"""Second opinions on prioritised quadratic programs, made of nothing that the controllers use.

The multipliers of an optimum: B'(H u + g) + (A B)' x = 0 with x >= 0 for the rows A that hold with equality, and B what
the tasks above leave free (null space from singular values, x by scipy's non-negative least squares). The answer of a
strictly convex program that satisfies its rows and has such multipliers is the optimum. And Clarabel, as exact as it
can be, where the feasible set has an interior.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls

from forcectl.qp.named_program import Coefficients, NamedProgram
from forcectl.qp.prioritized_program import Level
from forcectl.qp.solvers import DrakeSolver

_ACTIVE = 1e-7


def distance_from_optimum(
    levels: Sequence[Level], u: np.ndarray, E: np.ndarray, f: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> float:
    """How far u, which satisfies the rows, can be from the optimum of the last of these levels: its J u from that of
    the last level, with the J_i u_i of those above as u has them."""
    n = len(u)
    rows, limit = np.vstack([E, np.eye(n), -np.eye(n)]), np.concatenate([f, upper, -lower])
    fixed = [level.task for level in levels[:-1] if level.task is not None]
    free = null_space(np.vstack(fixed)) if fixed else np.eye(n)
    active = rows[rows @ u - limit > -_ACTIVE]
    last = levels[-1]
    slope = free.T @ (last.hessian @ u + last.gradient)
    curvature = free.T @ last.hessian @ free
    multipliers = nnls((active @ free).T, -slope)[0] if len(active) else np.zeros(0)
    left = slope + (active @ free).T @ multipliers
    step = np.linalg.solve(curvature, left)
    mine = np.eye(n) if last.task is None else last.task
    return float(np.abs(mine @ free @ step).max())


def clarabel(level: Level, E: np.ndarray, f: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The optimum of a first level."""
    exact = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-13}
    m, n = E.shape
    program = NamedProgram([f"u[{i}]" for i in range(n)], [f"row {i}" for i in range(m)])
    u, _ = DrakeSolver("ClarabelSolver", exact)(
        program, Coefficients(level.hessian, level.gradient, E, np.full(len(f), -np.inf), f, lower, upper)
    )
    assert u is not None
    return u

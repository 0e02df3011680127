"""A quadratic program as Drake's `MathematicalProgram`, with a name for every variable, row, bound and cost.

    min  v'H v/2 + f'v    s.t.  lower <= E v <= upper,    v_lower <= v <= v_upper

`print(program)` shows the names; `program.linear_constraints()` has one binding per row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import Variable

from forcectl.arrays import Array

_INF = np.array([np.inf])


class Coefficients(NamedTuple):
    """The numbers of a program of v; bounds that are not wanted are infinite.

    Attributes:
        hessian: H, (n, n).
        gradient: f, (n,).
        matrix: E, (m, n).
        lower, upper: of E v, (m,).
        v_lower, v_upper: of v, (n,).
    """

    hessian: Array
    gradient: Array
    matrix: Array
    lower: Array
    upper: Array
    v_lower: Array
    v_upper: Array


class NamedProgram:
    """A `MathematicalProgram` that is built once, when it is first needed, and filled with other numbers at every tick.

    Args:
        variables: names of v without the slack variables.
        rows: names of the rows.
        cost: what is minimised.
        bounds: what bounds the variables.
        soft: indices of the rows with a slack variable, in the order of these variables; its factor in E v is -1.
        equalities: names of rows that hold with equality, besides the others.
    """

    def __init__(
        self,
        variables: Sequence[str],
        rows: Sequence[str],
        *,
        cost: str = "objective",
        bounds: str = "bounds of the variables",
        soft: Sequence[int] = (),
        equalities: Sequence[str] = (),
    ):
        self._variables, self._names, self._equal_names = tuple(variables), tuple(rows), tuple(equalities)
        self._cost_name, self._bounds_name, self._soft = cost, bounds, tuple(soft)
        self._program: Any = None
        self._filled = 0  # number of rows when it was filled last

    def fill(self, numbers: Coefficients, equal: tuple[Array, Array] | None = None) -> MathematicalProgram:
        """The program with these numbers.

        Args:
            numbers: of v, the slack variables last. With fewer rows than there are names, the last rows are without
                bounds.
            equal: A, b of the equalities A v = b.
        """
        if self._program is None:
            self._build()
        n, rows = len(self._variables), len(numbers.matrix)
        hessian, gradient, matrix, lower, upper, v_lower, v_upper = numbers
        self._cost.UpdateCoefficients(hessian[:n, :n], gradient[:n], 0.0, is_convex=True)
        if self._soft:
            self._slack_cost.UpdateCoefficients(hessian[n:, n:], gradient[n:], 0.0, is_convex=True)
        self._bounds.UpdateLowerBound(v_lower[:n])
        self._bounds.UpdateUpperBound(v_upper[:n])
        for i, (row, columns) in enumerate(zip(self._rows[:rows], self._columns, strict=False)):
            row.UpdateCoefficients(matrix[i : i + 1, columns], lower[i : i + 1], upper[i : i + 1])
        for row in self._rows[rows : self._filled]:
            row.UpdateLowerBound(-_INF)
            row.UpdateUpperBound(_INF)
        self._filled = rows
        if equal is not None:
            A, b = equal
            for i, row in enumerate(self._equalities):
                row.UpdateCoefficients(A[i : i + 1], b[i : i + 1])
        return self._program

    def _build(self) -> None:
        n, program = len(self._variables), MathematicalProgram()
        v = np.array([Variable(name) for name in self._variables])
        slack = np.array([Variable(f"slack of {self._names[row]}") for row in self._soft])
        program.AddDecisionVariables(v)

        def named(binding: Any, name: str) -> Any:
            binding.evaluator().set_description(name)
            return binding.evaluator()

        self._cost = named(program.AddQuadraticCost(np.eye(n), np.zeros(n), v, is_convex=True), self._cost_name)
        if self._soft:
            k = len(slack)
            program.AddDecisionVariables(slack)
            self._slack_cost = named(program.AddQuadraticCost(np.eye(k), np.zeros(k), slack, is_convex=True), "slack")
        far = np.full(n, np.inf)
        self._bounds = named(program.AddBoundingBoxConstraint(-far, far, v), self._bounds_name)
        self._columns: list[Any] = [slice(0, n)] * len(self._names)
        of_row = [v] * len(self._names)
        for i, row in enumerate(self._soft):
            self._columns[row], of_row[row] = [*range(n), n + i], np.append(v, slack[i])
        self._rows = [
            named(program.AddLinearConstraint(np.ones((1, len(own))), -_INF, _INF, own), name)
            for own, name in zip(of_row, self._names, strict=True)
        ]
        self._equalities = [
            named(program.AddLinearEqualityConstraint(np.ones((1, n)), np.zeros(1), v), name)
            for name in self._equal_names
        ]
        self._program = program

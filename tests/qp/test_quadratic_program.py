from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake import solvers

from forcectl.errors import BadInputError
from forcectl.framework.kernels import free_optimum
from forcectl.qp.quadratic_program import QuadraticProgram, Solution, Status
from forcectl.qp.solvers import DaqpPackage, Solver, drake_daqp, make_solver

HOLD = np.array([7.0, -7.0])
EYE = np.eye(2)
EXACT: dict[str, Solver] = {"daqp package": DaqpPackage()}
if hasattr(solvers, "DaqpSolver"):
    EXACT["Drake's DAQP"] = drake_daqp()
ALL = EXACT | {"Clarabel": make_solver("clarabel")}

every_solver = pytest.mark.parametrize("solver", ALL.values(), ids=ALL)


def nearest(
    program: QuadraticProgram, wish: list[float], rows: list[list[float]], upper: list[float], **more: Any
) -> Solution:
    """The point nearest to `wish` that satisfies the rows."""
    return program.solve(EYE, -np.array(wish), np.array(rows), np.array(upper), fallback=HOLD, **more)


@every_solver
def test_optimum_lies_on_the_rows_that_stop_it_and_relaxed_rows_do_not(solver: Solver) -> None:
    program = QuadraticProgram(2, 3, solver=solver)
    rows = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
    u, status, slack = nearest(program, [2.0, 3.0], rows, [1.0, np.inf, np.inf])
    assert (status, slack) == (Status.OPTIMAL, 0.0)
    np.testing.assert_allclose(u, [1.0, 3.0], atol=1e-5)
    # The same program again, with the other row: nothing of the first solve is left.
    u = nearest(program, [2.0, 3.0], rows, [np.inf, 1.0, np.inf]).u
    np.testing.assert_allclose(u, [2.0, 1.0], atol=1e-5)


@every_solver
def test_lower_bounds_equalities_and_bounds_of_variables(solver: Solver) -> None:
    program = QuadraticProgram(2, 1, solver=solver)
    sums = [[1.0, 1.0]]
    u = nearest(program, [0.0, 0.0], sums, [5.0], lower=np.array([2.0])).u
    np.testing.assert_allclose(u, [1.0, 1.0], atol=1e-5)
    u = nearest(program, [0.0, 4.0], sums, [2.0], lower=np.array([2.0])).u
    np.testing.assert_allclose(u, [-1.0, 3.0], atol=1e-5)
    bounds = {"u_lower": np.array([-0.5, -9.0]), "u_upper": np.array([0.5, 2.0])}
    u = nearest(program, [-2.0, 4.0], sums, [np.inf], **bounds).u
    np.testing.assert_allclose(u, [-0.5, 2.0], atol=1e-5)


def random_program(seed: int, n: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n), rng.normal(size=n), rng.normal(size=(m, n)), rng.random(m)


@pytest.mark.parametrize("solver", EXACT.values(), ids=EXACT)
@settings(deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 14), st.integers(1, 30))
def test_solutions_satisfy_the_optimality_conditions(solver: Solver, seed: int, n: int, m: int) -> None:
    hessian, gradient, matrix, upper = random_program(seed, n, m)
    program = QuadraticProgram(n, m, solver=solver)
    u, status, _ = program.solve(hessian, gradient, matrix, upper, fallback=np.zeros(n))
    assert status is Status.OPTIMAL
    gap = upper - matrix @ u
    assert gap.min() > -1e-9
    # H u + f = -E' lambda with lambda >= 0 on the active rows only.
    active = matrix[gap < 1e-8]
    multiplier = np.linalg.lstsq(active.T, -(hessian @ u + gradient), rcond=None)[0] if len(active) else np.zeros(0)
    np.testing.assert_allclose(hessian @ u + gradient + active.T @ multiplier, 0.0, atol=1e-6)
    assert multiplier.min(initial=0.0) > -1e-6


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_solvers_agree(seed: int) -> None:
    numbers = random_program(seed, 6, 12)
    found = [QuadraticProgram(6, 12, solver=s).solve(*numbers, fallback=np.zeros(6)).u for s in ALL.values()]
    for other, tolerance in zip(found[1:], [1e-10] * (len(EXACT) - 1) + [2e-3], strict=True):
        np.testing.assert_allclose(other, found[0], atol=tolerance)


def test_a_solution_does_not_depend_on_the_ticks_before_it() -> None:
    used, numbers = QuadraticProgram(6, 12, slack_weight=1e4), random_program(5, 6, 12)
    for seed in range(20):
        used.solve(*random_program(seed, 6, 12), fallback=np.zeros(6))
    fresh = QuadraticProgram(6, 12, slack_weight=1e4)
    np.testing.assert_array_equal(
        used.solve(*numbers, fallback=np.zeros(6)).u, fresh.solve(*numbers, fallback=np.zeros(6)).u
    )


@every_solver
def test_soft_rows_give_way_by_weight_hard_rows_never(solver: Solver) -> None:
    rows, upper = [[1.0, 0.0], [-1.0, 0.0]], [0.0, -1.0]  # u_1 <= 0 and u_1 >= 1
    even = QuadraticProgram(2, 2, slack_weight=1e4, solver=solver)
    u, status, slack = nearest(even, [0.0, 2.0], rows, upper)
    assert status is Status.SLACK
    np.testing.assert_allclose(u, [0.5, 2.0], atol=1e-3)
    assert slack == pytest.approx(0.5, abs=1e-3)
    first = QuadraticProgram(2, 2, slack_weight=[1e6, 1e4], solver=solver)
    np.testing.assert_allclose(nearest(first, [0.0, 2.0], rows, upper).u, [1 / 101, 2.0], atol=1e-3)
    hard = QuadraticProgram(2, 2, slack_weight=[np.inf, 1e4], solver=solver)
    u, status, slack = nearest(hard, [0.0, 2.0], rows, upper)
    assert (status, slack) == (Status.SLACK, pytest.approx(1.0, abs=1e-3))
    np.testing.assert_allclose(u, [0.0, 2.0], atol=1e-3)


@every_solver
def test_hard_rows_that_contradict_each_other_give_the_fallback(solver: Solver) -> None:
    rows, upper = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [0.0, -1.0, 0.0]
    for weight in (np.inf, [np.inf, np.inf, 1e4]):
        program = QuadraticProgram(2, 3, slack_weight=weight, solver=solver)
        u, status, slack = nearest(program, [0.0, 0.0], rows, upper)
        assert u is HOLD
        assert (status, slack) == (Status.INFEASIBLE, 0.0)
    bounds = {"u_lower": np.array([1.0, 0.0]), "u_upper": np.array([0.0, 0.0])}
    assert nearest(program, [0.0, 0.0], rows, [np.inf] * 3, **bounds).status is Status.INFEASIBLE


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["hessian", "gradient", "matrix"])
def test_coefficients_that_are_no_numbers_give_the_fallback(where: str, bad: float) -> None:
    numbers = {"hessian": EYE.copy(), "gradient": np.zeros(2), "matrix": EYE.copy(), "upper": np.ones(2)}
    numbers[where].flat[1] = bad
    solution = QuadraticProgram(2, 2).solve(**numbers, fallback=HOLD)
    assert solution == (HOLD, Status.NOT_FINITE, 0.0)


@pytest.mark.parametrize(
    ("where", "bad"),
    [(w, np.nan) for w in ("upper", "lower", "u_lower", "u_upper")]
    + [("upper", -np.inf), ("u_upper", -np.inf), ("lower", np.inf), ("u_lower", np.inf)],
)
def test_bounds_that_are_no_numbers_or_infinite_on_the_wrong_side_give_the_fallback(where: str, bad: float) -> None:
    numbers = {"upper": np.full(2, np.inf)} | {where: np.array([0.0, bad])}
    solution = QuadraticProgram(2, 2).solve(EYE, np.zeros(2), EYE, **numbers, fallback=HOLD)
    assert solution.status is Status.NOT_FINITE


class Faulty:
    """A solver that fails in one way."""

    def __init__(self, answer: Any, infeasible: bool = False):
        self.answer, self.infeasible = answer, infeasible

    def __call__(self, *numbers: Any) -> tuple[Any, bool]:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer, self.infeasible


@pytest.mark.parametrize(
    "answer",
    [None, RuntimeError("no"), np.full(2, np.nan), np.array([1e9, 1e9]), np.array([0.5, 0.0]), np.zeros(3)],
    ids=["gives up", "raises", "NaN", "far off", "beside the rows", "of another size"],
)
@pytest.mark.parametrize("weight", [np.inf, 1e4])
def test_a_solver_that_fails_gives_the_fallback(answer: Any, weight: float) -> None:
    program = QuadraticProgram(2, 2, slack_weight=weight, solver=Faulty(answer))
    solution = nearest(program, [0.0, 0.0], [[1.0, 0.0], [-1.0, 0.0]], [0.2, 0.2])
    assert solution.status is Status.SOLVER_FAILED
    assert solution.u is HOLD
    assert solution.status.brakes


def test_an_answer_that_satisfies_the_rows_counts_whatever_the_solver_says() -> None:
    program = QuadraticProgram(2, 1, solver=Faulty(np.zeros(2), infeasible=True))
    assert nearest(program, [0.0, 0.0], [[1.0, 0.0]], [0.2]).status is Status.OPTIMAL


def test_statuses_as_numbers_of_a_port() -> None:
    assert [float(s) for s in Status] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [s.brakes for s in Status] == [False, False, True, True, True]


def test_the_solver_in_use_is_drakes_where_it_has_it() -> None:
    assert isinstance(make_solver("daqp"), DaqpPackage) != hasattr(solvers, "DaqpSolver")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0, "m": 1}, "n = 0"),
        ({"n": 1, "m": 0}, "m = 0"),
        ({"n": 1, "m": 2, "slack_weight": [1.0, 1.0, 1.0]}, "slack_weight has shape"),
        ({"n": 1, "m": 2, "slack_weight": 0.0}, "slack_weight = 0.0: must be positive"),
        ({"n": 1, "m": 2, "slack_weight": np.nan}, "slack_weight"),
    ],
)
def test_bad_sizes_and_weights_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        QuadraticProgram(**arguments)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["hessian", "gradient", "matrix"])
def test_the_free_optimum_of_what_is_not_finite_is_none(where: str, bad: float) -> None:
    wide = np.full(3, 1e9)
    given = {"hessian": np.eye(3), "gradient": np.array([1.0, 2.0, 3.0]), "matrix": np.ones((2, 3))}
    assert free_optimum(*given.values(), np.full(2, 1e9), -wide, wide) is not None
    given[where].flat[0] = bad
    assert free_optimum(*given.values(), np.full(2, 1e9), -wide, wide) is None


def test_the_free_optimum_is_none_where_it_touches_a_row_or_a_bound() -> None:
    hessian, gradient, matrix = np.eye(2), np.array([-1.0, 0.0]), np.array([[1.0, 0.0]])
    wide = np.full(2, 9.0)
    found = free_optimum(hessian, gradient, matrix, np.array([1.1]), -wide, wide)
    np.testing.assert_allclose(found, [1.0, 0.0], atol=1e-15)
    for upper, low, high in (([1.0], -wide, wide), ([1.1], -wide, [1.0, 9.0]), ([1.1], [1.0, -9.0], wide)):
        assert free_optimum(hessian, gradient, matrix, np.array(upper), np.array(low), np.array(high)) is None


def test_a_hessian_that_may_not_be_written_to_is_as_good() -> None:
    program, rows, eye = QuadraticProgram(2, 1), np.array([[1.0, 1.0]]), np.eye(2)
    eye.flags.writeable = False
    found = program.solve(eye, np.array([-2.0, -2.0]), rows, np.array([1.0]), fallback=np.zeros(2))
    assert found.status == Status.OPTIMAL
    np.testing.assert_allclose(found.u, [0.5, 0.5], atol=1e-9)

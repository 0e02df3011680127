"""Programs in order of priority: what is above stays, what is below is optimal, rows hold, bad numbers are survived."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.qp.named_program import Coefficients, NamedProgram
from forcectl.qp.prioritized_program import Level, PrioritizedProgram, PrioritizedSolution
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import make_solver
from tests.examples.reference_program import clarabel, distance_from_optimum

N, M = 6, 9
EYE = np.eye(N)


class Problem:
    """Three levels of random tasks of 2, 2 and all variables under rows that u = 0 satisfies."""

    def __init__(self, seed: int, tight: float = 1.0):
        rng = np.random.default_rng(seed)
        self.J = [rng.normal(size=(2, N)), rng.normal(size=(2, N))]
        wishes = [J.T @ rng.normal(size=2) * 5 for J in self.J]
        self.levels = [Level(J.T @ J + 1e-3 * EYE, -g, J) for J, g in zip(self.J, wishes, strict=True)]
        self.levels.append(Level(EYE, rng.normal(size=N) * 3))
        self.E, self.f = rng.normal(size=(M, N)), tight * rng.uniform(0.0, 3.0, M)
        self.lower, self.upper = -rng.uniform(0.5, 3.0, N), rng.uniform(0.5, 3.0, N)

    def solve(self, program: PrioritizedProgram, **changes: Any) -> PrioritizedSolution:
        given = {"matrix": self.E, "upper": self.f, "u_lower": self.lower, "u_upper": self.upper}
        levels = changes.pop("levels", self.levels)
        return program.solve(levels, **given | {"fallback": np.full(N, 7.0)} | changes)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_every_level_is_the_optimum_that_those_above_leave(seed: int) -> None:
    problem = Problem(seed)
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]))
    assert (found.status, found.levels) == (Status.OPTIMAL, 3)
    rows = (problem.E, problem.f, problem.lower, problem.upper)
    for k in (1, 2, 3):
        u = problem.solve(PrioritizedProgram(N, M, [2, 2][: k - 1]), levels=problem.levels[:k]).u
        assert distance_from_optimum(problem.levels[:k], u, *rows) <= 1e-6
    np.testing.assert_array_equal(u, found.u)
    best = clarabel(problem.levels[0], *rows)
    np.testing.assert_allclose(problem.J[0] @ found.u, problem.J[0] @ best, atol=1e-6)


def test_the_second_opinion_sees_what_is_no_optimum() -> None:
    problem = Problem(10)
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]))
    rows = (problem.E, problem.f, problem.lower, problem.upper)
    assert distance_from_optimum(problem.levels, found.u, *rows) <= 1e-6
    assert distance_from_optimum(problem.levels, 0.99 * found.u, *rows) > 1e-4


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6))
def test_what_is_above_is_unchanged_and_rows_hold(seed: int) -> None:
    problem = Problem(seed)
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]))
    for k in (1, 2):
        above = problem.solve(PrioritizedProgram(N, M, [2, 2][: k - 1]), levels=problem.levels[:k])
        for J in problem.J[:k]:
            np.testing.assert_allclose(J @ found.u, J @ above.u, atol=1e-12)
    assert (problem.E @ found.u - problem.f).max() <= 1e-8
    assert (found.u - problem.upper).max() <= 1e-8
    assert (problem.lower - found.u).max() <= 1e-8


@pytest.mark.parametrize("rank", [0, 1])
def test_a_task_that_loses_rank_stays_unchanged(rank: int) -> None:
    problem = Problem(2)
    J = problem.J[0].copy()
    J[1] = rank * J[0]
    J[0] *= rank
    levels = [problem.levels[0]._replace(task=J), *problem.levels[1:]]
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]), levels=levels)
    first = problem.solve(PrioritizedProgram(N, M), levels=levels[:1])
    assert found.levels == 3
    np.testing.assert_allclose(J @ found.u, J @ first.u, atol=1e-12)


def test_tasks_that_use_all_freedom_leave_nothing_to_the_levels_below() -> None:
    problem = Problem(3)
    tasks = [Level(EYE, -np.ones(N), EYE), problem.levels[2]]
    found = problem.solve(PrioritizedProgram(N, M, [N]), levels=tasks)
    first = problem.solve(PrioritizedProgram(N, M), levels=tasks[:1])
    assert found.levels == 1
    np.testing.assert_array_equal(found.u, first.u)


def test_soft_rows_give_way_at_the_first_level_and_no_further_below_it() -> None:
    problem = Problem(4)
    weights = np.full(M, np.inf)
    weights[0] = 1e6
    # The first row asks for more than the bounds allow.
    f = problem.f.copy()
    f[0] = -np.abs(problem.E[0]) @ np.maximum(problem.upper, -problem.lower) - 1.0
    program = PrioritizedProgram(N, M, [2, 2], slack_weight=weights)
    found = problem.solve(program, upper=f)
    first = problem.solve(PrioritizedProgram(N, M, slack_weight=weights), upper=f, levels=problem.levels[:1])
    assert (found.status, found.levels) == (Status.SLACK, 3)
    assert found.slack == pytest.approx(first.slack)
    assert found.slack > 1.0
    assert problem.E[0] @ found.u <= problem.E[0] @ first.u + 1e-8
    assert (problem.E[1:] @ found.u - f[1:]).max() <= 1e-8


def test_hard_rows_that_contradict_each_other_end_in_the_fallback() -> None:
    problem = Problem(5)
    f = problem.f.copy()
    f[0] = -np.abs(problem.E[0]) @ np.maximum(problem.upper, -problem.lower) - 1.0
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]), upper=f)
    assert (found.status, found.slack, found.levels) == (Status.INFEASIBLE, 0.0, 0)
    np.testing.assert_array_equal(found.u, np.full(N, 7.0))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["hessian", "gradient", "task"])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_numbers_that_are_none_never_get_out(bad: float, where: str, level: int) -> None:
    problem = Problem(6)
    levels = list(problem.levels)
    part = getattr(levels[level], where)
    if part is None:
        return
    broken = part.copy()
    broken.flat[0] = bad
    levels[level] = levels[level]._replace(**{where: broken})
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]), levels=levels)
    assert np.isfinite(found.u).all()
    if level == 0 and where != "task":
        assert (found.status, found.levels) == (Status.NOT_FINITE, 0)
    else:
        assert found.status == Status.OPTIMAL
        assert found.levels == level + (where == "task")
        assert (problem.E @ found.u - problem.f).max() <= 1e-8


@pytest.mark.parametrize("where", ["matrix", "upper", "u_lower", "u_upper"])
def test_rows_that_are_no_numbers_end_in_the_fallback(where: str) -> None:
    problem = Problem(7)
    given = {"matrix": problem.E, "upper": problem.f, "u_lower": problem.lower, "u_upper": problem.upper}
    broken = given[where].copy()
    broken.flat[1] = np.nan
    found = problem.solve(PrioritizedProgram(N, M, [2, 2]), **{where: broken})
    assert found.status == Status.NOT_FINITE
    np.testing.assert_array_equal(found.u, np.full(N, 7.0))


def test_a_solver_that_fails_below_leaves_the_answer_from_above() -> None:
    class Failing:
        def __call__(self, program: NamedProgram, numbers: Coefficients) -> Any:
            if len(numbers.gradient) == N:
                return make_solver("daqp")(program, numbers)
            raise RuntimeError("no")

    problem = Problem(8)
    program = PrioritizedProgram(N, M, [2, 2], solver=Failing())
    found = problem.solve(program)
    assert (found.status, found.levels) == (Status.OPTIMAL, 1)
    first = problem.solve(PrioritizedProgram(N, M), levels=problem.levels[:1])
    np.testing.assert_array_equal(found.u, first.u)


def test_sizes_that_do_not_fit_are_refused_by_name() -> None:
    with pytest.raises(BadInputError, match="tasks"):
        PrioritizedProgram(N, M, [N + 1])
    with pytest.raises(BadInputError, match="tasks"):
        PrioritizedProgram(N, M, [0])
    problem = Problem(9)
    with pytest.raises(BadInputError, match="levels: 3 given: must be 2"):
        problem.solve(PrioritizedProgram(N, M, [2]))
    with pytest.raises(BadInputError, match=r"levels: a task has shape \(2, 6\): must be \(3, 6\)"):
        problem.solve(PrioritizedProgram(N, M, [3, 2]))
    with pytest.raises(BadInputError, match="levels: a task has shape None"):
        problem.solve(PrioritizedProgram(N, M, [2, 2]), levels=[problem.levels[0]._replace(task=None)] * 3)

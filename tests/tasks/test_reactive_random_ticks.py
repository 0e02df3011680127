"""Random ticks of the reactive controller: rows hold, stage 2 changes nothing of the tasks, both stages are optimal."""

import os
from typing import Any, NamedTuple

import numpy as np
import pytest

from forcectl.qp.constrained_program import Outcome
from forcectl.qp.prioritized_program import Level, PrioritizedProgram, PrioritizedSolution
from forcectl.qp.quadratic_program import Status
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.constraints.base import CartesianWall, Constraint, ConstraintSet, JointTorqueLimit, Rows
from forcectl.tasks.constraints.task_limits import OfArm, TaskRange, TaskSpeedLimit
from forcectl.tasks.coordinates import TaskState
from forcectl.tasks.cost import Deviation, Weights
from forcectl.tasks.null_space import JointSpeed
from forcectl.tasks.program import TaskProgram, task_levels
from tests.examples.reactive_examples import N, arm_tasks, at, two_arms
from tests.examples.reference_program import clarabel, distance_from_optimum

# At every change 1000, which have hundreds of binding rows; 10 000 take five seconds and more.
TICKS = int(os.environ.get("FORCECTL_RANDOM_TICKS", "1000"))
PERIOD, LENGTH = 0.004, 0.28
NONE = Deviation(np.zeros(12), np.zeros(12))


class Tick(NamedTuple):
    """One random tick: what was asked for, and what came out."""

    motion: ArmsMotion
    rows: Rows
    state: TaskState
    outcome: Outcome
    levels: list[Level]
    first: PrioritizedSolution  # of level 1 alone


def constraints() -> list[Constraint]:
    """Walls above the table and at the side of each arm, ranges and speeds of their tool centre points; 56 rows."""
    found: list[Constraint] = [JointTorqueLimit(two_arms().limits.torque)]
    for arm, side in (("left", 1.0), ("right", -1.0)):
        found.append(OfArm(arm, CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])))
        found.append(OfArm(arm, CartesianWall([0.0, -0.35 * side, 0.0], [0.0, side, 0.0])))
        task = arm_tasks()[arm == "right"]
        found.append(TaskSpeedLimit(task, [1.0] * 3 + [4.0] * 3))
    return found


class Ticks:
    """Random ticks near postures that the constraints allow."""

    def __init__(self) -> None:
        limits = two_arms().limits
        self.limits, self.context = limits, two_arms().create_context()
        start = at(two_arms().parameters.default_posture)
        self.constraints = ConstraintSet(constraints(), limits, start, PERIOD, -2.0)
        self.first = PrioritizedProgram(N, self.constraints.size)
        levels = task_levels(arm_tasks(), Weights(), LENGTH, PERIOD)
        self.program = TaskProgram(levels, JointSpeed(), self.constraints, np.full(N, np.inf), PERIOD, "daqp")

    def random(self, seed: int, fast: float = 1.0) -> Tick:
        rng = np.random.default_rng(seed)
        low, high = self.limits.position_lower, self.limits.position_upper
        room = rng.choice([0.0, 0.01, 0.2])  # some joints are at their limits
        q = np.clip(
            two_arms().parameters.default_posture + rng.normal(size=N) * rng.uniform(0, 0.6), low + room, high - room
        )
        v = fast * rng.normal(size=N) * rng.uniform(0, 0.5)
        motion = ArmsMotion(two_arms(), self.context, q, v)
        states = [task.state(motion) for task in arm_tasks()]
        state = TaskState(*map(np.concatenate, zip(*states, strict=True)))
        rows = self.constraints.rows(motion, np.zeros(self.constraints.num_predicted_rates))
        wish = state.rate + rng.normal(size=12) * rng.uniform(0, 0.1)
        place = state.value + PERIOD * 0.5 * (state.rate + wish)
        posed = self.program.pose(motion, rows, state, place, wish, NONE)
        outcome, levels = self.program.solve(posed), list(posed.problem.levels)
        first = self.first.solve(
            levels[:1], rows.matrix, rows.limit, u_lower=rows.lower, u_upper=rows.upper, fallback=v
        )
        return Tick(motion, rows, state, outcome, levels, first)


@pytest.mark.slow
def test_rows_hold_and_the_second_stage_changes_nothing_of_the_tasks() -> None:
    ticks = Ticks()
    assert ticks.constraints.size >= 40
    solved = binding = braked = second = 0
    for seed in range(TICKS):
        tick = ticks.random(seed)
        u, rows = tick.outcome.u, tick.rows
        assert np.isfinite(u).all()
        assert (u - rows.upper).max() <= 1e-8
        assert (rows.lower - u).max() <= 1e-8
        if tick.outcome.status.brakes:
            braked += 1
            np.testing.assert_array_equal(u, ticks.constraints.brake(tick.motion.v, rows))
            continue
        assert tick.outcome.status == tick.first.status == Status.OPTIMAL
        assert (rows.matrix @ u - rows.limit).max() <= 1e-8
        assert np.abs(tick.state.jacobian @ (u - tick.first.u)).max() <= 1e-8
        speeds = [np.linalg.norm(tick.motion.v + PERIOD * each) for each in (u, tick.first.u)]
        assert speeds[0] <= speeds[1] + 1e-9
        solved, binding = solved + 1, binding + (tick.outcome.active > 0)
        second += tick.outcome.levels == 2
    # It must not be true of nothing.
    assert solved >= 0.8 * TICKS
    assert second == solved
    assert binding >= 0.2 * solved
    assert braked < 0.2 * TICKS


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_torques_asked_for_only_where_they_bind_give_the_optimum_of_all_rows(share: float) -> None:
    ticks, bound = Ticks(), 0
    start = at(two_arms().parameters.default_posture)
    torque = share * ticks.limits.torque + np.abs(start.load)
    torque[3] = np.inf
    plain = [each for each in constraints() if not isinstance(each, JointTorqueLimit)]
    fewer = ConstraintSet(plain, ticks.limits, start, PERIOD, -2.0)
    every = ConstraintSet([JointTorqueLimit(torque), *plain], ticks.limits, start, PERIOD, -2.0)
    levels, criterion = task_levels(arm_tasks(), Weights(), LENGTH, PERIOD), JointSpeed(time_constant=0.1)
    late = TaskProgram(levels, criterion, fewer, torque, PERIOD, "daqp")
    all_at_once = TaskProgram(levels, criterion, every, np.full(N, np.inf), PERIOD, "daqp")
    assert late.num_rows == all_at_once.num_rows
    for seed in range(150):
        tick = ticks.random(seed)
        wish = tick.state.rate + 0.1 * np.random.default_rng(seed).normal(size=12)
        asked = (tick.state, tick.state.value + PERIOD * 0.5 * (tick.state.rate + wish), wish, NONE)
        rows, more = (each.rows(tick.motion, np.zeros(each.num_predicted_rates)) for each in (fewer, every))
        found = late.solve(late.pose(tick.motion, rows, *asked))
        expected = all_at_once.solve(all_at_once.pose(tick.motion, more, *asked))
        assert found.status == expected.status
        if not found.status.brakes:
            np.testing.assert_allclose(found.u, expected.u, atol=1e-6)
            assert JointTorqueLimit(torque).excess(tick.motion, found.u) <= 1e-7
            assert found.levels == expected.levels
        assert found.beyond == pytest.approx(expected.beyond, abs=1e-7)
        bound += JointTorqueLimit(torque).excess(tick.motion, found.u) > -1e-7
    assert bound > 5


def cost(level: Level, u: np.ndarray) -> float:
    return float((0.5 * u @ level.hessian + level.gradient) @ u)


@pytest.mark.slow
def test_both_stages_are_the_optima_of_a_reference_solver() -> None:
    ticks = Ticks()
    for seed in range(min(TICKS, 150)):
        tick = ticks.random(seed)
        if tick.outcome.status.brakes:
            continue
        rows = tick.rows
        given: tuple[Any, ...] = (rows.matrix, rows.limit, rows.lower, rows.upper)
        np.testing.assert_array_equal(tick.levels[1].gradient, tick.motion.v / PERIOD)
        assert distance_from_optimum(tick.levels[:1], tick.first.u, *given) <= 1e-6
        assert distance_from_optimum(tick.levels, tick.outcome.u, *given) <= 1e-6
        if seed < 100:  # an interior-point solver is good to 1e-5 here, on the expensive side
            first = tick.levels[0]
            best, mine = (cost(first, u) for u in (clarabel(first, *given), tick.first.u))
            assert mine <= best + 1e-9 * abs(best)
            assert mine == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_ticks_that_are_too_fast_for_their_walls_brake_within_the_joint_limits(seed: int) -> None:
    ticks = Ticks()
    tick = ticks.random(seed, fast=20.0)
    u, rows = tick.outcome.u, tick.rows
    assert np.isfinite(u).all()
    assert (u - rows.upper).max() <= 1e-8
    assert (rows.lower - u).max() <= 1e-8
    if tick.outcome.status.brakes:
        assert (np.abs(tick.motion.v + PERIOD * u) <= np.abs(tick.motion.v) + 1e-9).all()


def test_ranges_of_task_coordinates_are_rows_too() -> None:
    motion = at(two_arms().parameters.default_posture)
    task = arm_tasks()[0]
    value = task.state(motion).value
    y, _, row, _ = TaskRange(task, value - 0.1, value + 0.2).evaluate(motion)
    np.testing.assert_allclose(y, np.repeat([-0.2, -0.1], 6))
    assert np.shape(row) == (12, N)

"""The program of a controller: torque rows only when they bind, and the answer is the same as with them."""

from dataclasses import replace

import numpy as np
import pytest

from forcectl.qp.constrained_program import ConstrainedProgram, Problem, Smooth
from forcectl.qp.prioritized_program import Level
from forcectl.qp.quadratic_program import QuadraticProgram, Status
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import CartesianWall, ConstraintSet, JointTorqueLimit, checked_limits
from tests.examples.robot_controller_runs import robot_plant_model

N = 6
JOINTS = [f"joint {i + 1}" for i in range(N)]
FREE = np.zeros((1, N)), np.ones(1)  # a soft row that always holds


def motion(v: np.ndarray | None = None) -> RobotMotion:
    model = robot_plant_model()
    return RobotMotion(model.robot, model.robot.create_context(), model.start, np.zeros(N) if v is None else v)


def gathered(torque: np.ndarray) -> tuple[ConstraintSet, np.ndarray]:
    at = motion()
    limits = checked_limits(replace(robot_plant_model().robot.limits, torque=torque), at)
    return ConstraintSet([CartesianWall([2.0, 0.0, 0.0], [-1.0, 0.0, 0.0])], limits, at, 0.002, -1.0), limits.torque


@pytest.mark.parametrize("room", [0.02, 0.2, 1e3])
def test_the_answer_is_that_of_one_program_with_all_rows(room: float) -> None:
    random = np.random.default_rng(3)
    at = motion()
    torque = np.abs(at.load) + room * np.diag(at.inertia)
    torque[4] = np.inf
    constraints, torque = gathered(torque)
    program = ConstrainedProgram(constraints, torque, "daqp", joints=JOINTS, further={"force": 1e8})
    everything = QuadraticProgram(N, 1 + constraints.size + 2 * (N - 1))
    rows, limit = constraints.rows(at, np.zeros(1)), JointTorqueLimit(torque)
    more, allowed = limit.rows(at)
    matrix, upper = np.concatenate([FREE[0], rows.matrix, more]), np.concatenate([FREE[1], rows.limit, allowed])
    bound = 0
    for _ in range(50):
        gradient = random.normal(size=N) * 3
        found = program.solve(Problem(at, rows, [Level(np.eye(N), gradient)], FREE))
        expected = everything.solve(
            np.eye(N), gradient, matrix, upper, u_lower=rows.lower, u_upper=rows.upper, fallback=np.zeros(N)
        )
        assert found.status == expected.status == Status.OPTIMAL
        np.testing.assert_allclose(found.u, expected.u, atol=1e-8)
        assert limit.excess(at, found.u) <= 1e-8
        assert found.beyond <= 1e-8
        bound += found.active > 0
    assert (bound > 0) == (room < 1e3)


def test_without_a_solution_it_brakes_and_says_by_how_much_a_torque_is_beyond() -> None:
    v = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    at = motion(v)
    constraints, torque = gathered(np.abs(motion().load) + 1e-3)
    program = ConstrainedProgram(constraints, torque, "daqp", joints=JOINTS, further={"force": 1e8})
    rows = constraints.rows(at, np.zeros(1))
    rows = rows._replace(limit=np.full_like(rows.limit, -1e6), matrix=np.zeros_like(rows.matrix))  # 0 u <= -1e6
    outcome = program.solve(Problem(at, rows, [Level(np.eye(N), np.zeros(N))], FREE))
    assert outcome.status == Status.INFEASIBLE
    np.testing.assert_array_equal(outcome.u, constraints.brake(v, rows))
    assert outcome.beyond == pytest.approx(JointTorqueLimit(torque).excess(at, outcome.u))
    assert outcome.beyond > 0


def test_the_change_of_u_is_bounded_where_rows_leave_it_and_small_where_they_do_not() -> None:
    at = motion()
    constraints, torque = gathered(np.full(N, np.inf))
    program = ConstrainedProgram(constraints, torque, "daqp", joints=JOINTS)
    rows, last = constraints.rows(at, np.zeros(1)), np.linspace(-1.0, 1.0, N)
    row = np.eye(N)[:1]
    smooth = Smooth(last - 0.5, last + 0.5, last)
    level = Level(np.eye(N), np.full(N, -8.0))  # 8 everywhere is wanted

    within = program.solve(Problem(at, rows._replace(matrix=row, limit=np.zeros(1)), [level], smooth=smooth))
    np.testing.assert_allclose(within.u, np.minimum(last + 0.5, [0.0, *np.full(N - 1, np.inf)]), atol=1e-9)
    assert within.status == Status.OPTIMAL

    asked = Problem(at, rows._replace(matrix=row, limit=np.array([-3.0])), [level], smooth=smooth)
    beyond = program.solve(asked)
    assert beyond.status == Status.OPTIMAL
    assert beyond.u[0] == pytest.approx(-3.0)
    # Between what is wanted and the last u, near the last one.
    assert (beyond.u[1:] > last[1:]).all()
    assert (beyond.u[1:] < last[1:] + 1.0).all()
    free = program.solve(asked._replace(smooth=None))
    np.testing.assert_allclose(free.u, [-3.0, *np.full(N - 1, 8.0)], atol=1e-9)

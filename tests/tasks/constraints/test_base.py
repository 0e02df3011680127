"""Constraints as rows in joint accelerations: the bound of y'', the protocol, and walls of a user's own."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.robot.model import JointLimits
from forcectl.robot.robot_motion import ContactMotion, RobotMotion
from forcectl.tasks.constraints.base import (
    CartesianWall,
    Constraint,
    ConstraintSet,
    ForceLimit,
    JointTorqueLimit,
    checked_limits,
)
from forcectl.tasks.constraints.joint_bounds import bounded_acceleration
from tests.examples.robot_controller_runs import PERIOD, N, drive, make, robot_plant_model

NAMES = ("position_lower", "position_upper", "velocity", "acceleration", "torque")


def at(q: np.ndarray | None = None, v: np.ndarray | None = None, *, force: float = 0.0, dx: float = 0.0) -> RobotMotion:
    model = robot_plant_model()
    q = model.start if q is None else q
    motion = RobotMotion(model.robot, model.robot.create_context(), q, np.zeros(N) if v is None else v)
    motion.contact = ContactMotion(dx, 0.01, motion.jacobian[5], 0.3, 2e-4, force)
    return motion


def own_limits(**changes: Any) -> JointLimits:
    limits = robot_plant_model().robot.limits
    return JointLimits(**{name: np.asarray(changes.get(name, getattr(limits, name))) for name in NAMES})


def gather(*constraints: Any, gamma: float = -1.0, **limits: Any) -> ConstraintSet:
    return ConstraintSet(constraints, own_limits(**limits), at(), PERIOD, gamma)


# --- the bound of y'' ------------------------------------------------------------------------------------------------

NUMBERS = {"y": st.floats(-1.0, -1e-9), "rate": st.floats(-1.0, 1.0), "gamma": st.floats(-10.0, -0.05)}


@pytest.mark.slow
@settings(deadline=None, derandomize=True, max_examples=300)
@given(**NUMBERS)
def test_a_double_integrator_at_the_bound_keeps_the_constraint_and_comes_to_rest_on_it(
    y: float, rate: float, gamma: float
) -> None:
    if y - max(rate, 0.0) ** 2 / (2 * gamma) > 0:  # cannot be kept
        return
    braked = 0.0
    for _ in range(20000):
        a = min(bounded_acceleration(y, rate, gamma, PERIOD), 5.0)
        braked = min(braked, a)
        y, rate = y + PERIOD * rate + 0.5 * PERIOD**2 * a, rate + PERIOD * a
        assert y <= 1e-12
        if abs(y) < 1e-12 and abs(rate) < 1e-9:
            break
    assert abs(y) < 1e-9
    assert braked >= gamma * (1 + 1e-6)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.floats(-0.1, 0.1), st.floats(-1.0, 1.0), st.floats(-10.0, -0.05))
def test_the_bound_is_never_below_twice_gamma_and_the_way_back_within_gamma(
    y: float, rate: float, gamma: float
) -> None:
    one = bounded_acceleration(y, rate, gamma, PERIOD)
    assert one >= 2 * gamma * (1 + 1e-12)
    if y > 0:
        assert abs(one) <= -gamma * (1 + 1e-12)


def test_no_bound_far_away_and_nothing_for_what_is_no_number() -> None:
    assert bounded_acceleration(-math.inf, 0.1, -1.0, PERIOD) == math.inf
    for y, rate in ((math.nan, 0.0), (-1.0, math.nan), (math.inf, 0.0), (-1.0, math.inf), (-math.inf, math.nan)):
        assert math.isnan(bounded_acceleration(y, rate, -1.0, PERIOD))


def test_braking_that_is_late_by_what_a_tick_left_is_made_up_for() -> None:
    gamma, rate = -1.0, 0.5
    edge = rate**2 / (2 * gamma)
    for late in (1e-6, 1e-5, 1e-4):
        y, v = edge + late, rate
        for _ in range(2000):
            a = bounded_acceleration(y, v, gamma, PERIOD)
            y, v = y + PERIOD * v + 0.5 * PERIOD**2 * min(a, 1.0), v + PERIOD * min(a, 1.0)
            assert y < 1e-12


# --- the rows ----------------------------------------------------------------------------------------------------

WALLS = [
    CartesianWall([1.5, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    CartesianWall([0.0, 0.3, 0.9], [0.3, -1.0, 0.4], gamma=-0.2),
    ForceLimit(20.0),
]


@pytest.mark.parametrize("constraint", WALLS[:2])
def test_a_wall_is_its_distance_and_its_row_the_second_derivative(constraint: CartesianWall) -> None:
    rng = np.random.default_rng(2)
    q, v, u = robot_plant_model().start + 0.2 * rng.normal(size=N), rng.normal(size=N), rng.normal(size=N)
    h = 1e-4

    def along(t: float) -> float:
        return float(constraint.evaluate(at(q + t * v + 0.5 * t * t * u, v + t * u))[0])  # type: ignore[arg-type]

    _, rate, row, bias = constraint.evaluate(at(q, v))
    assert rate == pytest.approx((along(h) - along(-h)) / (2 * h), abs=1e-6)
    second = (along(h) - 2 * along(0) + along(-h)) / h**2
    assert np.asarray(row) @ u + bias == pytest.approx(second, abs=1e-5)


def test_the_force_limit_is_the_nearer_of_model_and_sensor() -> None:
    limit = ForceLimit(20.0)
    assert limit.evaluate(at(dx=-3.5e-3, force=5.0))[0] == pytest.approx(3.5e-3 - 20 * 2e-4)
    assert limit.evaluate(at(dx=-1e-3, force=19.0))[0] == pytest.approx(-0.5 * 2e-4)
    assert limit.evaluate(at(dx=-1e-3, force=21.0))[0] > 0
    _, rate, row, bias = limit.evaluate(at())
    assert (rate, bias) == (-0.01, -0.3)
    np.testing.assert_array_equal(row, -at().jacobian[5])


def test_rows_come_by_relative_degree_with_their_bounds() -> None:
    class Speed:
        relative_degree = 1

        def evaluate(self, motion: RobotMotion) -> Any:
            return [motion.velocity[3] - 0.1, -0.05], 0.0, np.vstack([motion.jacobian[3]] * 2), [motion.bias[3], 0.7]

    torque = JointTorqueLimit(np.array([100.0, np.inf, 200.0, np.inf, np.inf, np.inf]))
    together = gather(WALLS[0], Speed(), torque)
    motion = at(v=np.full(N, 0.05))
    wall = WALLS[0].evaluate(motion)
    rate = float(wall[1])  # type: ignore[arg-type]
    rows = together.rows(motion, np.array([rate]))
    assert together.size == 2 * 2 + 2 + 1
    assert rows.direct == 4
    u = np.arange(1.0, 7.0)
    tau = motion.inertia @ u + motion.load
    # Upper sides, then lower ones.
    beyond = [tau[0] - 100, tau[2] - 200, -tau[0] - 100, -tau[2] - 200]
    np.testing.assert_allclose(rows.matrix[:4] @ u - rows.limit[:4], beyond)
    speed = -(motion.velocity[3] - 0.1) / PERIOD - motion.bias[3]
    np.testing.assert_allclose(rows.limit[4:6], [speed, 0.05 / PERIOD - 0.7])
    expected = bounded_acceleration(float(wall[0]), float(wall[1]), -1.0, PERIOD) - wall[3]  # type: ignore[arg-type]
    assert rows.limit[6] == pytest.approx(float(expected))
    # What the tick before missed of y'' is missed again, it says; but no more than gamma.
    for predicted, missed in ((rate - 0.3 * PERIOD, 0.3), (rate + 9.0, -1.0), (math.nan, 0.0)):
        again = together.rows(motion, np.array([predicted]))
        assert again.limit[6] == pytest.approx(float(expected) - missed)
    np.testing.assert_allclose(together.predict_rates(rows, u), [rate + PERIOD * (rows.matrix[6] @ u + wall[3])])


def test_a_margin_is_kept_beside_a_constraint_and_rows_that_change_are_not_compared_with_the_tick_before() -> None:
    class Kept(CartesianWall):
        margin = 1e-3
        rows_change = True

    wall = Kept([1.5, 0.0, 0.0], [-1.0, 0.0, 0.0])
    together, motion = gather(wall), at(v=np.full(N, 0.05))
    y, rate, _, bias = (float(np.asarray(part).sum()) for part in wall.evaluate(motion))
    rows = together.rows(motion, np.array([rate - 0.3 * PERIOD]))
    assert rows.limit[0] == pytest.approx(bounded_acceleration(y + 1e-3, rate, -1.0, PERIOD) - bias)
    Kept.margin = -1.0
    with pytest.raises(BadInputError, match="margin of constraint Kept"):
        gather(wall)


def test_companions_of_a_constraint_come_with_it() -> None:
    wall = CartesianWall([1.5, 0.0, 0.0], [-1.0, 0.0, 0.0])
    wall.companions = (JointTorqueLimit(np.full(N, 100.0)), ForceLimit(20.0))  # type: ignore[attr-defined]
    together = gather(wall)
    assert together.size == 1 + 2 * N + 1
    assert together.rows(at(), np.zeros(2)).direct == 2 * N


def test_bounds_of_joints_far_from_their_limits_are_the_accelerations_and_near_them_what_braking_leaves() -> None:
    limits, start = own_limits(), robot_plant_model().start
    rows = gather().rows(at(), np.zeros(0))
    np.testing.assert_array_equal(rows.upper, limits.acceleration)
    np.testing.assert_array_equal(rows.lower, -limits.acceleration)
    upper = start + 0.01
    together = gather(position_upper=upper, velocity=np.full(N, 0.05))
    v = np.full(N, 0.04)
    rows = together.rows(at(v=v), np.zeros(0))
    expected = [
        min(a, (0.05 - 0.04) / PERIOD, bounded_acceleration(-0.01, 0.04, -0.5 * a, PERIOD)) for a in limits.acceleration
    ]
    np.testing.assert_allclose(rows.upper, expected)
    assert rows.violation == 0.0
    assert together.rows(at(v=np.full(N, 0.07)), np.zeros(0)).violation == pytest.approx(0.02)
    assert together.rows(at(q=upper + 1e-3), np.zeros(0)).violation == pytest.approx(1e-3)


def test_braking_brings_all_joints_to_rest_together() -> None:
    together = gather()
    q, v = robot_plant_model().start.copy(), np.array([0.5, -0.2, 0.1, 0.0, 0.3, 1.0])
    path = v / np.linalg.norm(v)
    for _ in range(200):
        u = together.brake(v, together.rows(at(q, v), np.zeros(0)))
        assert (np.abs(u) <= 0.5 * own_limits().acceleration * (1 + 1e-9)).all()
        v = v + PERIOD * u
        np.testing.assert_allclose(v - (v @ path) * path, 0.0, atol=1e-12)
    assert np.abs(v).max() < 1e-12


# --- a constraint of a user's own ------------------------------------------------------------------------------------


class Ceiling:
    """Ten lines: the tool stays below a height."""

    relative_degree = 2
    gamma = -0.5

    def __init__(self, height: float):
        self.height = height

    def evaluate(self, motion: RobotMotion) -> Any:
        z, dz = motion.position[2], motion.velocity[5]
        return z - self.height, dz, motion.jacobian[5], motion.bias[5]


@pytest.mark.slow
def test_a_users_constraint_is_kept() -> None:
    start = at().position
    forward = start[0] + 0.03

    class Front:
        relative_degree = 2

        def evaluate(self, motion: RobotMotion) -> Any:
            return motion.position[0] - forward, motion.velocity[3], motion.jacobian[3], motion.bias[3]

    def reference(k: int) -> np.ndarray:
        return np.array([0.0, 0.2, 0.2, 0.0, 0.0, 0.0]) * math.sin(0.006 * k)

    free = drive(make(), 600, reference=reference)
    kept = drive(make(constraints=[Front(), Ceiling(start[2] + 0.01)]), 600, reference=reference)
    furthest = [max(at(q).position[0] for q in log["joint_position_command"]) for log in (free, kept)]
    assert furthest[0] > forward + 0.01
    assert forward - 1e-3 < furthest[1] < forward + 1e-7
    assert kept["constraint_violation"].max() < 1e-7
    assert isinstance(Ceiling(1.0), Constraint)


@pytest.mark.parametrize(
    ("evaluate", "message"),
    [
        (lambda motion: (0.0, 0.0, np.zeros(5), 0.0), r"evaluate returned a row of shape \(5,\): must return"),
        (lambda motion: (0.0, 0.0, motion.jacobian[0]), r"evaluate must return .* but: ValueError"),
        (lambda motion: (-1.0, 0.0, motion.jacobian[3:], 0.0), "evaluate returned 1 y beside 3 rows: must return"),
        (lambda motion: 1 / 0, "but: ZeroDivisionError"),
        (lambda motion: (math.nan, 0.0, motion.jacobian[0], 0.0), "is not finite in the start posture"),
        (lambda motion: (0.2, 0.0, motion.jacobian[0], 0.0), "is violated in the start posture, by 0.2"),
        (lambda motion: ([0.0] * 3, 0.0, motion.jacobian[:2], 0.0), "evaluate must return"),
    ],
)
def test_a_constraint_that_does_not_keep_to_the_protocol_is_refused(evaluate: Any, message: str) -> None:
    kind = type("Mine", (), {"relative_degree": 2, "evaluate": lambda self, motion: evaluate(motion)})
    with pytest.raises(BadInputError, match=f"constraint Mine.*{message}"):
        gather(kind())


def test_constraints_without_degree_or_with_a_bad_one_or_gamma_are_refused() -> None:
    with pytest.raises(BadInputError, match="constraint object lacks relative_degree or evaluate"):
        gather(object())
    with pytest.raises(BadInputError, match=r"relative_degree of constraint Ceiling = 3: must be 0, 1 or 2"):
        gather(type("Ceiling", (Ceiling,), {"relative_degree": 3})(2.0))
    with pytest.raises(BadInputError, match=r"gamma of constraint Ceiling = 0\.5: must be below zero"):
        gather(type("Ceiling", (Ceiling,), {"gamma": 0.5})(2.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"velocity": np.zeros(N)}, r"limits\.velocity = .*: must be above zero"),
        ({"acceleration": np.full(N, np.nan)}, r"limits\.acceleration"),
        ({"torque": np.ones(3)}, r"limits\.torque = .*: must be 6 numbers"),
        ({"torque": np.ones(N)}, r"limits\.torque = .*: must be enough to hold the start posture"),
        ({"position_lower": np.full(N, 3.0), "position_upper": np.full(N, 2.0)}, r"limits\.position_lower = .*below"),
        ({"position_lower": np.full(N, 0.1), "position_upper": np.full(N, 2.0)}, "start posture .* is outside"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        checked_limits(own_limits(**changes), at())


def test_a_robot_without_acceleration_limits_gets_one() -> None:
    limits = checked_limits(own_limits(acceleration=np.full(N, np.inf)), at())
    np.testing.assert_array_equal(limits.acceleration, np.full(N, 20.0))

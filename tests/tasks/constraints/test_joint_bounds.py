"""The bounds of many joints are those of each joint alone, wherever they are and however fast."""

import numpy as np
import pytest

from forcectl.robot.model import JointLimits
from forcectl.tasks.constraints.joint_bounds import JointBounds, gradual_acceleration

PERIOD, N = 0.004, 14


def limits(rng: np.random.Generator) -> JointLimits:
    middle, half = rng.normal(size=N), rng.uniform(rng.choice([0.05, 3.0]), 6.0, size=N)
    low, high, speed = middle - half, middle + half, rng.uniform(0.5, 3.0, size=N)
    for limit, none in ((low, -np.inf), (high, np.inf), (speed, np.inf)):
        if rng.random() < 0.3:
            limit[rng.integers(N, size=2)] = none
    return JointLimits(low, high, speed, rng.uniform(2.0, 30.0, size=N), np.full(N, np.inf))


def of_one(whole: JointLimits, i: int) -> JointLimits:
    parts = (whole.position_lower, whole.position_upper, whole.velocity, whole.acceleration, whole.torque)
    return JointLimits(*(part[i : i + 1] for part in parts))


@pytest.mark.parametrize("approach", [0.0, 0.02])
def test_many_joints_are_bound_as_each_alone(approach: float) -> None:
    for seed in range(150):
        bound_as_each_alone(seed, approach)


def bound_as_each_alone(seed: int, approach: float) -> None:
    rng, named = np.random.default_rng(seed), f"seed {seed}"
    given = limits(rng)
    low = np.where(np.isfinite(given.position_lower), given.position_lower, -3.0)
    high = np.where(np.isfinite(given.position_upper), given.position_upper, 3.0)
    # From everything in the middle and slow to everything beyond its limits.
    spread, fast = rng.choice([0.1, 0.9, 1.01]), rng.choice([0.05, 0.95, 1.02])
    q = 0.5 * (low + high) + 0.5 * spread * (high - low) * rng.uniform(-1, 1, size=N)
    v = fast * np.minimum(given.velocity, 5.0) * rng.uniform(-1, 1, size=N)
    lower, upper, violation = JointBounds(given, PERIOD, approach).at(q, v)
    alone = [JointBounds(of_one(given, i), PERIOD, approach).at(q[i : i + 1], v[i : i + 1]) for i in range(N)]
    np.testing.assert_allclose(lower, [each[0][0] for each in alone], rtol=1e-12, atol=1e-10, err_msg=named)
    np.testing.assert_allclose(upper, [each[1][0] for each in alone], rtol=1e-12, atol=1e-10, err_msg=named)
    assert violation == pytest.approx(max(each[2] for each in alone), abs=1e-15), named


def push(approach: float, speed: float = 3.0, ticks: int = 1500) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration of a joint that always takes its upper bound, from -2 rad to its limit at 0."""
    one = JointLimits(*(np.array([each]) for each in (-np.inf, 0.0, speed, 25.0, np.inf)))
    bounds, q, v, found = JointBounds(one, PERIOD, approach), np.array([-2.0]), np.zeros(1), []
    for _ in range(ticks):
        u = bounds.at(q, v)[1]
        q, v = q + PERIOD * v + 0.5 * PERIOD**2 * u, v + PERIOD * u
        found.append((q.item(), v.item(), u.item()))
    position, rate, bend = np.array(found).T
    return position, rate, bend


def test_limits_are_kept_and_reached_and_approached_gradually() -> None:
    for speed in (0.05, 0.5, 3.0, 20.0):
        q, v, u = push(0.02, speed, 20000 if speed < 0.5 else 3000)
        assert q.max() <= 1e-12
        assert v.max() <= speed + 1e-12
        assert u.min() >= -12.5 - 1e-9
        assert q[-1] == pytest.approx(0.0, abs=1e-6)
        # From full acceleration to full braking with that time constant.
        assert np.abs(np.diff(u)).max() / PERIOD <= (25.0 + 12.5) / 0.02
    assert np.abs(np.diff(push(0.0)[2])).max() / PERIOD > 2 * (25.0 + 12.5) / 0.02


def test_braking_is_nearly_as_hard_as_without_a_time_constant() -> None:
    late = [np.argmax(push(approach)[0] > -1e-3) * PERIOD for approach in (0.02, 0.0)]
    assert 0.0 < late[0] - late[1] < 0.15


def test_the_gradual_bound_has_no_jump_and_no_corner_below_its_profile() -> None:
    for gamma in (-1.0, -12.5):
        y = -np.linspace(0.0, 5.0 * abs(gamma) * 0.02**2, 4001)
        bound = np.array([gradual_acceleration(each, 0.1, gamma, 0.02) for each in y.tolist()])
        assert np.abs(np.diff(bound)).max() < 0.01 * np.ptp(bound)


def test_a_joint_at_its_limit_counts_as_unable_to_move() -> None:
    given = JointLimits(np.array([-1.0, -1.0, -np.inf]), np.ones(3), np.ones(3), np.ones(3), np.ones(3))
    bounds = JointBounds(given, PERIOD)
    assert bounds.mobility(np.zeros(3)) is None
    np.testing.assert_allclose(bounds.mobility(np.array([1.0, -0.975, 0.0])), [0.0, 0.5, 1.0])  # type: ignore[arg-type]

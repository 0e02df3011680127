"""The bounds of many joints are those of each joint alone, wherever they are and however fast."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.robot.model import JointLimits
from forcectl.tasks.constraints.joint_bounds import JointBounds

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


def test_many_joints_are_bound_as_each_alone() -> None:
    for seed in range(150):
        bound_as_each_alone(seed)


def bound_as_each_alone(seed: int) -> None:
    rng, named = np.random.default_rng(seed), f"seed {seed}"
    given = limits(rng)
    low = np.where(np.isfinite(given.position_lower), given.position_lower, -3.0)
    high = np.where(np.isfinite(given.position_upper), given.position_upper, 3.0)
    # From everything in the middle and slow to everything beyond its limits.
    spread, fast = rng.choice([0.1, 0.9, 1.01]), rng.choice([0.05, 0.95, 1.02])
    q = 0.5 * (low + high) + 0.5 * spread * (high - low) * rng.uniform(-1, 1, size=N)
    v = fast * np.minimum(given.velocity, 5.0) * rng.uniform(-1, 1, size=N)
    lower, upper, violation = JointBounds(given, PERIOD).at(q, v)
    alone = [JointBounds(of_one(given, i), PERIOD).at(q[i : i + 1], v[i : i + 1]) for i in range(N)]
    np.testing.assert_allclose(lower, [each[0][0] for each in alone], rtol=1e-12, atol=1e-10, err_msg=named)
    np.testing.assert_allclose(upper, [each[1][0] for each in alone], rtol=1e-12, atol=1e-10, err_msg=named)
    assert violation == pytest.approx(max(each[2] for each in alone), abs=1e-15), named

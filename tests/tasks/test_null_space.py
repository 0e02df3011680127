"""Null-space criteria: (5.19), (5.20), potentials downhill, the reflected mass against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.tasks.null_space import (
    AwayFrom,
    AwayFromJointLimits,
    EvasiveMotion,
    JointSpeed,
    TowardsSmallMass,
)
from tests.examples.reactive_examples import N, at, two_arms

RNG = np.random.default_rng(2)
TS = 0.004
Q = two_arms().parameters.default_posture + 0.2 * RNG.normal(size=N)
V = RNG.normal(size=N)


def test_joint_speed_is_the_criterion_of_the_thesis() -> None:
    """min u'Ts^2 u + 2 Ts q''u, divided by 2 Ts^2: least for u = -q'/Ts, after which the joints are at rest."""
    H, g = JointSpeed().cost(at(Q, V), TS)
    np.testing.assert_array_equal(H, np.eye(N))
    np.testing.assert_allclose(V - TS * np.linalg.solve(H, g), 0.0, atol=1e-12)
    slower = JointSpeed(time_constant=0.1).cost(at(Q, V), TS)
    np.testing.assert_allclose(slower.gradient, g * TS / 0.1)


def test_evasive_motion_goes_to_the_speed_of_its_potentials_within_its_limit() -> None:
    class Push:
        def __init__(self, speed: float):
            self._speed = speed * np.arange(N)

        def speed(self, motion: object) -> np.ndarray:
            return self._speed

    H, g = EvasiveMotion([Push(0.01), Push(0.02)], time_constant=None).cost(at(Q, V), TS)
    np.testing.assert_allclose(V - TS * np.linalg.solve(H, g), 0.03 * np.arange(N), atol=1e-12)
    H, g = EvasiveMotion([Push(1.0)], speed=0.5, time_constant=None).cost(at(Q, V), TS)
    np.testing.assert_allclose(V - TS * g, 0.5 * np.arange(N) / (N - 1), atol=1e-12)


def test_joint_limits_push_towards_the_middle() -> None:
    limits = two_arms().limits
    push = AwayFromJointLimits(limits.position_lower, limits.position_upper, speed=0.3)
    middle = 0.5 * (limits.position_lower + limits.position_upper)
    np.testing.assert_allclose(push.speed(at(middle)), 0.0, atol=1e-12)
    np.testing.assert_allclose(push.speed(at(limits.position_upper)), -0.3)
    np.testing.assert_allclose(push.speed(at(limits.position_lower)), 0.3)
    free = AwayFromJointLimits(np.full(N, -np.inf), limits.position_upper)
    np.testing.assert_array_equal(free.speed(at(Q)), np.zeros(N))


def test_away_from_a_wall_is_downhill_and_none_far_from_it() -> None:
    height = at(Q).position[2]

    def cubed(q: np.ndarray) -> float:
        return 0.5 * 0.1 / 3 * max(1 + (height - 0.05 - at(q).position[2]) / 0.1, 0.0) ** 3

    near = AwayFrom(CartesianWall([0.0, 0.0, height - 0.05], [0.0, 0.0, 1.0]), range=0.1, speed=0.5)
    h = 1e-5
    slope = np.array([(cubed(Q + h * e) - cubed(Q - h * e)) / (2 * h) for e in np.eye(N)])
    np.testing.assert_allclose(near.speed(at(Q)), -slope, atol=1e-7)
    far = AwayFrom(CartesianWall([0.0, 0.0, height - 0.15], [0.0, 0.0, 1.0]), range=0.1)
    np.testing.assert_array_equal(far.speed(at(Q)), np.zeros(N))


@pytest.mark.parametrize("arm", ["left", "right"])
def test_reflected_mass_goes_down_along_its_exact_gradient(arm: str) -> None:
    mass = TowardsSmallMass(two_arms(), arm, [0.3, 1.0, -0.2], gain=2.0)
    h, here = 1e-5, mass.mass(at(Q))
    slope = np.array([(mass.mass(at(Q + h * e)) - mass.mass(at(Q - h * e))) / (2 * h) for e in np.eye(N)])
    np.testing.assert_allclose(mass.speed(at(Q)), -2.0 * slope / here, atol=1e-6)
    assert 0.1 < here < 20.0


def test_reflected_mass_is_force_by_acceleration() -> None:
    """A push along the direction on the robot at rest, without gravity: u = M^-1 J'F."""
    motion = at(Q)
    direction = np.array([0.0, 0.6, 0.8])
    J = direction @ motion.arm("right").jacobian[3:]
    acceleration = J @ np.linalg.solve(motion.inertia, J * 5.0)
    assert TowardsSmallMass(two_arms(), "right", direction).mass(motion) == pytest.approx(5.0 / acceleration)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_bad_numbers_are_refused(value: float) -> None:
    limits = two_arms().limits
    wall = CartesianWall([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    with pytest.raises(BadInputError, match="time_constant"):
        JointSpeed(value)
    with pytest.raises(BadInputError, match="speed"):
        AwayFromJointLimits(limits.position_lower, limits.position_upper, speed=value)
    with pytest.raises(BadInputError, match="range"):
        AwayFrom(wall, range=value)
    with pytest.raises(BadInputError, match="gain"):
        TowardsSmallMass(two_arms(), "left", [0, 0, 1], gain=value)
    with pytest.raises(BadInputError, match="lower"):
        AwayFromJointLimits(limits.position_upper, limits.position_lower)

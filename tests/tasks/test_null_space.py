"""Null-space criteria: (5.19), (5.20), potentials downhill, the reflected mass against finite differences."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.tasks.constraints.base import CartesianWall
from forcectl.tasks.null_space import (
    AwayFrom,
    AwayFromJointLimits,
    EvasiveMotion,
    JointSpeed,
    SelfMotion,
    TowardsSmallMass,
)
from forcectl.tasks.null_space_parts import SelfMotionConfig
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


def self_motion(**options: object) -> SelfMotion:
    return SelfMotion(two_arms(), **{"speed": 0.08, "fastest": 0.08, "time_constant": TS, **options})


def wanted(criterion: SelfMotion, q: np.ndarray, v: np.ndarray, memory: np.ndarray | None = None) -> np.ndarray:
    """The joint speeds that it asks for, with the time constant of a tick."""
    return v - TS * criterion.step(at(q, v), TS, criterion.memory if memory is None else memory)[0].gradient


def test_self_motion_moves_the_joints_of_both_arms_and_no_hand() -> None:
    speeds = wanted(self_motion(), Q, np.zeros(N))
    for name, arm in two_arms().parts.arms.items():
        assert np.linalg.norm(speeds[arm.joints]) == pytest.approx(0.08)
        np.testing.assert_allclose(at(Q).arm(name).jacobian @ speeds, 0.0, atol=1e-12)


def test_self_motion_is_faster_where_some_of_six_joints_would_be_slow() -> None:
    for slowest in (0.004, 0.02):
        speeds = wanted(self_motion(fastest=5.0, slowest=slowest), Q, np.zeros(N))
        for arm in two_arms().parts.arms.values():
            sixth = np.sort(np.abs(speeds[arm.joints]))[1]
            length = np.linalg.norm(speeds[arm.joints])
            assert sixth >= slowest - 1e-12
            assert length == pytest.approx(0.08) or sixth == pytest.approx(slowest)


def go(criterion: SelfMotion, duration: float, obeys: float) -> np.ndarray:
    """The ways of both arms over time, of joints that move as asked, or by a share of it."""
    memory, ways = criterion.memory, []
    v = np.zeros(N)
    for _ in range(round(duration / TS)):
        cost, memory = criterion.step(at(Q, v), TS, memory)
        v = obeys * (v - TS * cost.gradient)
        ways.append(memory[::3])
    return np.array(ways)


def turns(ways: np.ndarray) -> np.ndarray:
    """Times of the turns of the first arm [s]."""
    return TS * (1 + np.flatnonzero(np.diff(ways[:, 0])))


@pytest.mark.slow
def test_self_motion_turns_round_after_its_range_and_half_of_it_at_first() -> None:
    found = turns(go(self_motion(range=0.08), 3.0, 1.0))
    np.testing.assert_allclose(found, [0.5, 1.5, 2.5], atol=0.03)


def test_self_motion_turns_round_where_it_is_stopped() -> None:
    found = turns(go(self_motion(), 1.0, 0.05))
    np.testing.assert_allclose(np.diff(found), 0.15, atol=TS)
    assert len(turns(go(self_motion(), 1.0, 0.9))) == 0


def test_self_motion_is_smooth_along_any_way() -> None:
    """A null vector of a singular value decomposition would change its sign anywhere."""
    way = np.linspace(Q, Q + 0.5 * np.sin(np.arange(N)), 400)
    speeds = np.array([wanted(self_motion(), q, np.zeros(N)) for q in way])
    steps = np.linalg.norm(np.diff(speeds, axis=0), axis=1)
    assert steps.max() < 0.05 * 0.08


def test_self_motion_of_a_robot_whose_arms_have_no_null_space_is_refused() -> None:
    from forcectl.robot.model import RobotModel

    wanted = "must be of a robot with such an arm, but arm has 6 joints"
    with pytest.raises(BadInputError, match=f"moves an arm of 7 joints about its hand: {wanted}"):
        SelfMotion(RobotModel.load("comau_smart_six"))


def test_a_self_motion_that_is_slower_at_its_fastest_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"fastest = 0\.05: must be at least speed, 0\.08"):
        SelfMotion(two_arms(), fastest=0.05)


@pytest.mark.parametrize(("key", "value"), [("slowest", 10.0), ("speed", 0.3)])
def test_a_self_motion_that_is_faster_than_its_fastest_is_refused(key: str, value: float) -> None:
    with pytest.raises(BadInputError, match=rf"{key} = {value}: must be at most fastest = 0\.25 rad/s"):
        SelfMotionConfig(**{key: value})

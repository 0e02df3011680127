"""Trajectories against their limits, against Ruckig on its own, and with targets nobody should give."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from forcectl.errors import BadInputError
from forcectl.motion.trajectory import Limits, Motion, Planner, Target, TrajectoryState, begin, limits_of

TICK = 0.004
seeds = st.integers(0, 2**32 - 1)


def random_limits(rng: np.random.Generator, n: int) -> Limits:
    return limits_of(n, rng.uniform(0.1, 2, n), 10 ** rng.uniform(-0.5, 1.5, n), 10 ** rng.uniform(0.5, 3, n))


def at(position: object, velocity: object = 0.0, velocity_mode: object = 0.0) -> Target:
    p = np.asarray(position, dtype=float)
    return Target(p, np.broadcast_to(velocity, p.shape).astype(float), np.broadcast_to(velocity_mode, p.shape) * 1.0)


def check_step(before: TrajectoryState, after: TrajectoryState, limits: Limits) -> None:
    """The motion of one tick is one whose jerk is within its limit, and its velocity and acceleration are, too."""
    assert (np.abs(after.velocity) <= limits.velocity).all()
    assert (np.abs(after.acceleration) <= limits.acceleration).all()
    check_integration(before, after, limits)


def check_integration(before: TrajectoryState, after: TrajectoryState, limits: Limits) -> None:
    j = limits.jerk * (1 + 1e-9)
    gain = after.acceleration - before.acceleration
    assert (np.abs(gain) <= j * TICK + 1e-8).all()
    speed = after.velocity - before.velocity - TICK * before.acceleration
    assert (np.abs(speed) <= j * TICK**2 / 2 + 1e-8).all()
    way = after.position - before.position - TICK * before.velocity - TICK**2 / 2 * before.acceleration
    assert (np.abs(way) <= j * TICK**3 / 6 + 2e-8).all()


def check_same(state: TrajectoryState, other: TrajectoryState) -> None:
    np.testing.assert_array_equal(state[:], other[:])


def alone(start: Motion, target: Target, limits: Limits, synchronization: Synchronization) -> RuckigTrajectory:
    """What Ruckig answers by itself."""
    n = len(start.position)
    inputs, trajectory = InputParameter(n), RuckigTrajectory(n)
    inputs.current_position, inputs.current_velocity, inputs.current_acceleration = start
    inputs.target_position, inputs.target_velocity = target.position, target.velocity
    inputs.max_velocity, inputs.max_acceleration, inputs.max_jerk = limits
    inputs.synchronization = synchronization
    Ruckig(n).calculate(inputs, trajectory)
    return trajectory


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seed=seeds, synchronized=st.booleans(), every=st.sampled_from([1, 2, 7, 40]))
def test_limits_hold_whatever_the_targets(seed, synchronized, every):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    limits, state = random_limits(rng, n), begin(rng.normal(size=n))
    planner = Planner(limits, synchronized)
    for tick in range(160):
        if tick % every == 0:
            target = at(
                state.position + rng.normal(size=n) * 10 ** rng.uniform(-6, 1),
                rng.choice([0.0, 1.0]) * limits.velocity * rng.uniform(-2, 2, n),
                rng.random(n) < 0.2,
            )
        after = planner.follow(state, target, TICK)
        check_step(state, after, limits)
        assert not after.braking.any()
        state = after


@settings(max_examples=20, deadline=None)
@given(seed=seeds, synchronized=st.booleans())
def test_a_target_is_reached_in_the_time_that_ruckig_says(seed, synchronized):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    limits = random_limits(rng, n)
    planner = Planner(limits, synchronized)
    state = begin(rng.normal(size=n), 0.5 * limits.velocity * rng.uniform(-1, 1, n))
    target = at(rng.normal(size=n), limits.velocity * rng.choice([0.0, 0.5]))
    expected = alone(state.motion, target, limits, Synchronization.Time if synchronized else Synchronization.No)
    plan = planner.plan(state.motion, target)
    # Not later, or Ruckig alone has missed the fastest way.
    assert plan.duration <= expected.duration * (1 + 1e-8) + 1e-8
    if not synchronized:
        assert (plan.arrival <= np.array(expected.independent_min_durations) * (1 + 1e-8) + 1e-8).all()
    ticks = math.ceil(plan.duration / TICK - 1e-9)
    for tick in range(1, ticks + 1):
        state = planner.follow(state, target, TICK)
        assert state.arrived.all() == (tick == ticks)
    late = ticks * TICK - plan.arrival
    np.testing.assert_allclose(state.position, target.position + late * target.velocity, rtol=0, atol=3e-8)
    np.testing.assert_allclose(state.velocity, target.velocity, rtol=0, atol=1e-8)
    np.testing.assert_allclose(state.acceleration, 0.0, atol=1e-8)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=seeds, synchronized=st.booleans())
def test_targets_that_differ_by_rounding_do_not_make_it_later(seed, synchronized):
    """Ruckig alone, asked again at every tick, loses up to five seconds here."""
    rng = np.random.default_rng(seed)
    n = 3
    planner, state = Planner(random_limits(rng, n), synchronized), begin(np.zeros(n))
    target = at(rng.uniform(-1, 1, n))
    ticks = math.ceil(planner.plan(state.motion, target).duration / TICK) + 1
    for tick in range(ticks):
        state = planner.follow(state, at(target.position + 1e-12 * (tick % 2)), TICK)
    assert state.arrived.all()
    np.testing.assert_allclose(state.position, target.position, atol=1e-8)


def test_motions_from_rest_are_straight_when_synchronized():
    limits, start, goal = limits_of(3, 0.2, 5.0, 50.0), np.zeros(3), np.array([0.3, -0.2, 0.1])
    plan = Planner(limits).plan(begin(start).motion, at(goal))
    for share in (0.1, 0.4, 0.8):
        np.testing.assert_allclose(np.cross(plan.at(share * plan.duration).position, goal), 0.0, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_from_outside_the_limits_it_returns_and_stays_within(seed):
    rng = np.random.default_rng(seed)
    limits = random_limits(rng, 2)
    limits = limits._replace(jerk=10 * limits.jerk)
    planner = Planner(limits, synchronized=False)
    v, a = limits.velocity * rng.uniform(-3, 3, 2), limits.acceleration * rng.uniform(-3, 3, 2)
    state, target = begin(np.zeros(2), v, a), at(rng.normal(size=2))
    # Acceleration back to its limit, on to the other one, and at that down to the velocity limit.
    slowest = 5 * limits.acceleration / limits.jerk + (np.abs(v) + a**2 / limits.jerk) / limits.acceleration
    within = np.zeros(2, dtype=bool)  # for good: the acceleration, too, is gone before the velocity is at its limit
    for _ in range(math.ceil(slowest.max() / TICK)):
        after = planner.follow(state, target, TICK)
        check_integration(state, after, limits)
        to_come = after.velocity + after.acceleration * np.abs(after.acceleration) / (2 * limits.jerk)
        now = np.maximum(np.abs(to_come), np.abs(after.velocity)) <= limits.velocity
        now &= np.abs(after.acceleration) <= limits.acceleration
        assert (now | ~within).all()
        within, state = within | now, after
    assert within.all()


def test_smaller_limits_are_returned_to_without_a_jump():
    wide, narrow = Planner(limits_of(1, 1.0, 5.0, 50.0)), Planner(limits_of(1, 0.3, 2.0, 30.0))
    state, target = begin([0.0]), at([5.0])
    for _ in range(100):
        state = wide.follow(state, target, TICK)
    assert state.velocity > 0.9
    for _ in range(250):
        after = narrow.follow(state, target, TICK)
        check_integration(state, after, limits_of(1, 1.0, 5.0, 30.0))
        state = after
    assert state.velocity == pytest.approx(0.3)


def test_a_target_that_is_not_a_number_is_the_last_one():
    planner, state, plain = Planner(limits_of(2, 1.0, 5.0, 50.0)), begin(np.zeros(2)), begin(np.zeros(2))
    for tick in range(400):
        good = at([0.3, -0.2])
        spoilt = at([math.nan, -0.2]) if tick % 3 == 1 else at([0.3, -0.2], [0.0, math.inf])
        state = planner.follow(state, good if tick == 0 else spoilt, TICK)
        plain = planner.follow(plain, good, TICK)
        check_same(state, plain)
    assert state.arrived.all()
    never = planner.follow(begin([0.1, 0.2]), at([math.nan, math.nan]), TICK)
    np.testing.assert_array_equal(never.position, [0.1, 0.2])


def test_velocity_mode_takes_on_the_velocity_and_nothing_else():
    limits, state = limits_of(2, [0.2, 1.0], 2.0, 40.0), begin(np.zeros(2))
    planner = Planner(limits)
    for _ in range(200):
        after = planner.follow(state, at([math.nan, 0.1], [0.075, 0.0], [1, 0]), TICK)
        check_step(state, after, limits)
        state = after
    np.testing.assert_allclose(state.velocity, [0.075, 0.0], atol=1e-12)
    assert state.arrived.all()
    ahead = state.position[0]
    for _ in range(200):
        state = planner.follow(state, at([math.nan, 0.1], [9.0, 0.0], [1, 0]), TICK)
    assert state.velocity[0] == pytest.approx(0.2, rel=1e-8)
    for _ in range(800):
        state = planner.follow(state, at([ahead, 0.1]), TICK)
    np.testing.assert_allclose(state.position, [ahead, 0.1], atol=1e-8)


def test_a_group_that_stops_does_so_together_on_a_straight_line():
    speed = np.array([0.03, -0.005, 0.0, 0.012])
    planner = Planner(limits_of(4, [0.5, 0.5, 0.5, 1.5], [2.0, 2.0, 2.0, 6.0], [20.0, 20.0, 20.0, 60.0]))
    state, stop = begin(np.zeros(4), speed), at(np.zeros(4), velocity_mode=np.ones(4))
    for _ in range(30):
        state = planner.follow(state, stop, TICK)
        np.testing.assert_allclose(state.velocity, state.velocity[0] / speed[0] * speed, atol=1e-9)
    assert state.arrived.all()
    assert abs(state.position[0]) == pytest.approx(speed[0] * math.sqrt(speed[0] / 20.0), rel=1e-6)  # as fast as it can


def test_past_a_target_with_a_velocity_it_goes_on():
    planner, state = Planner(limits_of(2, 1.0, 5.0, 50.0), synchronized=False), begin(np.zeros(2))
    for tick in range(1000):
        # A new target of the other component leaves this one alone.
        state = planner.follow(state, at([0.2, 0.1 if tick < 500 else 0.3], [0.4, 0.0]), TICK)
        if tick > 250:
            assert state.velocity[0] == pytest.approx(0.4)
    assert state.position[0] > 1.0
    assert state.position[1] == pytest.approx(0.3)
    for _ in range(1000):
        state = planner.follow(state, at([0.2, 0.3]), TICK)
    np.testing.assert_allclose(state.position, [0.2, 0.3], atol=1e-8)


def test_a_target_that_moves_is_caught_up_with_slowly():
    limits, state, behind = limits_of(1, 1.0, 5.0, 100.0), begin([0.0]), []
    planner = Planner(limits)
    for tick in range(1000):
        moving = 0.3 + 0.2 * TICK * tick
        after = planner.follow(state, at([moving], 0.2), TICK)
        check_step(state, after, limits)
        state = after
        behind.append(moving + 0.2 * TICK - state.position[0])
    assert behind[500] < 2e-3
    assert 0 < behind[999] < behind[500]


def test_what_cannot_be_planned_brakes_and_the_rest_goes_on():
    limits, state = limits_of(2, 1.0, 5.0, 50.0), begin(np.zeros(2), [0.8, 0.0])
    planner = Planner(limits)
    for _ in range(300):
        after = planner.follow(state, at([1e200, 0.3]), TICK)
        check_step(state, after, limits)
        np.testing.assert_array_equal(after.braking, [1, 0])
        state = after
    assert state.velocity[0] == pytest.approx(0.0, abs=1e-9)
    assert state.position[1] == pytest.approx(0.3)
    np.testing.assert_array_equal(state.arrived, [0, 1])
    for _ in range(500):
        state = planner.follow(state, at([0.1, 0.3]), TICK)
    np.testing.assert_allclose(state.position, [0.1, 0.3], atol=1e-8)


def test_from_an_absurd_motion_it_stands_still():
    start = Motion(np.array([1.0, 2.0]), np.array([1e9, 0.0]), np.zeros(2))
    plan = Planner(limits_of(2, 1.0, 5.0, 50.0)).plan(start, at([0.0, 0.0]))
    np.testing.assert_array_equal(plan.braking, [1, 1])
    np.testing.assert_array_equal(plan.at(3.0), [[1, 2], [0, 0], [0, 0]])
    assert not np.isfinite(plan.arrival).any()


def test_results_depend_on_the_trajectory_only():
    rng = np.random.default_rng(3)
    limits, state = random_limits(rng, 3), begin(np.zeros(3))
    planner, other = Planner(limits), state
    for tick in range(200):
        target = at([0.3, -0.2, 0.1] if tick < 70 else [0.0, 0.5, 0.2])
        state = planner.follow(state, target, TICK)
        other = Planner(limits).follow(other, target, TICK)
        check_same(state, other)


def test_a_generator_is_led_by_a_motion_that_is_not_its_own():
    limits, state, target = limits_of(2, 1.0, 5.0, 50.0), begin(np.zeros(2)), at([0.4, -0.3])
    planner = Planner(limits)
    for _ in range(60):
        state = planner.follow(state, target, TICK)
    rounded = Motion(*(x + 1e-13 for x in state.motion))
    check_same(planner.follow(state, target, TICK, rounded), planner.follow(state, target, TICK))
    pushed = state.motion._replace(position=state.position + np.array([0.01, 0.0]))
    after = planner.follow(state, at([math.nan] * 2), TICK, pushed)
    np.testing.assert_array_equal(after.target_position, target.position)
    check_step(TrajectoryState(np.array([*pushed, *state[3:]])), after, limits)
    for _ in range(600):
        after = planner.follow(after, target, TICK)
    np.testing.assert_allclose(after.position, target.position, atol=1e-8)
    # Before the first plan there is no target to keep.
    after = planner.follow(begin(np.zeros(2)), at([math.nan] * 2), TICK, Motion(*np.ones((3, 2))))
    np.testing.assert_array_equal(after.target_position, [1.0, 1.0])


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ((0.0, 1.0, 1.0), "velocity_limit = 0.0: must be positive"),
        ((1.0, [1.0, -1.0], 1.0), "acceleration_limit"),
        ((1.0, 1.0, math.inf), "jerk_limit"),
        ((1.0, math.nan, 1.0), "acceleration_limit"),
        ((1.0, [1.0] * 3, 1.0), "acceleration_limit has shape (3,)"),
        ((1e3, 1.0, 1.0), "takes 1e+03 s from rest"),
        ((1.0, 1.0, 1e-6), "takes 2e+03 s from rest"),
    ],
)
def test_limits_that_cannot_be_are_refused(limits, message):
    with pytest.raises(BadInputError) as caught:
        limits_of(2 if np.size(limits[1]) > 1 else 1, *limits)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_motion_that_is_not_finite_is_refused():
    with pytest.raises(BadInputError, match="velocity"):
        begin([0.0, 1.0], [0.0, math.nan])
    start = Motion(np.array([math.nan]), np.zeros(1), np.zeros(1))
    with pytest.raises(BadInputError, match="start"):
        Planner(limits_of(1, 1.0, 1.0, 1.0)).plan(start, at([1.0]))
    with pytest.raises(BadInputError, match="size"):
        limits_of(0, 1.0, 1.0, 1.0)


def test_targets_that_are_changed_in_place_are_noticed():
    limits, state, goal = limits_of(2, 1.0, 5.0, 50.0), begin(np.zeros(2)), np.array([0.1, 0.2])
    planner = Planner(limits)
    for tick in range(600):
        if tick == 10:
            goal[0] = -0.1
        state = planner.follow(state, Target(goal, np.zeros(2), np.zeros(2)), TICK)
    np.testing.assert_allclose(state.position, [-0.1, 0.2], atol=1e-8)
    with pytest.raises(ValueError, match="read-only"):
        limits.velocity[0] = 2.0


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seed=seeds, size=st.sampled_from([57.29577951308232, 1e3, 1e5]))
def test_large_units_are_as_good_as_small_ones(seed, size):
    """Degrees, millimetres: the same motion in other numbers."""
    rng = np.random.default_rng(seed)
    limits = random_limits(rng, 2)
    planner, other = Planner(limits), Planner(limits_of(2, *(size * np.array(limits))))
    state, scaled = begin([0.1, 0.2]), begin([0.1 * size, 0.2 * size])
    for tick in range(150):
        if tick % 50 == 0:
            goal = rng.normal(size=2)
        state = planner.follow(state, at(goal), TICK)
        scaled = other.follow(scaled, at(size * goal), TICK)
        np.testing.assert_allclose(np.array(scaled.motion) / size, state.motion, rtol=1e-6, atol=2e-7)
        assert not scaled.braking.any()


SCRIPT = """
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import ConstantVectorSource
from forcectl.motion.trajectory import Motion, Planner, Target, limits_of

planner = Planner(limits_of(1, 1.0, 1.0, 1.0))
planner.plan(Motion([0.0], [0.0], [0.0]), Target([1.0], [0.0], [0.0]))
simulator = Simulator(ConstantVectorSource([0.0]))
simulator.set_monitor(lambda context: planner)  # in a circle through Drake: never freed
"""


@pytest.mark.slow
def test_nothing_is_said_of_a_planner_that_outlives_python():
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert ended.stderr == ""

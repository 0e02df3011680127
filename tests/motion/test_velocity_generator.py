"""Algorithm 3 as it is printed, and as a block."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator

from forcectl.framework.batch import SCALAR_MATH
from forcectl.motion.velocity_generator import velocity_step
from forcectl.testing import run_diagram
from tests.examples.motion_examples import velocity_generator

TICK = 0.004
numbers = st.floats(-10, 10)
positive = st.floats(1e-3, 100)


def as_printed(x: float, v: float, a_max: float, v_trg: float) -> tuple[float, float, float]:
    """Algorithm 3, line by line."""
    a = (v_trg - v) / TICK if abs(v_trg - v) / a_max <= TICK else math.copysign(a_max, v_trg - v)
    return x + TICK * v + 0.5 * TICK**2 * a, v + TICK * a, a


@given(x=numbers, v=numbers, a_max=positive, v_trg=numbers, v_max=positive)
def test_it_is_the_printed_algorithm_within_the_velocity_limit(x, v, a_max, v_trg, v_max):
    expected = as_printed(x, v, a_max, max(-v_max, min(v_trg, v_max)))
    single = velocity_step(x, v, v_trg, v_max, a_max, TICK, SCALAR_MATH)
    np.testing.assert_allclose(single, expected, rtol=1e-12, atol=1e-12)
    several = velocity_step(*(np.array([value, value]) for value in (x, v, v_trg, v_max, a_max)), TICK)
    np.testing.assert_array_equal(np.transpose(several), [single, single])


@given(v=numbers, a_max=positive, targets=st.lists(numbers, min_size=1, max_size=20))
def test_limits_hold_and_the_velocity_never_overshoots(v, a_max, targets):
    x, v_max = 0.0, 2.0
    for target in targets:
        aim = max(-v_max, min(target, v_max))
        x_next, v_next, a = velocity_step(x, v, target, v_max, a_max, TICK, SCALAR_MATH)
        assert abs(a) <= a_max
        assert abs(v_next) <= max(abs(v), v_max)
        assert (v_next - aim) * (v - aim) >= 0.0
        # The mean velocity of the tick, exactly: acceleration is constant in it.
        assert x_next - x == pytest.approx(TICK * (v + v_next) / 2, abs=1e-12)
        x, v = x_next, v_next


def run(values: list[list[float]], **changed: object) -> np.ndarray:
    """Position, velocity and acceleration at every tick, shape (ticks, 3, n)."""
    block = velocity_generator(len(values[0]), **changed)
    simulator, rows = Simulator(block), []
    context = simulator.get_mutable_context()
    for tick, value in enumerate(values):
        if tick > 0:
            simulator.AdvanceTo(tick * TICK)
        block.GetInputPort("target_velocity").FixValue(context, value)
        rows.append([block.GetOutputPort(name).Eval(context) for name in ("position", "velocity", "acceleration")])
    return np.array(rows)


def test_the_block_reaches_the_target_velocity_and_keeps_it():
    out = run([[0.075, 9.0]] * 100, initial_position=[1.0, 2.0])
    np.testing.assert_allclose(out[0, :, 0], [1.0 + 0.5 * TICK**2 * 3.0, TICK * 3.0, 3.0])
    # 0.075 in 6.25 ticks of 3 u/s^2; the limit of 0.5 instead of 9.
    np.testing.assert_array_equal(out[7:, 1, 0], 0.075)
    np.testing.assert_array_equal(out[-1, 1:], [[0.075, 0.5], [0.0, 0.0]])
    np.testing.assert_allclose(out[-1, 0, 0], 1.0 + 0.075 * (100 * TICK - 0.075 / (2 * 3.0)), atol=1e-4)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("size", [1, 2])
def test_a_bad_target_keeps_the_last_one(bad, size):
    good, spoilt = [0.2] * size, [bad] * size
    np.testing.assert_array_equal(run([good] * 60), run([good, *[spoilt] * 59]))
    np.testing.assert_array_equal(run([spoilt] * 5)[:, 1:], 0.0)


def test_without_a_velocity_limit_any_target_will_do():
    out = run([[40.0]] * 20, velocity_limit=math.inf, acceleration_limit=math.inf)
    np.testing.assert_array_equal(out[:, 1], 40.0)


def test_a_start_that_is_given_takes_the_place_of_its_own_state():
    block = velocity_generator(2, acceleration_limit=math.inf)
    inputs = {"start_position": [1.0, math.nan], "start_velocity": [0.25, 0.0], "target_velocity": [0.0, 0.5]}
    log = run_diagram(block, 10 * TICK, period=TICK, inputs=inputs)
    # (6.6)*: it stops within the tick, half a step further on. The other one has no start and goes on by itself.
    np.testing.assert_allclose(log["position"][:, 0], 1.0 + 0.5 * TICK * 0.25)
    np.testing.assert_allclose(log["position"][-1, 1], 0.5 * TICK * 10.5)

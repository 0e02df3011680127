"""Reversals at rest: what counts and what does not."""

import numpy as np
import pytest

from forcectl.analysis.motion_metrics import reversals_at_rest

PERIOD = 0.004
TIME = np.arange(0.0, 3.0, PERIOD)


def count(position: np.ndarray) -> float:
    """Of one joint beside one that stands."""
    both = np.stack([position, np.zeros_like(position)], axis=1)
    return reversals_at_rest(both, np.gradient(both, PERIOD, axis=0), PERIOD)


@pytest.mark.parametrize(("amplitude", "expected"), [(1e-4, 20.0), (0.9e-3, 20.0), (1.5e-3, 0.0)])
def test_a_joint_that_shakes_within_2_mrad_reverses_twice_a_period(amplitude: float, expected: float) -> None:
    assert count(amplitude * np.sin(2 * np.pi * 10.0 * TIME)) == pytest.approx(expected, abs=1)


def test_the_busiest_second_counts() -> None:
    shakes = (TIME > 1.0) & (TIME < 1.5)
    assert count(np.where(shakes, 1e-4 * np.sin(2 * np.pi * 10.0 * TIME), 0.0)) == pytest.approx(10, abs=2)


def test_a_move_to_rest_and_shaking_too_weak_do_not_count() -> None:
    share = np.clip(TIME, 0.0, 1.0)
    assert count(10 * share**3 - 15 * share**4 + 6 * share**5) <= 1
    assert count(1e-4 * np.sin(2 * np.pi * 4.0 * TIME)) == 0  # 0.06 rad/s^2


def test_a_joint_that_turns_round_does_not_rest() -> None:
    assert count(0.3 * np.sin(2 * np.pi * TIME)) == 0


def test_a_joint_that_shakes_in_an_arm_that_moves_is_not_at_standstill() -> None:
    position = np.stack([1e-4 * np.sin(2 * np.pi * 10.0 * TIME), 0.1 * np.maximum(TIME - 1.0, 0.0)], axis=1)
    speed = np.gradient(position, PERIOD, axis=0)
    assert reversals_at_rest(position, speed, PERIOD, TIME > 1.1) == pytest.approx(20, abs=1)
    assert reversals_at_rest(position, speed, PERIOD, TIME > 1.1, [slice(0, 2)]) == 0
    assert reversals_at_rest(position, speed, PERIOD, together=[slice(0, 2)]) == pytest.approx(17, abs=2)
    assert reversals_at_rest(position, speed, PERIOD, TIME > 1.1, [slice(0, 1), slice(1, 2)]) > 18


def test_a_log_that_is_too_short_has_none() -> None:
    assert count(np.zeros(3)) == 0

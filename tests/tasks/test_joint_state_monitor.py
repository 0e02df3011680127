"""Readings: numbers, frozen encoders, lost samples, and joints that do not follow."""

from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.tasks.joint_state_monitor import JointStateMonitor, Readings

PERIOD, NONE = 0.004, np.zeros(2)
BEGIN = Readings(np.full(2, np.nan), NONE, np.ones(2), 0.0)


def monitor(**changes: Any) -> JointStateMonitor:
    return JointStateMonitor(
        2, **{"longest_gap": 0.02, "frozen_distance": 0.01, "largest_error": 0.3, "period": PERIOD} | changes
    )


def state(read: np.ndarray, command: np.ndarray, speed: np.ndarray = NONE) -> list[Readings]:
    """Readings (k, 2) with their commands (k, 2)."""
    found, past = [], BEGIN
    for position, q in zip(read, command, strict=True):
        past = monitor().update(past, position, speed, q)
        found.append(past)
    return found


def ramp(ticks: int, speed: float = 1.0) -> np.ndarray:
    return speed * PERIOD * np.arange(ticks)[:, None] * np.ones(2)


def test_a_robot_that_follows_is_good() -> None:
    found = state(ramp(20) - 0.02, ramp(20))
    assert all((each.reading_ok == 1).all() and each.reading_gap == 0 for each in found)


def test_at_rest_readings_repeat() -> None:
    found = state(np.zeros((50, 2)) + 0.1, np.zeros((50, 2)) + 0.1)
    assert all((each.reading_ok == 1).all() for each in found)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_bad_for_its_joint(bad: float) -> None:
    read = ramp(10)
    read[4:, 1] = bad
    found = state(read, ramp(10))
    np.testing.assert_array_equal(found[3].reading_ok, [1, 1])
    np.testing.assert_array_equal(found[4].reading_ok, [1, 0])
    assert found[-1].reading_gap == 6
    assert np.isfinite(found[-1].read_position).all()
    np.testing.assert_array_equal(state(ramp(2), ramp(2), np.array([0.0, bad]))[-1].reading_ok, [1, 0])


def test_an_encoder_is_frozen_once_its_command_has_moved_on() -> None:
    read = ramp(20)
    read[5:, 0] = read[4, 0]
    found = state(read, ramp(20))
    good = [each.reading_ok[0] for each in found]
    # 10 mrad at 4 mrad a tick.
    assert good[:7] == [1] * 7
    assert good[7:] == [0] * 13
    assert all(each.reading_ok[1] == 1 for each in found)
    read[15:, 0] = ramp(20)[15:, 0]
    assert state(read, ramp(20))[-1].reading_ok[0] == 1


def test_every_joint_may_have_its_own_distance() -> None:
    watch, past = monitor(frozen_distance=[0.002, 0.02]), BEGIN
    for k, good in enumerate([[1, 1], [0, 1], [0, 1], [0, 1], [0, 1], [0, 1], [0, 0]]):
        past = watch.update(past, NONE, NONE, ramp(7)[k])  # 4 mrad a tick
        np.testing.assert_array_equal(past.reading_ok, good)


def test_a_jitter_of_the_command_about_a_joint_that_sticks_is_none() -> None:
    command = 0.004 * (np.arange(60)[:, None] % 2) * np.ones(2)
    assert all((each.reading_ok == 1).all() for each in state(np.zeros((60, 2)), command))


def test_a_joint_that_does_not_follow_is_bad() -> None:
    found = state(ramp(100) * 0.1 + 1e-5, ramp(100))
    assert found[70].reading_ok.min() == 1
    assert found[99].reading_ok.max() == 0


def test_few_bad_ticks_are_passed_over() -> None:
    watch = monitor()
    assert not watch.stops(BEGIN._replace(reading_gap=5.0))
    assert watch.stops(BEGIN._replace(reading_gap=6.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [("longest_gap", -1.0), ("frozen_distance", 0.0), ("frozen_distance", [1.0, -1.0]), ("largest_error", np.nan)],
)
def test_bad_numbers_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(BadInputError, match=name):
        monitor(**{name: value})

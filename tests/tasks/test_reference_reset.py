"""What a generator goes on from: its own reference, a point ahead of the motion, or the motion."""

from __future__ import annotations

import numpy as np

from forcectl.tasks.reference_reset import LENGTH, ReferenceReset

SCALE = np.array([1.0, 1.0, 1.0, 0.28, 0.28, 0.28] * 2)
X = np.linspace(-0.1, 0.3, 12)
TARGET = X + np.array([0.3, 0.4, 0.0, 0.0, 0.0, 0.0] * 2)
NONE = np.zeros(12)


def start(reference: np.ndarray, rate: np.ndarray = NONE, target: np.ndarray | None = TARGET) -> tuple[np.ndarray, ...]:
    return ReferenceReset([6, 6], SCALE).start((X, rate, NONE + 7.0), (reference, NONE + 1.0, NONE + 2.0), target)


def test_a_reference_that_is_followed_is_gone_on_from_bit_for_bit() -> None:
    reference = X + 0.9 * LENGTH * np.array([1.0, 0, 0, 0, 0, 0] * 2)
    position, velocity, acceleration = start(reference)
    assert position is reference
    np.testing.assert_array_equal(velocity, NONE + 1.0)
    np.testing.assert_array_equal(acceleration, NONE + 2.0)


def test_one_that_is_not_starts_ahead_of_the_motion_in_that_task_alone() -> None:
    reference = X + 2 * LENGTH * np.array([1.0] + [0.0] * 11)
    rate = np.array([0.1, -0.05, 0.2] + [0.0] * 9)
    position, velocity, acceleration = start(reference, rate)
    way = np.array([0.6, 0.8, 0.0])
    np.testing.assert_allclose(position[:3], X[:3] + 0.9 * LENGTH * way)
    # 0.1 * 0.6 - 0.05 * 0.8: what there is of speed on the way to the target.
    np.testing.assert_allclose(velocity[:3], 0.02 * way, atol=1e-15)
    np.testing.assert_array_equal(acceleration[:6], 0.0)
    np.testing.assert_array_equal(position[6:], reference[6:])
    np.testing.assert_array_equal(velocity[6:], 1.0)


def test_speed_away_from_the_target_is_not_kept() -> None:
    _, velocity, _ = start(X + 1.0, -TARGET)
    np.testing.assert_array_equal(velocity, NONE)


def test_at_the_target_there_is_nothing_ahead() -> None:
    position, velocity, _ = start(X + 1.0, NONE + 0.3, X.copy())
    np.testing.assert_allclose(position, X)
    assert np.isfinite(velocity).all()


def test_angles_count_by_their_scale() -> None:
    turned = X + np.array([0.0] * 5 + [1.1 * LENGTH / 0.28] + [0.0] * 6)
    assert start(turned)[0] is not turned
    less = X + np.array([0.0] * 5 + [0.9 * LENGTH / 0.28] + [0.0] * 6)
    assert start(less)[0] is less


def test_without_a_target_it_is_the_motion() -> None:
    for target in (None, np.full(12, np.nan)):
        position, velocity, acceleration = start(X + 1.0, NONE + 0.3, target)
        np.testing.assert_array_equal(position, X)
        np.testing.assert_array_equal(velocity, 0.3)
        np.testing.assert_array_equal(acceleration, 7.0)

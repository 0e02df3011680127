"""What a generator goes on from: its own reference, as far as it is near the motion and leaves it slowly."""

import numpy as np
import pytest

from forcectl.tasks.reference_reset import LENGTH, RATE, TURNING, ReferenceReset

PERIOD = 0.004
SCALE = np.array([1.0, 1.0, 1.0, 0.28, 0.28, 0.28] * 2)
X = np.linspace(-0.1, 0.3, 12)
TARGET = X + np.array([0.3, 0.4, 0.0, 0.0, 0.0, 0.0] * 2)
NONE = np.zeros(12)
ALONG_X = np.array([1.0] + [0.0] * 11)


def start(
    position: np.ndarray,
    velocity: np.ndarray = NONE,
    rate: np.ndarray = NONE,
    target: np.ndarray | None = TARGET,
    acceleration: np.ndarray = NONE,
) -> tuple[np.ndarray, ...]:
    return ReferenceReset([6, 6], SCALE, PERIOD).start((X, rate, NONE), (position, velocity, acceleration), target)


def test_a_reference_that_is_followed_is_gone_on_from_bit_for_bit() -> None:
    reference, velocity = X + 0.4 * LENGTH * ALONG_X, 0.5 * RATE * LENGTH * ALONG_X
    found = start(reference, velocity)
    assert found[0] is reference
    assert found[1] is velocity


def test_one_that_leaves_too_fast_is_slowed_down_in_that_task_alone() -> None:
    speed, gain = np.full(12, 0.3), np.full(12, 2.0)
    position, velocity, acceleration = start(X + 0.4 * LENGTH * ALONG_X, speed, acceleration=gain)
    np.testing.assert_allclose(position, X + 0.4 * LENGTH * ALONG_X)
    assert velocity[0] == pytest.approx(0.6 * RATE * LENGTH)
    assert acceleration[0] == pytest.approx(0.0)
    for found, whole in ((velocity, speed), (acceleration, gain)):
        np.testing.assert_array_equal(found[1:], whole[1:])


def test_it_may_come_back_at_any_speed() -> None:
    velocity = -3.0 * ALONG_X
    assert start(X + 0.4 * LENGTH * ALONG_X, velocity)[1] is velocity


def test_it_is_never_further_away_than_its_length() -> None:
    position = start(X + 5 * LENGTH * np.sign(SCALE))[0]
    apart = np.linalg.norm((SCALE * (position - X)).reshape(2, 6), axis=1)
    assert (apart <= LENGTH * (1 + 1e-12)).all()


def test_it_depends_on_its_input_without_a_jump() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        direction, velocity = rng.normal(size=(2, 12))
        direction /= np.linalg.norm(SCALE * direction)
        for length in (0.5 * LENGTH, LENGTH):
            pairs = [start(X + (length + step) * direction, 0.1 * velocity) for step in (-1e-9, 1e-9)]
            for before, after in zip(*pairs, strict=True):
                np.testing.assert_allclose(before, after, atol=1e-5)


def test_a_blocked_reference_turns_to_the_target_and_rests() -> None:
    """The motion stands; the generator does nothing of its own."""
    motion = (X, NONE, NONE)
    reference = (X + LENGTH * np.tile([0, 0, 1.0, 0, 0, 0], 2), np.tile([0.1, -0.2, 0.3, 0, 0, 0], 2), NONE)
    reset = ReferenceReset([6, 6], SCALE, PERIOD)
    for _ in range(round(8 * TURNING / PERIOD)):
        position, velocity, _ = reset.start(motion, reference, TARGET)
        reference = (position + PERIOD * velocity, velocity, NONE)
    np.testing.assert_allclose(reference[0], X + LENGTH * np.tile([0.6, 0.8, 0, 0, 0, 0], 2), atol=0.05 * LENGTH)
    np.testing.assert_allclose(reference[1], 0.0, atol=1e-3)


def test_angles_count_by_their_scale() -> None:
    angle = np.array([0.0] * 5 + [1.0] + [0.0] * 6)
    less = X + 0.4 * LENGTH / 0.28 * angle
    assert start(less)[0] is less
    assert start(X + 2 * LENGTH / 0.28 * angle)[0][5] == pytest.approx(X[5] + LENGTH / 0.28, rel=0.03)


@pytest.mark.parametrize("target", [None, np.full(12, np.nan)])
def test_without_a_target_it_comes_back_to_the_motion(target: np.ndarray | None) -> None:
    position, velocity, _ = start(X + LENGTH * ALONG_X, NONE + 1.0, NONE + 0.3, target)
    assert X[0] < position[0] < X[0] + LENGTH
    assert 0.3 < velocity[1] < 1.0
    assert np.isfinite(position).all()


def test_a_target_that_is_no_number_is_that_of_its_task_alone() -> None:
    position, rate = X + 3 * LENGTH * np.tile([0.6, 0.0, 0.8, 0.0, 0.0, 0.0], 2), np.full(12, 0.1)
    half = np.where(np.arange(12) == 2, np.nan, TARGET)
    both, some, none = (start(position, rate, rate, target) for target in (TARGET, half, np.full(12, np.nan)))
    for found, first, second in zip(some, none, both, strict=True):
        np.testing.assert_array_equal(found, np.concatenate([first[:6], second[6:]]))
    assert (both[1][6:] != none[1][6:]).any()

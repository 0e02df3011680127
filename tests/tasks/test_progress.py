"""Reached, and given up."""

import numpy as np

from forcectl.tasks.progress import Progress, TaskProgress

TARGET, PERIOD = np.array([1.0, -2.0]), 0.01
BEGIN = Progress(np.full(2, np.nan), np.inf, 0.0, 0.0, 0.0)
NONE = np.zeros(2)


def state(errors: list[float], target: np.ndarray = TARGET, speed: float = 0.0) -> list[Progress]:
    watch, past, found = TaskProgress(np.array([0.1, 0.2]), 0.05, PERIOD), BEGIN, []
    for error in errors:
        past = watch.update(past, target, target + np.array([0.0, error]), NONE + speed)
        found.append(past)
    return found


def test_reached_within_the_tolerance_and_at_rest() -> None:
    assert [each.reached for each in state([1.0, 0.21, 0.19, -0.19])] == [0, 0, 1, 1]
    assert state([0.1], speed=10.0)[-1].reached == 0


def test_stalled_after_its_patience_without_coming_nearer() -> None:
    stalled = [each.stalled for each in state([1.0] * 8)]
    assert stalled == [0, 0, 0, 0, 0, 0, 1, 1]
    creeping = state(list(1.0 - 0.005 * np.arange(10)))
    assert creeping[-1].stalled == 1
    coming = state(list(0.9 ** np.arange(14)))
    assert max(each.stalled for each in coming) == 0


def test_progress_and_a_new_target_end_it() -> None:
    stuck = state([1.0] * 8)[-1]
    watch = TaskProgress(np.array([0.1, 0.2]), 0.05, PERIOD)
    assert watch.update(stuck, TARGET, TARGET + np.array([0.0, 0.5]), NONE).stalled == 0
    assert watch.update(stuck, TARGET + 1.0, TARGET, NONE).stalled == 0
    assert watch.update(stuck, TARGET * np.nan, TARGET, NONE) == stuck

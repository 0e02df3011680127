"""Random reaching with both arms: no limit is ever violated, and a target is reached or said to be out of reach.

FORCECTL_RANDOM_TASKS=200 runs all of them, two minutes; docs/reactive_control.md says how they ended.
"""

from __future__ import annotations

import os
from functools import cache

import numpy as np
import pytest

from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from tests.examples.reactive_examples import reactive_controller
from tests.examples.reactive_runs import PERIOD, Reacher, random_goal

pytestmark = pytest.mark.slow

TASKS = int(os.environ.get("FORCECTL_RANDOM_TASKS", "5"))
DISTANCE = 0.01


@cache
def distances() -> LinkDistance:
    return LinkDistance(RobotShapes.load("yumi", None), DISTANCE, period=PERIOD)


@cache
def reacher() -> Reacher:
    return Reacher(reactive_controller(constraints=[distances()]))


def free_goal(seed: int) -> np.ndarray:
    """A posture anywhere within the joint limits in which the links keep their distance."""
    return next(
        goal for k in range(1000) if distances().distances(goal := random_goal(1000 * seed + k)).min() > 1.5 * DISTANCE
    )


@pytest.mark.parametrize("seed", range(TASKS))
def test_limits_hold_and_targets_are_reached_or_reported(seed: int, record_property: pytest.RecordProperty) -> None:
    found = reacher().reach(free_goal(seed), longest=15.0)
    record_property("reached", found.reached)
    assert max(found.beyond) <= 1e-6
    assert min(distances().distances(q).min() for q in found.postures) >= DISTANCE - 1e-6
    assert found.reached != found.stalled
    if found.reached:
        assert found.offset <= 1e-3
        assert found.angle <= np.radians(1.0)


def test_goals_near_by_are_reached() -> None:
    """Without limits in the way there is no excuse."""
    free = Reacher()
    for seed in range(3):
        found = free.reach(random_goal(seed, 0.3))
        assert found.reached
        assert max(found.beyond) <= 1e-6

"""Closed-loop inverse kinematics: critically damped near the path, at rest on it from afar, never beyond its limit."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.force.invariance.tracking import Tracking

STILL = np.zeros(6)
PERIOD = 0.002


def tool(x: float, v: float) -> Any:
    """A tool at x along the first axis; what a motion has of it."""
    speed = np.array([0.0, 0.0, 0.0, v, 0.0, 0.0])
    return SimpleNamespace(
        position=np.array([x, 0.0, 0.0]),
        rotation=np.eye(3),
        v=speed,
        bias=STILL,
        jacobian=np.eye(6),
    )


def acceleration(x: float, v: float, across: np.ndarray | None = None) -> np.ndarray:
    return Tracking(30.0, 2.0, 0.5).acceleration(
        tool(x, v), tool(0.0, 0.0), STILL, STILL, np.eye(6) if across is None else across
    )


def test_near_the_path_it_is_proportional_and_critically_damped() -> None:
    assert acceleration(1e-3, 0.01)[3] == pytest.approx(-900 * 1e-3 - 60 * 0.01)
    assert not acceleration(1e-3, 0.01, np.diag([1.0, 1.0, 1.0, 0.0, 1.0, 1.0])).any()


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.001, 0.02, 0.5, 3.0])
def test_from_anywhere_it_comes_to_rest_without_overshoot_within_its_acceleration(start: float) -> None:
    x, v, least = start, 0.0, start
    for _ in range(5000):
        a = acceleration(x, v)[3]
        assert abs(a) <= 2.0 * (1 + 1e-12)
        x, v = x + PERIOD * v + 0.5 * PERIOD**2 * a, v + PERIOD * a
        least = min(least, x)
    assert least > -1e-3 * start
    assert abs(x) < 1e-6 * start


def test_bad_values_are_refused() -> None:
    for bad in ((0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0)):
        with pytest.raises(BadInputError):
            Tracking(*bad)

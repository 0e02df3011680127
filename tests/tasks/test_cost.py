"""The cost (5.16): its curvature and slope against the cost itself, what is convex, how errors die out."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.tasks.coordinates import TaskState
from forcectl.tasks.cost import Deviation, TaskCost, Weights

K, TS = 4, 0.004
NONE = Deviation(np.zeros(K), np.zeros(K))


def random_weights(seed: int) -> dict[str, Any]:
    """A convex block matrix with position weights of the size they need."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2 * K, 2 * K)) * np.repeat([1 / TS, 1.0], K)[:, None]
    Q = root @ root.T
    return {
        "position": Q[:K, :K],
        "cross": Q[:K, K:],
        "velocity": Q[K:, K:],
        "position_slope": rng.normal(size=K),
        "velocity_slope": rng.normal(size=K),
    }


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_curvature_and_slope_are_those_of_the_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cost = TaskCost(Weights(**random_weights(seed)), np.ones(K), TS)
    x, rate, place, speed = rng.normal(size=(4, K)) * np.array([1e-3, 0.1, 1e-3, 0.1])[:, None]
    state = TaskState(x, rate, np.zeros((K, K)), np.zeros(K))

    def at(a: np.ndarray) -> float:
        return cost.value(x + TS * rate + 0.5 * TS**2 * a - place, rate + TS * a - speed)

    a, b = rng.normal(size=(2, K)) * 10
    slope = cost.slope(state, place, speed, NONE)
    model = [0.5 * u @ cost.curvature @ u + slope @ u for u in (a, b)]
    assert (at(a) - at(b)) / TS**2 == pytest.approx(model[0] - model[1], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("rate", [5.0, 40.0, 100.0])
def test_an_error_of_the_position_dies_out_at_its_rate(rate: float) -> None:
    cost = TaskCost(Weights(rate=rate, correction=0.0), np.ones(1), TS)
    x, v, none, error = np.array([1e-3]), np.zeros(1), np.zeros(1), []
    for _ in range(200):
        state = TaskState(x, v, np.eye(1), none)
        a = -cost.slope(state, none, none, Deviation(x, v)) / cost.curvature[0]
        x, v = x + TS * v + 0.5 * TS**2 * a, v + TS * a
        error.append(x.item())
    late = np.array(error[20:60])
    np.testing.assert_allclose(np.log(late[1:] / late[:-1]) / TS, -rate, rtol=0.25)
    assert min(error) > -1e-9


def test_a_deviation_decays_with_its_time_constant_and_not_within_a_tick() -> None:
    """As d'' = -(d' + r d)/T from rest; the reference moves on with constant acceleration."""
    r, T, period = 40.0, 0.01, 1e-4  # a tick so short that it hardly matters
    cost = TaskCost(Weights(rate=r, correction=T), np.ones(1), period)
    x, v, d = np.array([1e-3]), np.array([0.2]), []
    for k in range(300):
        (place, speed), (ahead, faster) = (
            (np.array([0.2 * t + 1.5 * t * t]), np.array([0.2 + 3.0 * t])) for t in (k * period, (k + 1) * period)
        )
        d.append((x - place).item())
        state = TaskState(x, v, np.eye(1), np.zeros(1))
        a = -cost.slope(state, ahead, faster, Deviation(x - place, v - speed)) / cost.curvature[0]
        x, v = x + period * v + 0.5 * period**2 * a, v + period * a
    time = period * np.arange(300)
    pole = np.roots([1.0, 1.0 / T, r / T])[0]
    exact = np.real(np.exp(pole * time) * (1.0 + 1j * pole.real / pole.imag)) * 1e-3
    np.testing.assert_allclose(d, exact, atol=2e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_a_motion_on_its_reference_is_the_optimum_of_the_cost_with_any_time_constant(seed: int, T: float) -> None:
    rng, weights = np.random.default_rng(seed), random_weights(seed)
    x, rate, place, speed = rng.normal(size=(4, K))
    state = TaskState(x, rate, np.zeros((K, K)), np.zeros(K))
    slopes = [
        TaskCost(Weights(**weights, correction=each), np.ones(K), TS).slope(state, place, speed, NONE)
        for each in (T, 0.0)
    ]
    np.testing.assert_array_equal(*slopes)


def test_lengths_and_angles_are_compared_by_their_scale() -> None:
    cost = TaskCost(Weights(), np.array([1 / 0.28, 1.0]), TS)
    assert cost.curvature[0, 0] * 0.28**2 == pytest.approx(cost.curvature[1, 1])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"position": -1.0}, "negative eigenvalue"),
        ({"velocity": -np.eye(K)}, "negative eigenvalue"),
        ({"cross": 1e5}, "negative eigenvalue"),
        ({"position": np.triu(np.ones((K, K)))}, "weights.position .*symmetric"),
        ({"position": 0.0, "velocity": [1.0, 1.0, 1.0, 0.0]}, "costs nothing"),
        ({"position": np.ones(3)}, r"weights.position has shape \(3,\)"),
        ({"velocity": [np.nan] * K}, "weights.velocity .*finite"),
        ({"position": "soft"}, "weights.position .*numbers"),
        ({"position_slope": np.ones(K + 1)}, "weights.position_slope"),
    ],
)
def test_weights_that_are_not_convex_or_do_not_fit_are_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        TaskCost(Weights(**{"position": 1e3} | changes), np.ones(K), TS)

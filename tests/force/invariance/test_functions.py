"""Invariance functions against the maximum found by bisection."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.force.invariance import functions as iv

STATES = 10_000
DEGREES = range(1, 7)
finite = st.floats(-100.0, 100.0).map(lambda v: 0.0 if abs(v) < 1e-6 else v)


def polynomial(derivatives: np.ndarray, t: np.ndarray) -> np.ndarray:
    """sum_k derivatives[:, k] t^k/k!, by powers."""
    return sum(derivatives[:, k] * t**k / math.factorial(k) for k in range(derivatives.shape[1]))


def brute_force(xi: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Maximum of p over t >= 0 without solving a polynomial.

    Between two neighbouring stationary points of a function there is at most one root of it, and bisection finds it:
    from the (r-1)th derivative, a straight line, down to p'. An end that is no root is tried as well, which is how
    double roots are found.
    """
    degree = xi.shape[1]
    every = np.column_stack([xi, gamma])
    # Beyond this time each lower term of p' is below a share of the highest that sums to less than one.
    reach = [
        np.abs(2**k * every[:, degree - k] * math.factorial(degree - 1) / math.factorial(degree - 1 - k) / gamma)
        ** (1 / k)
        for k in range(1, degree)
    ]
    points = [np.zeros(len(xi)), *([np.max(reach, axis=0)] if reach else [])]
    for order in range(degree - 1, 0, -1):
        derivative = every[:, order:]
        roots = []
        for low, high in itertools.pairwise(points):
            sign = np.sign(polynomial(derivative, low))
            for _ in range(130):  # of halving: roots far smaller than the largest keep their digits
                middle = 0.5 * (low + high)
                before = np.sign(polynomial(derivative, middle)) == sign
                low, high = np.where(before, middle, low), np.where(before, high, middle)
            roots.append(low)
        points = list(np.sort([*points, *roots], axis=0))
    return np.max([polynomial(every, t) for t in points], axis=0)


def random_states(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """States of many kinds: ordinary, of widely different scales, zero, at rest, and with double and triple roots."""
    rng = np.random.default_rng(degree)
    xi = rng.normal(size=(STATES, degree))
    gamma = -(10.0 ** rng.uniform(-4, 5, STATES))
    wide = slice(4000, 7000)
    xi[wide] *= 10.0 ** rng.uniform(-8, 8, (3000, degree))
    xi[7000:7100] = 0.0
    xi[7100:7500, 1:] = 0.0
    xi[7500:8000] *= rng.integers(0, 2, (500, degree))
    for i in range(8000, STATES if degree >= 3 else 0):
        roots = rng.normal(size=degree - 1) * 10.0 ** rng.uniform(-2, 2)
        roots[1 : 3 if i % 3 == 0 else 2] = roots[0]
        p_dot = np.poly(roots)[::-1] * gamma[i] / math.factorial(degree - 1)
        xi[i, 1:] = p_dot[:-1] * [math.factorial(k) for k in range(degree - 1)]
    return xi, gamma


@pytest.mark.parametrize("degree", DEGREES)
def test_equals_brute_force_maximisation(degree: int) -> None:
    xi, gamma = random_states(degree)
    if degree >= 5:  # what takes longest by bisection: every fourth of each kind
        xi, gamma = xi[::4], gamma[::4]
    expected = brute_force(xi, gamma)
    np.testing.assert_allclose(iv.invariance_function(xi, gamma), expected, rtol=1e-9, atol=0)
    if degree == 4:
        np.testing.assert_allclose(iv.invariance_4(tuple(xi.T), gamma), expected, rtol=1e-9, atol=0)


def test_low_degrees_by_their_printed_formulas() -> None:
    rng = np.random.default_rng(0)
    y, v, a = rng.normal(size=(3, 2000))
    gamma = -np.abs(rng.normal(size=2000))
    np.testing.assert_array_equal(iv.invariance_function(y[:, None], gamma), y)
    second = np.where(v <= 0, y, y - v**2 / (2 * gamma))
    np.testing.assert_allclose(iv.invariance_function(np.stack([y, v], 1), gamma), second, rtol=1e-12)
    root = a**2 - 2 * gamma * v  # (3.8)*
    t = -a / gamma + np.sqrt(np.maximum(root, 0) / gamma**2)
    third = np.where(((v <= 0) & (a <= 0)) | (root <= 0), y, np.maximum(y, y + v * t + a * t**2 / 2 + gamma * t**3 / 6))
    np.testing.assert_allclose(iv.invariance_function(np.stack([y, v, a], 1), gamma), third, rtol=1e-12, atol=1e-14)
    # The example by which the print is refuted.
    assert iv.invariance_function([-1.0, -1.0, 1.5], -1.0) == -1.0


@pytest.mark.parametrize("number", [1, 3])
def test_algorithm_1_for_one_and_three_real_roots(number: int) -> None:
    """Its cases, written out on roots that are known because the polynomial is made of them."""
    rng = np.random.default_rng(number)
    for _ in range(300):
        gamma, y = -float(rng.uniform(0.1, 10)), float(rng.normal())
        real = np.sort(rng.normal(size=number) * 3)
        pair = complex(rng.normal(), rng.uniform(0.5, 2))
        roots = real if number == 3 else [real[0], pair, pair.conjugate()]
        p_dot = np.real(np.poly(roots))[::-1] * gamma / 6
        state = [y, p_dot[0], p_dot[1], 2 * p_dot[2]]

        def p(t: float, state: list[float] = state, gamma: float = gamma) -> float:
            return state[0] + state[1] * t + state[2] * t**2 / 2 + state[3] * t**3 / 6 + gamma * t**4 / 24

        first, last = real[0], real[-1]
        if last <= 0:
            expected = y
        elif number == 1:
            expected = p(last)
        else:
            expected = max(p(last), y) if first <= 0 else max(p(first), p(last))
        for phi in (iv.invariance_function(state, gamma), iv.invariance_4(state, gamma, iv.FLOAT_MATH)):
            assert phi == pytest.approx(expected, rel=1e-10)


def test_batch_elements_give_the_same_bits_as_arrays() -> None:
    xi, gamma = random_states(4)
    together = iv.invariance_4(tuple(xi.T), gamma)
    alone = [iv.invariance_4(tuple(x), g, iv.FLOAT_MATH) for x, g in zip(xi.tolist(), gamma.tolist(), strict=True)]
    np.testing.assert_array_equal(together, alone)


@settings(max_examples=60)
@given(st.lists(finite, min_size=1, max_size=6), st.floats(0.01, 1e4), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_units_of_time_and_of_the_output_do_not_matter(state, bound, time, unit):
    """Phi of the same motion in other units, [s] -> [time s] and [y] -> [unit y], is the same."""
    scale = unit * time ** np.arange(len(state) + 1)
    there = iv.invariance_function(np.array(state) * scale[:-1], -bound * scale[-1])
    assert there == pytest.approx(unit * float(iv.invariance_function(state, -bound)), rel=1e-9, abs=1e-12 * unit)


@settings(max_examples=60)
@given(st.lists(finite, min_size=2, max_size=6), st.floats(0.01, 100.0), st.floats(0.0, 0.05))
def test_phi_does_not_grow_while_the_highest_derivative_is_gamma(state, bound, dt):
    """Positive invariance (3.15): one exact step with y^(r) = gamma leaves Phi where it is, or lowers it."""
    degree = len(state)
    derivatives = [*state, -bound]
    after = [sum(derivatives[k + j] * dt**j / math.factorial(j) for j in range(degree + 1 - k)) for k in range(degree)]
    before = float(iv.invariance_function(state, -bound))
    assert float(iv.invariance_function(after, -bound)) <= before + 1e-9 * (1 + abs(before))


def test_stacks_of_states_broadcast_against_gamma() -> None:
    xi = np.random.default_rng(4).normal(size=(3, 5, 4))
    gamma = np.array([-1.0, -2.0, -3.0, -4.0, -5.0])
    phi = iv.invariance_function(xi, gamma)
    assert phi.shape == (3, 5)
    assert phi[2, 3] == iv.invariance_function(xi[2, 3], -4.0)
    assert iv.invariance_function(xi[0, 0], gamma).shape == (5,)
    assert iv.invariance_function([1.0, 2.0], -1.0).shape == ()


def test_a_state_that_is_not_a_number_gives_none() -> None:
    for degree in DEGREES:
        xi = np.zeros((2, degree))
        xi[1, -1] = math.nan
        np.testing.assert_array_equal(np.isnan(iv.invariance_function(xi, -1.0)), [False, True])


@settings(max_examples=60)
@given(st.lists(finite, min_size=1, max_size=6), st.floats(0.01, 100.0), st.floats(0.0, 10.0))
def test_the_subset_lies_within_the_set(state, bound, alpha):
    """Phi(xi_hat) >= Phi(xi): keeping the virtual state (3.78) admissible keeps the state admissible (3.72)."""
    virtual = [state[0], *((1 + alpha) * rate for rate in state[1:])]
    inside = iv.invariance_function(virtual, -bound)
    assert inside >= iv.invariance_function(state, -bound) - 1e-12 * (1 + abs(inside))


# --- bad input --------------------------------------------------------------------------------------------------------


def test_bad_states_and_bounds() -> None:
    for gamma in (0.0, 1.0, math.nan, -math.inf, [-1.0, 0.5]):
        with pytest.raises(BadInputError, match="gamma"):
            iv.invariance_function([[1.0, 2.0], [1.0, 2.0]], gamma)
    for state in ([], 1.0, np.zeros((3, 0)), ["high", "low"]):
        with pytest.raises(BadInputError, match="state"):
            iv.invariance_function(state, -1.0)
    with pytest.raises(BadInputError, match="gamma has shape"):
        iv.invariance_function(np.zeros((4, 2)), [-1.0, -1.0, -1.0])


@given(finite, finite, finite, st.floats(-100.0, -0.01))
@settings(max_examples=50)
def test_distance_from_the_edge_of_the_set_and_its_rate(y, rate, acceleration, gamma):
    distance = float(iv.set_distance(y, rate, gamma))
    assert distance == pytest.approx(float(iv.invariance_function([-y, -rate], gamma)))
    assert distance >= -y
    # Its rate is the difference over a time in which the speed does not change its sign.
    step = 1e-6 if rate == 0 else min(1e-6, 0.1 * abs(rate) / (abs(acceleration) + 1))
    later = y + step * rate + 0.5 * step**2 * acceleration, rate + step * acceleration
    if rate != 0:
        slope = (float(iv.set_distance(*later, gamma)) - distance) / step
        expected = float(iv.set_distance_rate(rate, acceleration, gamma))
        scale = 1 + abs(y) + (abs(rate) + abs(acceleration) + acceleration**2) * (1 + 1 / abs(gamma))
        assert slope == pytest.approx(expected, abs=2e-6 * scale + 1e-9 * scale / step)


# --- design rules of relative degree 4 --------------------------------------------------------------------------------


def test_least_gamma_is_the_worst_state_at_its_best_control() -> None:
    """(3.67)* by brute force: y^(4) by (3.65)* from the rates of (3.62)*, on the corners and at random states."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        w, z = rng.uniform(5.0, 80.0), rng.uniform(0.3, 1.5)
        c, most = 10 ** rng.uniform(-5, -3), rng.uniform(0.01, 1.0)
        box = rng.uniform(0.0, [1e-3, 5e-3, 5e-3])
        corners = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))
        lag, rate, command_rate = (box * np.vstack([corners, rng.uniform(-1.0, 1.0, (200, 3))])).T
        acceleration = w**2 * lag - 2 * z * w * rate
        y2, y3 = -acceleration / c, -(w**2 * command_rate - w**2 * rate - 2 * z * w * acceleration) / c
        reached = [-(w**2) / c * u - w**2 * y2 - 2 * z * w * y3 for u in np.linspace(-most, most, 5)]
        expected = np.max(np.min(reached, axis=0))
        found = iv.least_gamma(w, z, c, most, lag=box[0], speed=box[1], command_speed=box[2])
        assert found == pytest.approx(expected, rel=1e-9)
        assert iv.least_gamma(w, z, c, most) == pytest.approx(-(w**2) * most / c, rel=1e-12)


def test_alpha_for_a_rate_is_the_corrected_rule_and_lies_on_the_edge_of_the_set() -> None:
    rng = np.random.default_rng(8)
    for _ in range(50):
        gamma, error, rate = -(10 ** rng.uniform(0, 5)), rng.uniform(0.5, 20.0), rng.uniform(1.0, 100.0)
        printed = 0.5 * (3 * error / rate) ** (2 / 3) * (-gamma / rate) ** (1 / 3) - 1  # (3.81)*
        assert iv.alpha_for_rate(3, gamma, error, rate) == pytest.approx(printed, rel=1e-12)
        for degree in (2, 3, 4, 5):
            alpha = iv.alpha_for_rate(degree, gamma, error, rate)
            virtual = [-error, (1 + alpha) * rate, *np.zeros(degree - 2)]
            assert float(iv.invariance_function(virtual, gamma)) == pytest.approx(0.0, abs=1e-9 * error)


def test_alpha_for_an_uncertainty_is_strictly_above_the_ratio() -> None:
    """(3.83): the alpha that a compliance believed too large leaves is above zero, or what the rate needs."""
    for ratio in (1.0, 1.5, 3.0):
        assert (1 + iv.alpha_for_uncertainty(ratio)) / ratio == pytest.approx(1.3)
        assert (1 + iv.alpha_for_uncertainty(ratio, 2.0)) / ratio == pytest.approx(1.3 * 3.0)
        assert iv.alpha_for_uncertainty(ratio, -0.5) == iv.alpha_for_uncertainty(ratio)

"""Invariance functions against the maximum found by bisection, and the bounds and rules of Sec. 3.7.1 against roots."""

from __future__ import annotations

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
FUNCTIONS = (iv.invariance_function, iv.invariance_function_by_roots)
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
    expected = brute_force(xi, gamma)
    for function in FUNCTIONS:
        np.testing.assert_allclose(function(xi, gamma), expected, rtol=1e-9, atol=0)


@pytest.mark.parametrize("degree", DEGREES)
def test_no_point_of_a_dense_grid_is_higher(degree: int) -> None:
    xi, gamma = (part[:300] for part in random_states(degree))
    phi, best = iv.invariance_function(xi, gamma), iv.maximising_time(xi, gamma)
    times = np.linspace(0.0, 3.0, 2001) * np.maximum(best, 1e-3)[:, None]
    grid = sum(xi[:, k, None] * times**k / math.factorial(k) for k in range(degree))
    grid = grid + gamma[:, None] * times**degree / math.factorial(degree)
    assert np.all(grid.max(axis=1) <= phi + 1e-12 * np.abs(phi))
    assert np.all(best >= 0.0)


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
        assert iv.invariance_function(state, gamma) == pytest.approx(expected, rel=1e-10)


def test_batch_elements_give_the_same_bits_as_arrays() -> None:
    xi, gamma = random_states(4)
    together = iv.invariance_4(tuple(xi.T), gamma)
    alone = [iv.invariance_4(tuple(x), g, iv.FLOAT_MATH) for x, g in zip(xi.tolist(), gamma.tolist(), strict=True)]
    np.testing.assert_array_equal(together, alone)
    np.testing.assert_array_equal(together, iv.invariance_function(xi, gamma))


@pytest.mark.parametrize("degree", DEGREES)
def test_gradient_against_finite_differences(degree: int) -> None:
    rng = np.random.default_rng(10 + degree)
    xi, gamma, h = rng.normal(size=(400, degree)), -rng.uniform(0.5, 2.0, 400), 1e-6
    gradient = iv.invariance_gradient(xi, gamma)
    for k in range(degree):
        step = h * np.eye(degree)[k]
        before, after = iv.maximising_time(xi - step, gamma), iv.maximising_time(xi + step, gamma)
        # Two equal maxima, or the onset of one (there t* has a vertical tangent): Phi has no second derivative.
        smooth = np.abs(after - before) < 1e-3
        numeric = (iv.invariance_function(xi + step, gamma) - iv.invariance_function(xi - step, gamma)) / (2 * h)
        assert np.mean(smooth) > 0.97
        np.testing.assert_allclose(gradient[smooth, k], numeric[smooth], rtol=1e-3, atol=2e-3)


@settings(max_examples=60)
@given(st.lists(finite, min_size=1, max_size=6), st.floats(0.01, 1e4), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_units_of_time_and_of_the_output_do_not_matter(state, bound, time, unit):
    """Phi of the same motion in other units, [s] -> [time s] and [y] -> [unit y], is the same."""
    scale = unit * time ** np.arange(len(state) + 1)
    there = iv.invariance_function(np.array(state) * scale[:-1], -bound * scale[-1])
    assert there == pytest.approx(unit * float(iv.invariance_function(state, -bound)), rel=1e-9, abs=1e-12 * unit)
    t = iv.maximising_time(np.array(state) * scale[:-1], -bound * scale[-1])
    p = iv.taylor([v * s for v, s in zip(state, scale, strict=False)], -bound * scale[-1], float(t))
    assert p == pytest.approx(float(there), rel=1e-12, abs=1e-12 * unit)


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
    assert iv.invariance_gradient(xi, gamma).shape == xi.shape
    assert iv.invariance_function([1.0, 2.0], -1.0).shape == ()


def test_a_state_that_is_not_a_number_gives_none() -> None:
    for degree in DEGREES:
        xi = np.zeros((2, degree))
        xi[1, -1] = math.nan
        np.testing.assert_array_equal(np.isnan(iv.invariance_function(xi, -1.0)), [False, True])


# --- the subset, the bound of roots, alpha ----------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_fujiwara_bounds_every_root(degree: int) -> None:
    rng = np.random.default_rng(degree)
    coefficients = rng.normal(size=(1000, degree + 1)) * 10.0 ** rng.uniform(-3, 3, (1000, degree + 1))
    bounds = iv.fujiwara_bound(coefficients)
    for a, bound in zip(coefficients, bounds, strict=True):
        assert np.all(np.abs(np.roots(a[::-1])) <= bound * (1 + 1e-9))
    complex_roots = np.roots((coefficients[0] * (1 + 2j))[::-1])
    assert np.all(np.abs(complex_roots) <= iv.fujiwara_bound(coefficients[0] * (1 + 2j)))


def test_fujiwara_bound_by_hand() -> None:
    # x^2 - 3 x + 2: 2 max(3, sqrt(2/2))
    assert iv.fujiwara_bound([2.0, -3.0, 1.0]) == pytest.approx(6.0)
    # x^3 - 16: the last term alone, with the factor of the classical bound
    assert iv.fujiwara_bound([-16.0, 0.0, 0.0, 1.0]) == pytest.approx(4.0)


def root_estimate(state: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """tau-bar (3.76): the bound of the roots of p', degree 4."""
    _, y1, y2, y3 = state.T
    terms = [np.abs(3 * y3 / gamma), np.abs(6 * y2 / gamma) ** (1 / 2), np.abs(6 * y1 / gamma) ** (1 / 3)]
    return 2 * np.max(terms, axis=0)


def test_3_79_the_root_estimate_of_the_virtual_state() -> None:
    rng = np.random.default_rng(7)
    xi = rng.normal(size=(STATES, 4)) * 10.0 ** rng.uniform(-4, 4, (STATES, 4))
    gamma, alpha = -(10.0 ** rng.uniform(-3, 5, STATES)), 10.0 ** rng.uniform(-3, 2, STATES)
    virtual = iv.virtual_state(xi, alpha)
    before, after = root_estimate(xi, gamma), root_estimate(virtual, gamma)
    assert np.all((1 + alpha) ** (1 / 3) * before <= after * (1 + 1e-12))
    assert np.all(after <= (1 + alpha) * before * (1 + 1e-12))


@settings(max_examples=60)
@given(st.lists(finite, min_size=1, max_size=6), st.floats(0.01, 100.0), st.floats(0.0, 10.0))
def test_the_subset_lies_within_the_set(state, bound, alpha):
    """Phi(xi_hat) >= Phi(xi): keeping the virtual state admissible keeps the state admissible (3.72)."""
    virtual = iv.virtual_state(state, alpha)
    assert virtual[0] == state[0]
    np.testing.assert_allclose(virtual[1:], (1 + alpha) * np.array(state[1:]))
    inside = iv.invariance_function(virtual, -bound)
    assert inside >= iv.invariance_function(state, -bound) - 1e-12 * (1 + abs(inside))


@settings(max_examples=60)
@given(st.floats(0.1, 100.0), st.floats(0.1, 100.0), st.floats(1.0, 1e6))
def test_3_81_puts_the_state_of_the_rate_limit_on_the_boundary(error, rate, bound):
    alpha = float(iv.alpha_for_rate_limit(error, rate, -bound))
    phi = float(iv.invariance_function(iv.virtual_state([-error, rate, 0.0], alpha), -bound))
    if alpha > 0:
        assert phi == pytest.approx(0.0, abs=1e-12 * error)
    else:
        assert phi >= -1e-12 * error
    # In other units of time the same: the printed formula fails this.
    there = float(iv.alpha_for_rate_limit(error, rate / 1e3, -bound / 1e9))
    assert there == pytest.approx(alpha, rel=1e-9, abs=1e-12)


def test_3_84_is_strict() -> None:
    assert iv.alpha_for_compliance(1e-4, 1.5e-4) == pytest.approx(1.3 * 1.5 - 1)
    assert 1 + iv.alpha_for_compliance(1e-4, 3e-4, margin=1.01) > 3.0
    np.testing.assert_allclose(iv.alpha_for_compliance([1e-4, 1e-4], [1e-4, 2e-4]), [0.3, 1.6])


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [*FUNCTIONS, iv.invariance_gradient, iv.maximising_time])
def test_bad_states_and_bounds(function) -> None:
    for gamma in (0.0, 1.0, math.nan, -math.inf, [-1.0, 0.5]):
        with pytest.raises(BadInputError, match="gamma"):
            function([[1.0, 2.0], [1.0, 2.0]], gamma)
    for state in ([], 1.0, np.zeros((3, 0))):
        with pytest.raises(BadInputError, match="state"):
            function(state, -1.0)
    with pytest.raises(BadInputError, match="state"):
        function(["high", "low"], -1.0)
    with pytest.raises(BadInputError, match="gamma has shape"):
        function(np.zeros((4, 2)), [-1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: iv.virtual_state([1.0, 2.0], -0.1), "alpha"),
        (lambda: iv.virtual_state([1.0, 2.0], math.nan), "alpha"),
        (lambda: iv.virtual_state([], 1.0), "state"),
        (lambda: iv.fujiwara_bound([1.0]), "coefficients"),
        (lambda: iv.fujiwara_bound([1.0, 2.0, 0.0]), "coefficients"),
        (lambda: iv.fujiwara_bound(["a", "b"]), "coefficients"),
        (lambda: iv.alpha_for_rate_limit(-1.0, 1.0, -1.0), "force_error"),
        (lambda: iv.alpha_for_rate_limit(1.0, 0.0, -1.0), "rate_limit"),
        (lambda: iv.alpha_for_rate_limit(1.0, 1.0, 1.0), "gamma"),
        (lambda: iv.alpha_for_rate_limit("a", 1.0, -1.0), "force_error"),
        (lambda: iv.alpha_for_compliance(0.0, 1.0), "lower"),
        (lambda: iv.alpha_for_compliance(2.0, 1.0), "upper"),
        (lambda: iv.alpha_for_compliance(1.0, 2.0, margin=1.0), "margin"),
    ],
)
def test_bad_arguments(call, names) -> None:
    with pytest.raises(BadInputError, match=names):
        call()

"""Stability of the governed loop: the report equals the spectral radius of the whole loop, and is never too hopeful."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.force.governor.governor import GovernedConfig
from forcectl.force.governor.program import (
    GovernorProgram,
    Situation,
    closed_form,
    coefficients,
    free_force,
    over_horizon,
)
from forcectl.force.governor.stability import (
    alpha_for_every_delay,
    characteristic_polynomial,
    feedback_weight,
    frequency_margin,
    largest_alpha,
    spectral_radius,
    stability_report,
)
from forcectl.force.linear_law import VrftConfig

A, AT, N, Q = 0.997, 0.985, 40, 1e-3
ALPHA = feedback_weight(A, N, 1.0, Q)


def state_matrix(inner_pole, delay_ticks, true_delay_ticks, output_weight, reference_weight, horizon=1):
    """The matrix of plant, governor and reference model, column by column from the governor's own functions.

    State: y, yt, r[t-1], r[t-2], ...
    """
    numbers = over_horizon(inner_pole, AT, delay_ticks, output_weight, reference_weight, horizon=horizon)
    program = GovernorProgram(horizon)
    memory = max(delay_ticks, true_delay_ticks)
    columns = []
    for unit in np.eye(2 + memory):
        y, yt, past = unit[0], unit[1], list(unit[2:])
        free = free_force(numbers.c, y, past[:delay_ticks])
        r = (
            closed_form(numbers.c, yt, 0.0, free)
            if horizon == 1
            else program.solve(numbers, Situation(yt, 0.0, free)).u[0]
        )
        past = [r, *past]
        after = [inner_pole * y + (1 - inner_pole) * past[true_delay_ticks], AT * yt, *past[:memory]]
        columns.append(after)
    return np.array(columns).T


def published_bound(inner_pole, delay_ticks, true_delay_ticks):
    """The bound of alpha [1] of (4.42), sufficient according to the thesis but necessary only.

    With A = 0.997, N = 40, where it is 0.7746, a true delay of 20 ticks is unstable from alpha = 0.09 on.
    """
    a, n = inner_pole, max(delay_ticks, true_delay_ticks)
    power = a**n
    root = np.sqrt(power * (a * a * power - 2.0 * a * power + 5.0 * power + 4.0))
    return float((a * power - power + root) / (2.0 * a * power * (power + 1.0)))


def radius_of(matrix):
    return float(np.abs(np.linalg.eigvals(matrix)).max())


GRID = [
    (pole, n, true, weight)
    for pole in (0.6, 0.95, 0.997)
    for n in (0, 1, 7, 40)
    for true in (0, 1, 6, 8, 20, 60)
    for weight in (1e-5, 1e-3, 0.1)
]


def test_the_report_equals_the_spectral_radius_of_the_whole_loop_on_a_grid():
    for pole, n, true, weight in GRID:
        alpha = feedback_weight(pole, n, 1.0, weight)
        (case,) = stability_report(pole, n, alpha, true_delay_ticks=[true]).cases
        whole = radius_of(state_matrix(pole, n, true, 1.0, weight))
        # The pole of the reference model is in the whole loop as well, and zeros that eigenvalues do not find exactly.
        if whole > AT + 1e-9:
            assert case.spectral_radius == pytest.approx(whole, rel=1e-8)
            assert case.stable == (whole < 1)
        else:
            assert case.spectral_radius <= AT + 1e-9
            assert case.stable


@settings(max_examples=200)
@given(st.floats(0.001, 0.9995), st.integers(0, 60), st.integers(0, 60), st.floats(0.0, 1.0))
def test_never_stable_where_it_is_not(pole, n, true, alpha):
    (case,) = stability_report(pole, n, alpha, true_delay_ticks=[true]).cases
    whole = np.abs(np.linalg.eigvals(companion(characteristic_polynomial(pole, alpha, n, true)))).max()
    if case.stable:
        assert whole < 1
    if case.certain or alpha < alpha_for_every_delay(pole, n):
        assert case.spectral_radius < 1
        assert whole < 1
    if alpha < case.largest_alpha * (1 - 1e-6):
        assert case.spectral_radius < 1


def companion(polynomial):
    matrix = np.diag(np.ones(len(polynomial) - 2), -1)
    matrix[0] = -polynomial[1:]
    return matrix


@given(st.floats(0.5, 0.999), st.integers(0, 30), st.integers(0, 30), st.floats(0.0, 1.0))
def test_the_frequency_margin_is_the_smallest_over_all_frequencies(pole, n, true, alpha):
    w = np.linspace(0.0, np.pi, 5001)
    c, fed_back = (1 - alpha) * pole, alpha * pole ** (n + 1)
    margin = np.abs(np.exp(1j * w) - c) ** 2 - (fed_back * np.abs(np.exp(1j * (n - true) * w) - 1)) ** 2
    found = frequency_margin(pole, alpha, n, true)
    assert found <= margin.min() + 1e-12
    assert found == pytest.approx(margin.min(), abs=1e-3)


def test_constants_of_the_thesis():
    assert pytest.approx(0.0089197, abs=5e-8) == ALPHA
    assert spectral_radius(A, ALPHA, N, N) == pytest.approx(0.988107, abs=5e-7)
    assert spectral_radius(A, ALPHA, N, N) == pytest.approx(A * Q / ((1 - A) ** 2 + Q), abs=1e-15)
    roots = np.roots(characteristic_polynomial(A, ALPHA, N, N))
    assert np.count_nonzero(roots == 0) == N
    assert published_bound(A, N, N - 1) == pytest.approx(0.7746, abs=5e-5)
    assert published_bound(A, N - 1, N) == published_bound(A, N, 0) == published_bound(A, N, N - 1)


def test_any_weights_are_stable_with_the_right_delay():
    for alpha in np.linspace(0.0, 1.0, 21):
        assert spectral_radius(A, alpha, N, N) == pytest.approx((1 - alpha) * A, abs=1e-12)
        assert stability_report(A, N, alpha, true_delay_ticks=[N]).stable


def test_the_true_bound_over_forty_ticks_of_mismatch():
    report = stability_report(A, N, ALPHA, true_delay_ticks=range(81))
    assert report.stable
    assert all(case.certain for case in report.cases)
    assert max(case.spectral_radius for case in report.cases) <= 0.9914
    assert report.largest_alpha == pytest.approx(0.0865, abs=5e-5)
    assert [case.true_delay_ticks for case in report.cases] == list(range(81))
    deciding = [case.true_delay_ticks for case in report.cases if case.largest_alpha < 0.09]
    assert 0 < len(deciding) < 81
    for alpha, stable in ((0.0865, True), (0.0866, False)):
        assert stability_report(A, N, alpha, true_delay_ticks=deciding).stable is stable


@pytest.mark.parametrize(("pole", "n"), [(0.9, 1), (0.9, 5), (0.997, 40), (0.5, 3)])
def test_the_published_bound_is_necessary_one_tick_off(pole, n):
    """The first row of Jury's table: the product of the poles is below one."""
    bound = published_bound(pole, n, n - 1)
    if bound < 1:
        assert spectral_radius(pole, min(1.0, 1.001 * bound), n, n - 1) > 1


def test_the_published_bound_is_no_guarantee():
    assert published_bound(A, N, 20) > 0.77
    assert spectral_radius(A, 0.1, N, 20) > 1
    assert not stability_report(A, N, 0.1, true_delay_ticks=[20]).stable
    assert spectral_radius(0.9, 0.813, 1, 0) > 1
    assert published_bound(0.9, 1, 0) > 0.813


def test_stable_for_every_delay_is_below_its_bound():
    assert alpha_for_every_delay(A, N) == pytest.approx(0.00389, abs=1e-5)
    assert alpha_for_every_delay(0.5, 3) == math.inf
    small = stability_report(A, N, 0.00388, true_delay_ticks=[0, 10, 200])
    assert small.for_every_delay
    assert small.stable
    assert not stability_report(A, N, ALPHA, true_delay_ticks=[0]).for_every_delay


@pytest.mark.parametrize("true", [0, 10, 20, 39, 41, 66, 80])
def test_the_largest_alpha_is_where_it_becomes_unstable(true):
    limit = largest_alpha(A, N, true)
    assert spectral_radius(A, 0.9999 * limit, N, true) < 1 < spectral_radius(A, 1.0001 * limit, N, true)


@pytest.mark.parametrize("horizon", [2, 5, 20])
@pytest.mark.parametrize("true", [25, 40, 60])
def test_the_report_holds_for_longer_horizons(horizon, true):
    alpha = feedback_weight(A, N, 1.0, Q, horizon=horizon)
    whole = radius_of(state_matrix(A, N, true, 1.0, Q, horizon))
    found = spectral_radius(A, alpha, N, true)
    assert max(found, AT) == pytest.approx(max(whole, AT), rel=1e-6)
    assert alpha > ALPHA


def test_the_numbers_on_the_page_of_controllers():
    governor = GovernedConfig(law=VrftConfig(reference_bandwidth=1.5), horizon=20)
    delays = [0.08, 0.04, 0.13, 0.22, 0.222]
    cases = governor.stability(0.002, true_delay_ticks=[round(delay / 0.002) for delay in delays]).cases
    np.testing.assert_allclose([case.spectral_radius for case in cases[:3]], [0.9129, 0.9988, 0.9997], atol=6e-5)
    assert [case.stable for case in cases] == [True, True, True, True, False]
    with pytest.raises(BadInputError, match=r"period = 0\.0: must be positive"):
        governor.stability(0.0, true_delay_ticks=[1])


def test_weights_at_the_ends():
    assert feedback_weight(A, N, 0.0, 1.0) == 0.0
    assert feedback_weight(A, N, 1.0, 0.0) == pytest.approx(1.0)
    c = coefficients(A, AT, N, 1.0, Q)
    assert pytest.approx(c.gain * c.input_gain) == ALPHA


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("inner_pole", value) for value in (0.0, 1.0, -0.1, 2.0, math.nan)),
        *(("delay_ticks", value) for value in (-1, 0.5, 10_000)),
        *(("alpha", value) for value in (-0.1, 1.1, math.nan)),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    known = {"inner_pole": A, "delay_ticks": N, "alpha": ALPHA}
    with pytest.raises(BadInputError, match=name):
        stability_report(**known | {name: value}, true_delay_ticks=[3])


@pytest.mark.parametrize("delays", [[], [-1], [1.5], [100_000]])
def test_bad_true_delays_are_refused(delays):
    with pytest.raises(BadInputError, match="true_delay_ticks"):
        stability_report(A, N, ALPHA, true_delay_ticks=delays)

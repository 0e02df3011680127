"""The governor's problem (4.31): the closed form is its minimum, the quadratic program is the closed form and more."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from forcectl.errors import BadInputError
from forcectl.force.governor.program import (
    GovernorLimits,
    GovernorProgram,
    Situation,
    closed_form,
    coefficients,
    free_force,
    model_step,
    over_horizon,
)
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import DaqpPackage

THESIS = {"inner_pole": 0.997, "reference_pole": 0.985, "delay_ticks": 40, "output_weight": 1.0}
THESIS |= {"reference_weight": 1e-3}

poles = st.floats(0.01, 0.999)
weights = st.floats(1e-4, 1e2)
forces = st.floats(-50.0, 50.0)


@st.composite
def governors(draw, most_ticks: int = 60):
    return {
        "inner_pole": draw(poles),
        "reference_pole": draw(poles),
        "delay_ticks": draw(st.integers(0, most_ticks)),
        "output_weight": draw(weights),
        "reference_weight": draw(weights),
    }


@st.composite
def situations(draw, governor):
    """y, yt, F_bar, and r[t-1] ... r[t-N]."""
    n = governor["delay_ticks"]
    return draw(forces), draw(forces), draw(forces), draw(st.lists(forces, min_size=n, max_size=n))


def simulated(governor, force, wanted, desired, past, references):
    """y and yt from t+N_p on, by running the two models tick by tick."""
    a, at, n = governor["inner_pole"], governor["reference_pole"], governor["delay_ticks"]
    sent = [*reversed(past), *references]  # r[t-N] first
    y, yt, both = force, wanted, []
    for k in range(n + len(references)):
        y, yt = a * y + (1 - a) * sent[k], at * yt + (1 - at) * desired
        both.append((y, yt))
    return np.array(both[n:]).T


def brute_force(governor, force, wanted, desired, past, horizon=1):
    """The minimum of (4.31a) by least squares on simulated responses."""
    zero, later = simulated(governor, force, wanted, desired, past, [0.0] * horizon)
    columns = [simulated(governor, 0.0, 0.0, 0.0, [0.0] * len(past), unit)[0] for unit in np.eye(horizon)]
    q_y, q_r = np.sqrt(governor["output_weight"]), np.sqrt(governor["reference_weight"])
    matrix = np.vstack([q_y * np.array(columns).T, q_r * np.eye(horizon)])
    return np.linalg.lstsq(matrix, np.concatenate([q_y * (later - zero), np.full(horizon, q_r * desired)]), rcond=None)[
        0
    ]


@pytest.mark.slow
@settings(max_examples=300)
@given(st.data())
def test_the_closed_form_is_the_brute_force_minimum(data):
    governor = data.draw(governors())
    force, wanted, desired, past = data.draw(situations(governor))
    c = coefficients(**governor)
    ours = closed_form(c, wanted, desired, free_force(c, force, past))
    best = brute_force(governor, force, wanted, desired, past)[0]
    assert abs(ours - best) <= 1e-9 * max(1.0, abs(best))


@settings(max_examples=200)
@given(st.data())
def test_the_quadratic_program_is_the_closed_form(data):
    governor = data.draw(governors())
    force, wanted, desired, past = data.draw(situations(governor))
    numbers = over_horizon(**governor)
    free = free_force(numbers.c, force, past)
    ours = closed_form(numbers.c, wanted, desired, free)
    for program in (GovernorProgram(1), GovernorProgram(1, solver=DaqpPackage())):
        solution = program.solve(numbers, Situation(wanted, desired, free))
        assert solution.status is Status.OPTIMAL
        assert abs(solution.u[0] - ours) <= 1e-9 * max(1.0, abs(ours))


@settings(max_examples=100)
@given(st.data(), st.integers(2, 12))
def test_a_longer_horizon_is_the_brute_force_minimum(data, horizon):
    governor = data.draw(governors(most_ticks=20))
    force, wanted, desired, past = data.draw(situations(governor))
    numbers = over_horizon(**governor, horizon=horizon)
    solution = GovernorProgram(horizon).solve(numbers, Situation(wanted, desired, free_force(numbers.c, force, past)))
    best = brute_force(governor, force, wanted, desired, past, horizon)
    np.testing.assert_allclose(solution.u, best, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(best).max()))


def test_the_first_references_of_the_thesis():
    for pole, expected in ((0.985, 47.29), (0.991, 38.24)):
        c = coefficients(**THESIS | {"reference_pole": pole})
        assert closed_form(c, 0.0, 20.0, free_force(c, 0.0, [0.0] * 40)) == pytest.approx(expected, abs=0.005)


def test_a_plus_in_front_of_the_past_as_printed_would_not_end_at_the_desired_force():
    """At rest, y = yt = F_bar = r, the minimum is F_bar."""
    c = coefficients(**THESIS)
    at_rest = free_force(c, 20.0, [20.0] * 40)
    assert closed_form(c, 20.0, 20.0, at_rest) == pytest.approx(20.0, abs=1e-12)
    printed = c.force_decay * 20.0 - (at_rest - c.force_decay * 20.0)
    assert closed_form(c, 20.0, 20.0, printed) > 21.0


def test_the_reference_model_runs_freely():
    c, wanted = coefficients(**THESIS), 0.0
    for k in range(200):
        assert wanted == pytest.approx(20.0 * (1 - 0.985**k), abs=1e-12)
        wanted = model_step(c, wanted, 20.0)


def test_without_weight_on_the_force_the_reference_is_the_desired_force():
    c = coefficients(**THESIS | {"output_weight": 0.0})
    assert closed_form(c, 3.0, 20.0, 11.0) == 20.0


# --- limits ----------------------------------------------------------------------------------------------------------


@settings(max_examples=200)
@given(st.data())
def test_limits_with_a_horizon_of_one_are_those_of_the_program(data):
    governor = data.draw(governors())
    force, wanted, desired, past = data.draw(situations(governor))
    numbers = over_horizon(**governor)
    free, last = free_force(numbers.c, force, past), data.draw(forces)
    # A predicted force that can be had within the bounds of r, which can be had within the rate.
    limits = GovernorLimits(lower=last - 20.0, upper=last + 20.0, rate=15.0)
    within = numbers.c.input_gain * last + free
    limits = limits._replace(lower_force=within - data.draw(st.floats(0.0, 30.0)), upper_force=within + 1.0)
    solution = GovernorProgram(1).solve(numbers, Situation(wanted, desired, free, last), limits)
    ours = limits.nearest(numbers.c, closed_form(numbers.c, wanted, desired, free), last, free)
    assert solution.status is Status.OPTIMAL
    assert abs(solution.u[0] - ours) <= 1e-6 * max(1.0, abs(ours), abs(free) / numbers.c.input_gain)


@settings(max_examples=50)
@given(st.data(), st.integers(2, 10))
def test_bounds_over_a_longer_horizon_are_the_bounded_least_squares(data, horizon):
    governor = data.draw(governors(most_ticks=10))
    force, wanted, desired, past = data.draw(situations(governor))
    numbers = over_horizon(**governor, horizon=horizon)
    free = free_force(numbers.c, force, past)
    solution = GovernorProgram(horizon).solve(
        numbers, Situation(wanted, desired, free), GovernorLimits(lower=-5.0, upper=25.0)
    )
    zero, later = simulated(governor, force, wanted, desired, past, [0.0] * horizon)
    columns = [simulated(governor, 0.0, 0.0, 0.0, [0.0] * len(past), unit)[0] for unit in np.eye(horizon)]
    q_y, q_r = np.sqrt(governor["output_weight"]), np.sqrt(governor["reference_weight"])
    best = lsq_linear(
        np.vstack([q_y * np.array(columns).T, q_r * np.eye(horizon)]),
        np.concatenate([q_y * (later - zero), np.full(horizon, q_r * desired)]),
        bounds=(-5.0, 25.0),
        method="bvls",
    ).x
    np.testing.assert_allclose(solution.u, best, atol=1e-5)


@given(st.floats(0.1, 5.0), st.floats(21.0, 60.0), forces)
def test_rate_and_predicted_force_are_kept_over_the_horizon(rate, highest, last):
    numbers = over_horizon(**THESIS, horizon=15)
    free = free_force(numbers.c, 0.0, [last] * 40)
    limits = GovernorLimits(rate=rate, upper_force=highest)
    solution = GovernorProgram(15).solve(numbers, Situation(0.0, 100.0, free, last), limits)
    assert solution.status is Status.OPTIMAL
    assert np.abs(np.diff(solution.u, prepend=last)).max() <= rate + 1e-7
    predicted = simulated(THESIS, 0.0, 0.0, 100.0, [last] * 40, solution.u)[0]
    assert predicted.max() <= highest + 1e-6


def test_a_predicted_force_out_of_reach_gives_way_to_the_bounds_and_those_to_the_rate():
    numbers = over_horizon(**THESIS)
    free = free_force(numbers.c, 30.0, [30.0] * 40)  # 29.9 N already
    reference = closed_form(numbers.c, 0.0, 20.0, free)
    low = GovernorLimits(lower=5.0, rate=2.0, upper_force=10.0)
    assert low.nearest(numbers.c, reference, 6.0, free) == 5.0
    assert low.nearest(numbers.c, reference, 30.0, free) == 28.0
    for last, expected in ((6.0, 5.0), (30.0, 28.0)):
        solution = GovernorProgram(1).solve(numbers, Situation(0.0, 20.0, free, last), low)
        assert solution.status is Status.SLACK
        assert solution.u[0] == pytest.approx(expected, abs=1e-6)


def test_what_is_not_a_number_holds_the_last_reference():
    numbers = over_horizon(**THESIS, horizon=3)
    solution = GovernorProgram(3).solve(numbers, Situation(0.0, 20.0, np.nan, 7.0))
    assert solution.status is Status.NOT_FINITE
    np.testing.assert_array_equal(solution.u, [7.0, 7.0, 7.0])


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("inner_pole", value) for value in (0.0, 1.0, -0.5, 1.2, np.nan, np.inf)),
        *(("reference_pole", value) for value in (0.0, 1.0, -0.5, 1.2, np.nan)),
        *(("delay_ticks", value) for value in (-1, 1.5, 100_000, True)),
        *(("output_weight", value) for value in (-1.0, np.nan, np.inf)),
        *(("reference_weight", value) for value in (-1e-3, np.nan, np.inf)),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name):
        coefficients(**THESIS | {name: value})


def test_two_weights_of_zero_are_refused():
    with pytest.raises(BadInputError, match="both zero"):
        coefficients(**THESIS | {"output_weight": 0.0, "reference_weight": 0.0})


@pytest.mark.parametrize("horizon", [0, -1, 1.5])
def test_a_horizon_that_is_no_count_is_refused(horizon):
    with pytest.raises(BadInputError, match="horizon"):
        GovernorProgram(horizon)
    with pytest.raises(BadInputError, match="horizon"):
        over_horizon(**THESIS, horizon=horizon)

"""Reference models: sampled exactly, refused when no loop could follow them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from forcectl.errors import BadInputError
from forcectl.tuning.reference_model import (
    ReferenceModel,
    ReferenceModelConfig,
    first_order,
    from_bandwidth,
    from_continuous,
    from_discrete,
    from_poles,
)

TS = 0.002


def test_first_order_is_that_of_the_thesis():
    model = first_order(1.5, TS)
    assert model.poles == (0.997,)
    np.testing.assert_allclose(model.numerator, [0.0, 0.003], atol=1e-15)
    np.testing.assert_allclose(model.denominator, [1.0, -0.997])
    assert first_order(1.5, TS, exact=True).poles == (np.exp(-0.003),)
    # y[k+1] = A y[k] + (1 - A) r[k]
    r, y = np.random.default_rng(1).normal(size=50), np.zeros(51)
    for k in range(50):
        y[k + 1] = 0.997 * y[k] + 0.003 * r[k]
    np.testing.assert_allclose(model.response(r), y[:50], rtol=1e-13, atol=1e-16)


@pytest.mark.slow
@given(
    st.lists(st.floats(0.5, 100.0), min_size=1, max_size=4),
    st.booleans(),
    st.sampled_from([0.001, 0.002, 0.01]),
    st.integers(0, 30),
)
def test_continuous_poles_are_sampled_exactly(rates, oscillates, period, delay):
    poles: list[complex] = [-rate for rate in rates]
    if oscillates:
        poles = [*poles[:2], complex(-rates[0], 2 * rates[0]), complex(-rates[0], -2 * rates[0])]
    model = from_poles(poles, period, delay=delay)
    count = 400
    system = signal.ZerosPolesGain([], poles, np.prod(-np.asarray(poles)).real)
    _, expected = signal.step(system, T=np.arange(count) * period)
    expected = np.concatenate([np.zeros(delay), expected])[:count]
    np.testing.assert_allclose(model.response(np.ones(count)), expected, rtol=1e-6, atol=1e-9)
    assert model.static_gain == pytest.approx(1.0, abs=1e-9)


def test_continuous_zeros_and_static_gain_are_kept():
    model = from_continuous([1.0, 6.0], [1.0, 2.0, 3.0], 0.01)
    _, expected = signal.step(([1.0, 6.0], [1.0, 2.0, 3.0]), T=np.arange(600) * 0.01)
    np.testing.assert_allclose(model.response(np.ones(600)), expected, atol=1e-11)
    assert model.static_gain == pytest.approx(2.0)


def test_a_model_without_static_gain_is_sampled_too():
    model = from_continuous([1.0, 0.0], [1.0, 2.0, 3.0], 0.01)
    _, expected = signal.step(([1.0, 0.0], [1.0, 2.0, 3.0]), T=np.arange(600) * 0.01)
    np.testing.assert_allclose(model.response(np.ones(600)), expected, atol=1e-11)


@pytest.mark.slow
@given(st.lists(st.floats(-0.95, 0.95), min_size=1, max_size=4), st.floats(-2.0, 2.0), st.integers(1, 5))
def test_discrete_models_are_the_filter_they_are_written_as(poles, zero, delay):
    denominator = np.concatenate([np.poly(poles), np.zeros(delay)])
    numerator = 0.3 * np.array([1.0, -zero]) if len(poles) > 1 else np.array([0.3])
    model = from_discrete(numerator, denominator, TS)
    r = np.random.default_rng(0).normal(size=200)
    late = denominator.size - numerator.size
    expected = signal.lfilter(np.concatenate([np.zeros(late), numerator]), denominator, r)
    np.testing.assert_allclose(model.response(r), expected, rtol=1e-6, atol=1e-9)


def test_slow_models_of_order_4_keep_their_digits():
    model = from_bandwidth(0.5, 4, TS)
    time = np.arange(20_000) * TS
    x = 0.5 * time
    expected = 1 - np.exp(-x) * (1 + x + x**2 / 2 + x**3 / 6)
    np.testing.assert_allclose(model.response(np.ones(time.size)), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: from_discrete([1.0], [1.0], TS), "strictly proper"),
        (lambda: from_discrete([0.5, 0.0], [1.0, -0.5], TS), "without delay"),
        (lambda: from_discrete([0.5, 0.0, 0.0], [1.0, -0.5], TS), "not causal"),
        (lambda: from_discrete([0.5], [1.0, -1.0], TS), "stable"),
        (lambda: from_discrete([0.5], [1.0, -1.2], TS), "inside the unit circle"),
        (lambda: from_discrete([0.0], [1.0, -0.5], TS), "not all zero"),
        (lambda: from_discrete([np.nan], [1.0, -0.5], TS), "finite"),
        (lambda: from_discrete(["a"], [1.0, -0.5], TS), "numbers"),
        (lambda: from_continuous([1.0, 1.0], [1.0, 2.0], TS), "strictly proper"),
        (lambda: from_continuous([1.0, 0.0, 0.0], [1.0, 2.0], TS), "degree 2 over 1"),
        (lambda: from_continuous([1.0], [1.0, 0.0], TS), "stable"),
        (lambda: from_continuous([1.0], [1.0, -3.0], TS), "stable"),
        (lambda: from_poles([], TS), "at least one pole"),
        (lambda: from_poles([2.0], TS), "stable"),
        (lambda: from_poles([-1.0 + 2.0j], TS), "conjugate"),
        (lambda: first_order(0.0, TS), "positive"),
        (lambda: first_order(501.0, TS), "1/Ts = 500"),
        (lambda: first_order(1.5, TS, delay=-1), "not negative"),
        (lambda: from_bandwidth(1.5, 0, TS), "at least 1"),
        (lambda: ReferenceModel((), (0.5,), 0.5, 0, TS), "causal"),
        (lambda: ReferenceModel((), (0.5,), 0.0, 1, TS), "gain"),
        (lambda: ReferenceModelConfig(), "exactly one"),
        (lambda: ReferenceModelConfig(bandwidth=1.5, poles=[-1.0]), "exactly one"),
        (lambda: ReferenceModelConfig(numerator=[1.0]), "together"),
        (lambda: ReferenceModelConfig(poles=[-3.0], order=3), "order = 3: must be left out without a bandwidth"),
        (lambda: ReferenceModelConfig(numerator=[9.0], denominator=[1.0, 9.0], order=2), "order = 2: must be left out"),
        (lambda: ReferenceModelConfig(bandwidth=3.0, discrete=True), "discrete = True: must be left out"),
        (lambda: ReferenceModelConfig(poles=[[-1.0]]).model(TS), "imaginary part"),
        (lambda: ReferenceModelConfig(bandwidth=-1.5).model(TS), "positive"),
    ],
)
def test_what_no_loop_could_follow_is_refused(make, words):
    with pytest.raises(BadInputError, match=words):
        make()


def test_the_lag_is_the_area_between_a_step_and_its_response():
    for model in (from_bandwidth(2.0, 3, 0.002, delay=7), from_discrete([0.3, -0.2], [1.0, -1.5, 0.6], 0.01)):
        steps = np.ones(20_000)
        area = model.period * np.sum(steps - model.response(steps) / model.static_gain)
        assert model.lag == pytest.approx(area, rel=1e-9)


def test_the_ways_to_write_a_model_down_agree():
    one = ReferenceModelConfig(bandwidth=3.0, order=2, delay=4).model(TS)
    others = (
        ReferenceModelConfig(poles=[-3.0, -3.0], delay=4),
        ReferenceModelConfig(poles=[[-3.0, 0.0], -3.0], delay=4),
        ReferenceModelConfig(numerator=[9.0], denominator=[1.0, 6.0, 9.0], delay=4),
        ReferenceModelConfig(
            numerator=list(one.numerator[5:]), denominator=list(one.denominator), discrete=True, delay=4
        ),
    )
    r = np.random.default_rng(2).normal(size=3000)
    for other in others:
        np.testing.assert_allclose(other.model(TS).response(r), one.response(r), atol=1e-7)
    assert ReferenceModelConfig(bandwidth=1.5).model(TS) == first_order(1.5, TS)
    assert ReferenceModelConfig(bandwidth=1.5, exact=True).model(TS) == first_order(1.5, TS, exact=True)


def test_the_bandwidth_is_where_the_amplitude_has_fallen_by_three_decibels():
    ringing = from_discrete([0.3], [1.0, -1.1, 0.4], TS)
    for model in (first_order(1.5, TS), from_bandwidth(2.0, 3, TS, delay=7), ringing):
        _, response = signal.freqz(model.numerator, model.denominator, worN=[0.0, model.bandwidth * TS])
        assert abs(response[1] / response[0]) == pytest.approx(np.sqrt(0.5), rel=5e-3)

"""Batch VRFT against an implementation of its own, known controllers, noise, and data that cannot be used."""

import cProfile
import pstats

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.tuning.controller_basis import continuous_pid, discrete_pid, fir
from forcectl.tuning.plant_model import identify_plants
from forcectl.tuning.reference_model import first_order, from_bandwidth, from_discrete
from forcectl.tuning.vrft import fit_vrft, virtual_error
from tests.examples.vrft_records import TS, contact, loop_step, trapezoidal_moves

pytestmark = pytest.mark.usefixtures("plants_identified_once")

A = 0.997
MODEL = first_order(1.5, TS)
LAGS = (75.4, 75.4, 12.6, 12.6)


def record(noise=0.0, seed=0, stiffness=5.9e3, lags=LAGS, delay=1):
    """u and y of trapezoidal moves in contact."""
    u = trapezoidal_moves()
    y = lfilter(*contact(stiffness, lags, delay), u)
    return u, y + noise * np.random.default_rng(seed).normal(size=u.size)


def by_recursions(u, y, prefilter):
    """PID gains with M of (4.23), every filter as a loop in extended precision, solved by normal equations."""
    u, y = u.astype(np.longdouble), y.astype(np.longdouble)
    a = np.longdouble(1) - np.longdouble(TS) * np.longdouble(1.5)
    rows, targets = [], []
    e2 = total = s = t = m = u_l = e_before = np.longdouble(0)
    y1 = u1 = np.longdouble(0)
    for k in range(u.size):
        if prefilter:
            # once through (1 - z^-1)/(1 - A z^-1) for u, twice for y; then M for u
            s_new = a * s + (y[k] - y1)
            e = a * e2 + (s_new - s)
            t_new = a * t + (u[k] - u1)
            m = a * m + (1 - a) * t
            s, e2, t, u_l = s_new, e, t_new, m
        else:
            e, u_l = (y[k] - y1) / (1 - a), u1
        total += e
        if prefilter or k >= 1:
            rows.append([e, total, e - e_before])
            targets.append(u_l)
        e_before, y1, u1 = e, y[k], u[k]
    phi, target = np.array(rows), np.array(targets)
    left, right = phi.T @ phi, phi.T @ target
    # Elimination by hand: NumPy's solvers know no extended precision.
    table = np.column_stack([left, right])
    for i in range(3):
        table[i] /= table[i, i]
        for j in range(3):
            if j != i:
                table[j] -= table[j, i] * table[i]
    return table[:, 3].astype(float)


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("prefilter", [True, False])
def test_gains_equal_an_independent_implementation(prefilter, noise):
    u, y = record(noise)
    y -= y[0]
    fit = fit_vrft(u, y, MODEL, discrete_pid(TS), prefilter=prefilter)
    np.testing.assert_allclose(fit.gains, by_recursions(u, y, prefilter), rtol=1e-8)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(0, 5))
@settings(max_examples=6, deadline=None)
def test_models_of_any_order_equal_filtering_with_their_transfer_functions(seed, order, delay):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=60), 25)
    y = lfilter(*contact(3e3, (8.0, 30.0), 2, 0.01), u)
    model = from_bandwidth(6.0, order, 0.01, delay=delay)
    over, under = model.numerator, model.denominator
    size = max(over.size, under.size)
    over, under = np.pad(over, (0, size - over.size)), np.pad(under, (0, size - under.size))
    error = lfilter(under - over, under, lfilter(under - over, under, y))
    target = lfilter(over, under, lfilter(under - over, under, u))
    regressors = np.column_stack([error, np.cumsum(error), np.diff(error, prepend=0.0)])
    expected = np.linalg.lstsq(regressors, target, rcond=None)[0]
    fit = fit_vrft(u, y, model, discrete_pid(0.01))
    np.testing.assert_allclose(fit.gains, expected, rtol=1e-6)


@pytest.mark.slow
def test_a_spring_behind_a_lag_returns_the_known_controller():
    lag, stiffness = 12.6, 5.9e3
    u, y = record(stiffness=stiffness, lags=(lag,), delay=1)
    a = np.exp(-lag * TS)
    for prefilter in (True, False):
        fit = fit_vrft(u, y, MODEL, discrete_pid(TS), prefilter=prefilter)
        expected = -(1 - A) / stiffness * np.array([a / (1 - a), 1.0, 0.0])
        np.testing.assert_allclose(fit.gains, expected, rtol=1e-9, atol=1e-9 * abs(expected[0]))
        assert fit.r_squared == pytest.approx(1.0, abs=1e-12)
        assert fit.model_mismatch < 1e-4
        assert fit.warnings == ()


def test_a_bare_spring_returns_a_bare_integrator():
    u = trapezoidal_moves()
    y = -5.9e3 * np.concatenate([[0.0], u[:-1]])
    fit = fit_vrft(u, y, MODEL, discrete_pid(TS), prefilter=False)
    np.testing.assert_allclose(fit.gains, [0.0, -(1 - A) / 5.9e3, 0.0], atol=1e-15)
    assert fit.pid is not None
    assert fit.pid.integral == pytest.approx(-1.5 / 5.9e3)


def test_continuous_form_gives_the_gains_of_the_thesis_in_its_units():
    u, y = record()
    fit = fit_vrft(u, y, MODEL, continuous_pid(TS))
    assert fit.pid is not None
    assert fit.gains[1] == pytest.approx(-1.5 / 5.9e3, rel=2e-3)
    assert fit.gains[0] == pytest.approx(fit.gains[1] * (2 / 12.6 + 2 / 75.4 + TS), rel=0.06)
    assert fit.pid.discrete == pytest.approx((fit.gains[0], fit.gains[1] * TS, fit.gains[2] / TS))
    assert (fit.gains < 0).all()


@pytest.mark.slow
def test_scaling_input_and_output_scales_the_gains():
    u, y = record(0.02)
    basis = discrete_pid(TS)
    for prefilter in (True, False):
        one = fit_vrft(u, y, MODEL, basis, prefilter=prefilter)
        other = fit_vrft(3.0 * u, 0.5 * y, MODEL, basis, prefilter=prefilter)
        np.testing.assert_allclose(other.gains, 6.0 * one.gains, rtol=1e-9)
        np.testing.assert_allclose(other.standard_errors, 6.0 * one.standard_errors, rtol=1e-6)
        assert other.r_squared == pytest.approx(one.r_squared)
        assert other.condition_number == pytest.approx(one.condition_number)
        assert other.model_mismatch == pytest.approx(one.model_mismatch, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_with_the_prefilter_noise_leaves_k_p_and_k_i_and_the_report_says_that_k_d_is_lost(noise):
    clean = fit_vrft(*record(), MODEL, continuous_pid(TS))
    assert not any("identifiable" in warning for warning in clean.warnings)
    for seed in range(3):
        fit = fit_vrft(*record(noise, seed), MODEL, continuous_pid(TS))
        assert fit.gains[0] == pytest.approx(clean.gains[0], rel=0.012)
        assert fit.gains[1] == pytest.approx(clean.gains[1], rel=0.02)
        assert fit.noise_rms == pytest.approx(noise, rel=0.05)
        (warning,) = [line for line in fit.warnings if "identifiable" in line]
        assert warning.startswith("K_D is not identifiable")


def test_without_the_prefilter_the_same_noise_takes_k_p_and_the_report_says_so():
    clean = fit_vrft(*record(), MODEL, continuous_pid(TS), prefilter=False)
    fit = fit_vrft(*record(0.2), MODEL, continuous_pid(TS), prefilter=False)
    assert abs(fit.gains[0]) < 0.3 * abs(clean.gains[0])
    assert any(line.startswith("K_P, K_D are not identifiable") for line in fit.warnings)


@pytest.mark.slow
def test_instruments_remove_the_bias_of_noise():
    basis = discrete_pid(TS).only("K_P", "K_I")
    truth = fit_vrft(*record(), MODEL, basis, prefilter=False).gains
    plain, second = [], []
    for seed in range(4):
        u, y = record(0.02, seed)
        for found, instrument in ((plain, None), (second, record(0.02, 100 + seed)[1])):
            fit = fit_vrft(u, y, MODEL, basis, prefilter=False, instrument=instrument)
            assert fit.instrumented == (instrument is not None)
            found.append(fit.gains[0] / truth[0])
    assert np.mean(plain) < 0.2  # errors in variables
    assert np.mean(second) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_an_instrument_changes_nothing_without_noise_where_the_controller_is_exact():
    u, y = record(lags=(12.6,))
    fit = fit_vrft(u, y, MODEL, discrete_pid(TS).only("K_P", "K_I"), instrument=y)
    plain = fit_vrft(u, y, MODEL, discrete_pid(TS).only("K_P", "K_I"))
    np.testing.assert_allclose(fit.gains, plain.gains, rtol=1e-8)


@pytest.mark.slow
def test_standard_errors_cover_the_scatter_of_seeds():
    basis = continuous_pid(TS).only("K_P", "K_I")
    u, y = record(lags=(12.6,))
    fits = [fit_vrft(u, y + record(0.05, s)[1] - record()[1], MODEL, basis) for s in range(8)]
    scatter = np.std([fit.gains for fit in fits], axis=0, ddof=1)
    claimed = np.mean([fit.standard_errors for fit in fits], axis=0)
    assert (scatter < 2 * claimed).all()
    assert (claimed < 6 * scatter).all()


@pytest.mark.slow
def test_a_fir_controller_is_found_again():
    taps = np.array([0.4, -0.2, 0.1, 0.05, 0.3])
    rng = np.random.default_rng(4)
    y = np.concatenate([np.zeros(5), np.repeat(rng.normal(size=400), 5)])
    error = np.concatenate([virtual_error(y, MODEL)[1:], [0.0]])  # one sample ahead: exact but for the last
    u = np.convolve(error, taps)[: y.size]
    for prefilter in (True, False):
        fit = fit_vrft(u[:-1], y[:-1], MODEL, fir(5, TS), prefilter=prefilter)
        np.testing.assert_allclose(fit.gains, taps, rtol=1e-9)
        assert fit.pid is None


@pytest.mark.slow
def test_a_reference_model_with_the_delay_of_the_plant_is_matched_one_that_is_too_fast_is_out_of_reach():
    u, y = record(delay=40)
    late = fit_vrft(u, y, first_order(1.5, TS, delay=40), discrete_pid(TS))
    early = fit_vrft(u, y, first_order(1.5, TS), discrete_pid(TS))
    hasty = fit_vrft(u, y, first_order(30.0, TS), discrete_pid(TS))
    assert late.model_mismatch < 0.05 < early.model_mismatch < hasty.model_mismatch
    assert (late.out_of_reach, hasty.out_of_reach) == (False, True)
    assert any("out of reach" in line for line in hasty.warnings)


@pytest.mark.parametrize("delay", [1, 10, 40, 60])
@pytest.mark.parametrize("bandwidth", [1.5, 4.5, 12.0, 40.0])
def test_stability_of_the_tuned_loop_is_predicted(delay, bandwidth):
    fit = fit_vrft(*record(delay=delay), first_order(bandwidth, TS), discrete_pid(TS))
    step = loop_step(fit.gains, *contact(5.9e3, LAGS, delay), 40_000)
    late, early = np.abs(step[-5000:] - 1).max(), np.abs(step[5000:10_000] - 1).max()
    assert fit.stable == bool(np.isfinite(late) and late < 0.5 * early + 1e-3)


@pytest.mark.slow
def test_a_single_sinusoid_excites_two_gains_only():
    u = -1e-3 * np.sin(0.02 * np.arange(30_000))
    y = lfilter(*contact(5.9e3, LAGS, 1), u)
    fit = fit_vrft(u[5000:] - u[5000], y[5000:] - y[5000], first_order(20.0, TS), discrete_pid(TS))
    assert fit.excitation_order < 10
    moves = fit_vrft(*record(), MODEL, discrete_pid(TS))
    assert moves.excitation_order >= 3
    assert fit.condition_number > moves.condition_number


@pytest.mark.slow
def test_the_report_names_a_record_that_does_not_begin_at_rest_and_a_model_that_ends_elsewhere():
    u, y = record()
    fit = fit_vrft(u, y + 5.0, MODEL, discrete_pid(TS))
    assert any("does not begin at rest: y[0] = 5" in line for line in fit.warnings)
    noisy = fit_vrft(u, y + 5.0 * np.random.default_rng(1).normal(size=y.size), MODEL, discrete_pid(TS))
    assert not any("does not begin at rest" in line for line in noisy.warnings)
    short = fit_vrft(u, y, from_discrete([0.8 * (1 - A)], [1.0, -A], TS), discrete_pid(TS))
    assert any("ends at 0.8" in line for line in short.warnings)


@pytest.mark.slow
def test_data_of_which_the_plant_explains_little_are_called_so():
    u, _ = record()
    y = 10 * np.sin(0.003 * np.arange(u.size))
    fit = fit_vrft(u, y, MODEL, discrete_pid(TS))
    assert any("not to be trusted" in line for line in fit.warnings)


GOOD_U, GOOD_Y = record()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"u": GOOD_U[:-1]}, "must be as many"),
        ({"u": GOOD_U.reshape(1, -1)}, "one-dimensional"),
        ({"u": np.zeros_like(GOOD_U)}, "a constant identifies no gains"),
        ({"y": np.full_like(GOOD_Y, 3.0)}, "a constant identifies no gains"),
        ({"y": np.where(np.arange(GOOD_Y.size) == 17, np.nan, GOOD_Y)}, r"y\[17\] = nan"),
        ({"y": np.where(np.arange(GOOD_Y.size) == 17, 1e200, GOOD_Y)}, r"y\[17\] = 1e\+200"),
        ({"u": 1e-200 * GOOD_U}, "a constant identifies no gains"),
        ({"u": GOOD_U[:20], "y": GOOD_Y[:20]}, "at least 31 for 3 gains"),
        ({"u": "words"}, "numbers"),
        ({"model": first_order(1.5, 0.004)}, "period of the reference model"),
        ({"instrument": GOOD_Y[:-1]}, "instrument has"),
        ({"prefilter": False, "model": from_bandwidth(1.5, 4, TS)}, "no stable inverse"),
    ],
)
def test_data_that_cannot_be_used_are_refused_in_one_line(change, words):
    arguments = {"u": GOOD_U, "y": GOOD_Y, "model": MODEL, "basis": discrete_pid(TS)} | change
    with pytest.raises(BadInputError, match=words) as caught:
        fit_vrft(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_nothing_is_changed_in_place():
    u, y = record(0.05)
    before = u.copy(), y.copy()
    fit_vrft(u, y, MODEL, continuous_pid(TS))
    np.testing.assert_array_equal(u, before[0])
    np.testing.assert_array_equal(y, before[1])


@pytest.mark.slow
def test_nothing_is_done_sample_by_sample_in_python(monkeypatch):
    """Less than one call for ten samples more; `benchmarks/vrft.py` measures the time of a million."""

    def calls(times: int) -> int:
        u, y = (np.tile(signal, times) for signal in record(0.02))
        profile = cProfile.Profile()
        profile.runcall(fit_vrft, u, y, MODEL, discrete_pid(TS))
        return pstats.Stats(profile).total_calls  # type: ignore[attr-defined]

    monkeypatch.setattr("forcectl.tuning.vrft.identify_plants", identify_plants)  # every time
    calls(1)  # what is imported or kept at the first call
    assert calls(20) - calls(1) < 0.1 * 19 * record()[0].size


@pytest.mark.slow
def test_a_loop_within_reach_is_not_said_to_be_out_of_reach():
    """Without a prefilter noise biases K_P: other gains come nearer, which is not said of 0.1 %."""
    u = record()[0]
    y = lfilter(*contact(5.9e3, (12.6,), 1), u)
    noise = np.random.default_rng(3).normal(size=y.size)
    for size, said in ((0.02, True), (0.002, False)):
        fit = fit_vrft(u, y + size * noise, MODEL, discrete_pid(TS), prefilter=False)
        assert fit.out_of_reach
        assert fit.model_mismatch < 0.1
        assert any("other gains come nearer" in line for line in fit.warnings) == said
        assert not any("out of reach" in line for line in fit.warnings)

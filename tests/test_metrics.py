"""Metrics against closed forms of first- and second-order responses, and on the edges where they are undefined."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.simulation import metrics as m

DT = 0.002


def first_order(bandwidth, target, *, start=0.0, at=0.0, duration=10.0):
    """(time, desired, force) of F' = w (F_ref - F), a step from `start` to `target` at the time `at`."""
    t = DT * np.arange(round(duration / DT) + 1)
    active = t >= at - 1e-9
    desired = np.where(active, target, start)
    force = np.where(active, target + (start - target) * np.exp(-bandwidth * (t - at)), start)
    return t, desired, force


def second_order(omega, zeta, target, duration):
    t = DT * np.arange(round(duration / DT) + 1)
    damped = omega * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    force = target * (1 - decay * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t)))
    return t, np.full_like(t, target), force


def the_step(t, desired, initial=0.0):
    (step,) = m.find_steps(t, desired, initial)
    return step


@settings(max_examples=40)
@given(
    bandwidth=st.floats(0.8, 8.0),
    start=st.sampled_from([0.0, 5.0, 20.0]),
    target=st.sampled_from([12.0, 15.0, 25.0]),
    at=st.sampled_from([0.0, 0.5, 1.25]),
)
def test_first_order_response_up_and_down_at_any_time(bandwidth, start, target, at):
    t, desired, force = first_order(bandwidth, target, start=start, at=at, duration=at + 8 / bandwidth)
    step = the_step(t, desired, start)
    assert (step.start, step.target, step.time) == (start, target, pytest.approx(at))
    assert m.overshoot(force, step) == 0.0
    assert m.rise_time(t, force, step) == pytest.approx(math.log(9) / bandwidth, abs=1e-4)
    assert m.time_to_share(t, force, step, 0.9) == pytest.approx(math.log(10) / bandwidth, abs=1e-4)
    for band in (0.05, 0.02):
        # |target - start| e^(-w t) = band |target|; the last sample outside is up to one sample earlier.
        settled = max(0.0, math.log(abs(step.size) / (band * target)) / bandwidth)
        assert settled - DT - 1e-9 <= m.settling_time(t, force, step, band) <= settled + 1e-9


@settings(max_examples=40)
@given(omega=st.floats(2.0, 20.0), zeta=st.floats(0.15, 0.8), target=st.floats(1.0, 100.0))
def test_second_order_overshoot(omega, zeta, target):
    t, desired, force = second_order(omega, zeta, target, duration=10 / (zeta * omega))
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    values = m.metrics_of(signals(t, desired, force))
    # The peak falls between two samples: at most omega^2 (dt/2)^2 / 2 of it is missed.
    assert values["overshoot_pct"] == pytest.approx(100 * expected, abs=100 * (omega * DT) ** 2 / 8 + 1e-9)
    assert values["overshoot_N"] == pytest.approx(values["overshoot_pct"] / 100 * target)


def signals(t, desired, force, **more):
    return {"time": t, "desired_force": desired, "measured_force": force, "contact_force": force} | more


def test_step_down_overshoots_below_the_target():
    t = DT * np.arange(1001)
    force = 10 + 10 * np.exp(-5 * t) * np.cos(20 * t)
    step = the_step(t, np.full_like(t, 10.0), 20.0)
    assert m.overshoot(force, step) == pytest.approx(10 - force.min())


def test_model_error_of_the_model_itself_is_zero_and_of_an_offset_is_the_offset():
    t, desired, force = first_order(1.5, 15.0)
    model = m.model_response(t, desired, 1.5)
    np.testing.assert_allclose(model, force, atol=1e-10)
    values = m.metrics_of(signals(t, desired, force - 0.25, model_force=model))
    assert values["max_abs_model_error_N"] == pytest.approx(0.25)
    assert values["max_positive_model_error_N"] == 0.0
    assert values["model_error_sd_N"] == pytest.approx(0.0, abs=1e-9)


def test_model_error_times_and_signs():
    t, desired, model = first_order(1.5, 15.0)
    error = -3 * np.exp(-(((t - 0.25) / 0.1) ** 2)) + 1 * np.exp(-(((t - 1.3) / 0.2) ** 2))
    values = m.metrics_of(signals(t, desired, model + error, model_force=model))
    assert values["max_abs_model_error_N"] == pytest.approx(3.0, rel=1e-3)
    assert values["time_of_max_abs_model_error_s"] == pytest.approx(0.25, abs=0.003)
    assert values["max_positive_model_error_N"] == pytest.approx(1.0, rel=1e-3)
    assert values["time_of_max_positive_model_error_s"] == pytest.approx(1.3, abs=0.003)


@pytest.mark.parametrize("window", [1.0, 2.5])
def test_standard_deviation_of_a_sine_over_whole_periods(window):
    t, desired, model = first_order(1.5, 15.0, duration=5.0)
    error = 0.8 * np.sin(2 * np.pi * 2 * t)
    values = m.metrics_of(signals(t, desired, model + error, model_force=model), window=window)
    assert values["model_error_sd_N"] == pytest.approx(0.8 / math.sqrt(2), rel=2e-3)
    assert values["model_error_window_s"] == pytest.approx(window)


def test_a_short_run_says_which_window_it_used():
    t, desired, force = first_order(1.5, 15.0, duration=2.0)
    values = m.metrics_of(signals(t, desired, force, model_force=force), window=4.1)
    assert values["model_error_window_s"] == pytest.approx(2.0)


def test_response_that_never_arrives_has_no_rise_or_settling_time():
    t, desired, force = first_order(1.5, 15.0)
    values = m.metrics_of(signals(t, desired, 0.5 * force))
    for name in ("rise_time_s", "time_to_90pct_s", "settling_time_5pct_s", "settling_time_2pct_s"):
        assert values[name] is None
    assert values["steady_state_error_N"] == pytest.approx(7.5, rel=1e-3)


def test_without_a_step_or_a_model_everything_of_them_is_undefined_and_json_stays_strict():
    t = DT * np.arange(100)
    zero = np.zeros_like(t)
    values = m.metrics_of(signals(t, zero, zero))
    assert all(values[name] is None for name in m.STEP_METRICS)
    assert values["contact_loss_s"] is None
    assert json.loads(json.dumps(values, allow_nan=False)) == values


def test_several_steps_are_told_apart_and_the_last_one_is_the_headline():
    t, desired, force = first_order(6.0, 15.0, duration=8.0)
    later = t >= 4.0
    desired = np.where(later, 25.0, desired)
    force = np.where(later, 25 - 10 * np.exp(-3.0 * (t - 4)), force)
    values = m.metrics_of(signals(t, desired, force))
    assert values["step_1.rise_time_s"] == pytest.approx(math.log(9) / 6, abs=1e-3)
    assert values["step_2.rise_time_s"] == pytest.approx(math.log(9) / 3, abs=1e-3)
    assert values["rise_time_s"] == values["step_2.rise_time_s"]
    assert m.is_metric("step_2.rise_time_s")
    assert m.metric_unit("step_2.rise_time_s") == "s"
    assert not m.is_metric("step_2.realtime_factor")
    assert not m.is_metric("step_0.rise_time_s")


def test_a_ramp_is_one_step_that_begins_where_the_ramp_begins():
    t = DT * np.arange(2001)
    desired = np.clip(10 * (t - 1), 0, 15)
    (step,) = m.find_steps(t, desired, 0.0)
    assert (step.time, step.start, step.target) == (pytest.approx(1.0 + DT), 0.0, 15.0)


def test_contact_loss_counts_only_after_the_first_contact():
    t = 0.01 * np.arange(101)
    touching = ((t > 0.195) & (t < 0.495)) | (t > 0.695)
    assert m.contact_loss(t, touching) == pytest.approx(0.2)


def test_peak_force_is_of_the_true_force_and_effort_is_the_path_length():
    t, desired, force = first_order(2.0, 10.0)
    truth = force + 3 * np.exp(-(((t - 1) / 0.05) ** 2))
    command = 1e-3 * np.sin(2 * np.pi * t)
    values = m.metrics_of(signals(t, desired, force, contact_force=truth, displacement_command=command))
    assert values["peak_force_N"] == pytest.approx(truth.max())
    assert values["control_effort_m"] == pytest.approx(4e-3 * 10, rel=1e-3)


def test_every_metric_is_present_and_documented():
    t, desired, force = first_order(2.0, 10.0)
    values = m.metrics_of(signals(t, desired, force, model_force=force), realtime_factor=50.0)
    assert list(values) == m.metric_names()
    assert values["realtime_factor"] == 50.0
    for name in m.metric_names():
        unit, meaning = (m.STEP_METRICS | m.RUN_METRICS)[name]
        assert unit
        assert meaning

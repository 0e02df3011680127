"""Metrics of moving references against the closed form of a lag of first order."""

import math

import numpy as np
import pytest

from forcectl.analysis import force_metrics as m
from forcectl.analysis.tables.metric_tables import STEP_METRICS
from forcectl.analysis.tracking_metrics import TRACKING_METRICS

DT = 0.002


def metrics(desired, measured, true, duration):
    t = DT * np.arange(round(duration / DT) + 1)
    signals = {"desired_force": desired(t), "measured_force": measured(t), "contact_force": true(t)}
    return m.metrics_of({"time": t} | signals)


@pytest.mark.parametrize(("frequency", "mean", "amplitude"), [(0.5, 15.0, 5.0), (2.0, 8.0, 3.0), (0.37, 20.0, 1.0)])
def test_gain_and_phase_of_a_sine_are_those_of_the_lag(frequency, mean, amplitude):
    """F' = w (F_r - F): gain 1/sqrt(1 + (wr/w)^2), phase lag atan(wr/w), beside the transient of the start."""
    rate = 2 * math.pi * frequency

    def lagged(bandwidth):
        gain, lag = 1 / math.hypot(1, rate / bandwidth), math.atan(rate / bandwidth)

        def force(t):
            steady = mean + amplitude * gain * np.sin(rate * t - lag)
            return steady + (mean - steady[0]) * np.exp(-bandwidth * t)

        return force, gain, math.degrees(lag)

    (slow, gain, lag), (fast, true_gain, true_lag) = lagged(20.0), lagged(60.0)
    found = metrics(lambda t: mean + amplitude * np.sin(rate * t), slow, fast, 6.0 / frequency + 0.1)
    assert found["reference_frequency_Hz"] == pytest.approx(frequency, rel=1e-3)
    assert found["tracking_gain"] == pytest.approx(gain, rel=2e-3)
    assert found["tracking_phase_lag_deg"] == pytest.approx(lag, abs=0.3)
    assert found["true_tracking_gain"] == pytest.approx(true_gain, rel=2e-3)
    assert found["true_tracking_phase_lag_deg"] == pytest.approx(true_lag, abs=0.3)
    # The distance of two sines of the same rate is one of amplitude |1 - gain e^(-j lag)|.
    apart = amplitude * abs(1 - gain * np.exp(-1j * math.radians(lag)))
    assert found["tracking_rms_N"] == pytest.approx(apart / math.sqrt(2), rel=0.05)
    assert found["tracking_max_abs_error_N"] >= apart * 0.999
    assert all(found[name] is None for name in STEP_METRICS)


def test_a_force_ahead_of_its_reference_has_a_negative_lag():
    found = metrics(lambda t: 5 + np.sin(6 * t), lambda t: 5 + np.sin(6 * t + 0.4), lambda t: 5 + np.sin(6 * t), 5.0)
    assert found["tracking_phase_lag_deg"] == pytest.approx(-math.degrees(0.4), abs=0.2)
    assert found["true_tracking_phase_lag_deg"] == pytest.approx(0.0, abs=0.2)
    assert found["true_tracking_rms_N"] == 0.0


def test_a_ramp_has_errors_while_it_moves_but_no_frequency():
    """A force that is 0.5 N behind while the ramp moves, and 3 N off afterwards."""
    found = metrics(
        lambda t: np.minimum(5 * t, 10.0), lambda t: np.where(t <= 2, 5 * t - 0.5, 7.0), lambda t: 5.0 * t, 4.0
    )
    assert found["tracking_rms_N"] == pytest.approx(0.5, rel=1e-3)
    assert found["tracking_max_abs_error_N"] == pytest.approx(0.5)
    assert found["reference_frequency_Hz"] is found["tracking_gain"] is found["tracking_phase_lag_deg"] is None
    assert found["overshoot_pct"] is found["settling_time_2pct_s"] is None


def test_steps_have_no_tracking_and_a_step_before_a_sine_keeps_its_own():
    stepped = metrics(lambda t: np.where(t < 2, 10.0, 15.0), lambda t: 0 * t, lambda t: 0 * t, 4.0)
    assert all(stepped[name] is None for name in TRACKING_METRICS)
    both = metrics(
        lambda t: 10 + 4 * np.sin(6 * np.maximum(t - 2, 0)),
        lambda t: 10 * (1 - np.exp(-5 * t)),
        lambda t: 11 * (1 - np.exp(-5 * t)),
        6.0,
    )
    assert both["overshoot_pct"] == 0.0
    assert both["true_overshoot_pct"] == pytest.approx(10.0, abs=0.01)
    assert both["reference_frequency_Hz"] == pytest.approx(6 / (2 * math.pi), rel=1e-3)
    assert both["tracking_gain"] == pytest.approx(0.0, abs=1e-3)

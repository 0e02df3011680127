"""The estimate of the true force: quick where readings are quiet, slower where they are noisy."""

import math

import numpy as np
import pytest
from scipy.signal import bilinear_zpk, lfilter, zpk2tf

from forcectl.force.guard.estimate import estimate_of, live_repeats, quiet_bandwidth

PERIOD = 0.002


@pytest.mark.parametrize(("noise", "force", "ahead"), [(0.5, 20.0, 0.12), (2.0, 40.0, 0.12), (0.3, 12.0, 0.2)])
def test_noise_of_a_force_looked_at_ahead_is_a_share_of_the_largest(noise, force, ahead):
    """White noise behind T s/(s/a + 1)^3, simulated with another discretisation than the guard's."""
    a = quiet_bandwidth(noise, force, ahead, PERIOD)
    numerator, denominator = zpk2tf(*bilinear_zpk([0.0], [-a] * 3, ahead * a**3, 1 / PERIOD))
    looked_at = lfilter(numerator, denominator, noise * np.random.default_rng(4).standard_normal(200_000))
    assert looked_at.std() == pytest.approx(0.04 * force, rel=0.05)


def test_without_noise_or_without_looking_ahead_nothing_slows_it():
    assert quiet_bandwidth(0.0, 20.0, 0.12, PERIOD) == math.inf
    assert quiet_bandwidth(0.5, 20.0, 0.0, PERIOD) == math.inf


@pytest.mark.parametrize("noise", [0.15, 0.25, 0.5])
def test_readings_of_a_live_sensor_repeat_themselves_less_than_that(noise):
    """0.5 N are the step of the readings; the longest run of 1e6 is met once, that of `live_repeats` once in 1e9."""
    readings = np.round(noise / 0.5 * np.random.default_rng(8).standard_normal(1_000_000))
    changes = np.flatnonzero(np.diff(readings))
    longest, allowed = np.diff(changes).max() - 1, live_repeats(noise, 0.5, math.inf, PERIOD)
    assert 0.4 * allowed < longest < 0.85 * allowed


def test_a_filter_shows_what_comes_before_it_and_without_noise_all_readings_may_be_the_same():
    assert live_repeats(0.05, 0.05, 12.6, PERIOD) == live_repeats(0.05, 0.0, math.inf, PERIOD) == 0.0
    assert live_repeats(0.0, 0.05, 12.6, PERIOD) == live_repeats(0.0, 0.0, math.inf, PERIOD) == math.inf


@pytest.mark.parametrize(
    ("bandwidth", "most", "expected"),
    [
        (10.0, math.inf, 320.0),
        (100.0, math.inf, 400.0),
        (10.0, 140.0, 140.0),
        (500.0, math.inf, None),
        (60.0, 50.0, None),
    ],
)
def test_its_bandwidth_is_bounded_by_sensor_tick_and_noise(bandwidth, most, expected):
    """A sensor as quick as the estimate could be is believed as it is."""
    lag, square, share = estimate_of(bandwidth, 0.7, PERIOD, most)
    if expected is None:
        assert (lag, square, share) == (0.0, 0.0, 1.0)
    else:
        assert (1.0 - share) / share * PERIOD == pytest.approx(1.0 / expected)
        assert lag**2 / square == pytest.approx(1.4**2)
        assert lag == pytest.approx(0.8 * 1.4 * expected / bandwidth)


def test_a_ramp_of_the_true_force_is_seen_a_fifth_of_the_lag_late():
    """A fifth of that of the sensor, and the estimate's own: without it the ramp is seen 159 ms late."""
    w, z, a = 12.6, 1.0, 400.0
    lag, square, share = estimate_of(w, z, PERIOD)
    time = np.arange(2000) * PERIOD
    readings = 100.0 * (time - 2 * z / w + np.exp(-w * time) * (time + 2 / w))  # w^2/(s + w)^2 of 100 N/s
    one = lfilter([share], [1.0, share - 1.0], readings)
    two = lfilter([share], [1.0, share - 1.0], one)
    estimate = two + lag * (one - two) + square * (readings - 2 * one + two)
    assert 100.0 * time[-1] - estimate[-1] == pytest.approx(100.0 * (0.2 * 2 * z / w + 2 / a), rel=1e-3)

"""Readings that are plausible one by one and yet wrong."""

import numpy as np
import pytest

from forcectl.analysis.findings.readings import reading_findings

TIME = 0.002 * np.arange(1000)
TRUE = 15.0 * (1.0 - np.exp(-8.0 * TIME))
NOISE = 0.05 * np.sin(TIME * 400.0) * np.sin(TIME * 37.0)


def kinds(measured, true=TRUE):
    return [each.kind for each in reading_findings(TIME, measured, true, 200.0)]


def test_a_sound_sensor_has_none():
    assert kinds(TRUE + NOISE) == []
    assert kinds(TRUE + 1.0) == []


def test_every_other_sample_lost():
    measured = TRUE + NOISE
    measured[501::2] = measured[500:-1:2]
    (one,) = reading_findings(TIME, measured, TRUE, 200.0)
    assert one.kind == "readings_repeated"
    assert one.time == pytest.approx(TIME[500], abs=0.5)


def test_readings_that_come_late_by_chance():
    measured = TRUE + NOISE
    late = np.random.default_rng(0).integers(0, 12, len(TIME)) * (TIME > 0.5)
    assert kinds(measured[np.arange(len(TIME)) - late]) == ["readings_repeated"]


def test_a_frozen_reading_repeats_itself_for_long():
    measured = np.where(TIME < 1.0, TRUE + NOISE, 15.0)
    assert kinds(measured) == []


@pytest.mark.parametrize("factor", [0.5, -1.0, 2.0])
def test_a_wrong_scale(factor):
    (one,) = reading_findings(TIME, factor * TRUE, TRUE, 200.0)
    assert one.kind == "sensor_off"
    assert f"it shows {factor * 15:.4g}" in one.text


def test_a_filter_that_still_lags_behind_a_fast_loop_is_no_fault():
    late = np.maximum(TIME - 1.0, 0.0)
    true = np.where(TIME > 1.0, 15.0, 5.0)
    assert kinds(15.0 - 10.0 * (1 + 8.0 * late) * np.exp(-8.0 * late) + NOISE, true) == []


@pytest.mark.parametrize("period", [0.0005, 0.002, 0.004])
def test_a_filter_that_lags_behind_a_rise_is_no_fault_at_any_period(period: float) -> None:
    time = np.arange(0.0, 6.0, period)
    true, w = 15.0 * (1.0 - np.exp(-1.5 * time)), 12.6
    share = (w / (w - 1.5)) ** 2  # of the rise behind the critically damped filter of a sensor
    decay = (share - 1.0 + (w * (share - 1.0) - 1.5 * share) * time) * np.exp(-w * time)
    lag = 15.0 * (1.0 - share * np.exp(-1.5 * time) + decay)
    assert [each.kind for each in reading_findings(time, lag, true, 200.0)] == []
    assert [each.kind for each in reading_findings(time, 0.7 * true, true, 200.0)] == ["sensor_off"]


def test_a_force_beyond_the_range_is_not_compared():
    assert [each.kind for each in reading_findings(TIME, np.minimum(TRUE, 10.0), TRUE, 10.0)] == []


def test_readings_that_are_no_numbers_do_no_harm():
    measured = np.where(TIME < 1.5, TRUE + NOISE, np.nan)
    (one,) = reading_findings(TIME, measured, TRUE, 200.0)
    assert one.text == "the force sensor has a large error: it shows no number where the true force is 15 N"
    assert kinds(np.full(1000, np.inf)) == ["sensor_off"]
    assert kinds(np.zeros(1000), np.zeros(1000)) == []

"""What the sensor does not show yet: its filter in floats, and a surface that rises."""

import math

import numpy as np
import pytest

from forcectl.force.sensor_lag import SensorLag
from forcectl.plant.sensors.force_sensor import sensor_filter

PERIOD = 0.002


def wave(time: float) -> float:
    return 1e-3 * math.sin(9.0 * time)


@pytest.mark.parametrize("delay", [0, 3])
def test_it_is_the_sensors_filter(delay: int) -> None:
    system = sensor_filter(1, 12.6, 0.8, PERIOD, delay)
    state, expected = np.zeros(2 + delay), []
    for k in range(250):
        u = np.array([wave(k * PERIOD)])
        expected.append((system.C() @ state + system.D() @ u).item())
        state = system.A() @ state + system.B() @ u

    lag = SensorLag(12.6, 0.8, PERIOD, delay)
    memory = [0.0] * lag.size
    found = []
    for k in range(len(expected)):
        # The command far out, so that it presses, and a depth that is no number: only the filter is left.
        lead, memory = lag.lead(memory, -1.0, wave(k * PERIOD), math.nan)
        found.append(lead - 1.0)
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_at_rest_there_is_nothing_unseen_and_a_press_counts_in_full_and_a_way_back_by_a_quarter() -> None:
    lag = SensorLag(12.6, 1.0, PERIOD)
    rest = [0.0] * lag.size
    assert lag.lead(rest, 0.0, 0.0, 0.0)[0] == 0.0
    assert lag.lead(rest, -1e-3, 0.0, 0.0)[0] == 1e-3
    assert lag.lead(rest, 0.0, -1e-3, 0.0)[0] == pytest.approx(1e-3, rel=1e-3)
    memory = [0.0] * lag.size
    for _ in range(3):
        lead, memory = lag.lead(memory, 1e-3, 1e-3, 0.0)
    assert lead == pytest.approx(-0.25e-3, rel=0.05)


def test_a_rising_surface_is_carried_on_for_half_of_what_the_sensor_lags() -> None:
    lag = SensorLag(12.6, 1.0, PERIOD)
    memory, rate = [0.0] * lag.size, 5e-3
    for k in range(1000):
        lead, memory = lag.lead(memory, 0.0, 0.0, rate * k * PERIOD)
    assert lead == pytest.approx(0.5 * rate * 2 / 12.6, rel=1e-3)
    for k in range(1000):
        lead, memory = lag.lead(memory, 0.0, 0.0, rate * (1000 - k) * PERIOD)
    assert lead == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
def test_what_is_no_number_leaves_no_trace(bad: float) -> None:
    lag = SensorLag(12.6, 1.0, PERIOD, 2)
    memory = [0.0] * lag.size
    for k in range(600):
        lead, memory = lag.lead(memory, -1e-3, bad if k < 50 else -1e-3, bad if k < 50 else 0.0)
        assert math.isfinite(lead)
        assert all(math.isfinite(value) for value in memory)
    assert lead == pytest.approx(0.0, abs=1e-5)

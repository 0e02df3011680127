"""Explicit PI and PID force control: transfer functions on the ideal plant, and their range of stability."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.force.baselines.pid import PidConfig
from tests.force.baselines.ideal_plant import (
    C_T,
    FORCE,
    PERIOD,
    assert_does_not_wind_up,
    assert_holds_a_bad_reading,
    pressed,
)


def step_response(config: PidConfig, ticks: int, r: float = 1.0) -> np.ndarray:
    """F of a step from the z-transform: F = z^-1 r (C e + forward F_bar), e = F_bar - F."""
    fast = PERIOD + config.derivative_filter
    # Numerators of P, I and D over the denominator (1 - z^-1)(fast - T_D z^-1).
    one, slow = np.array([1.0, -1.0]), np.array([fast, -config.derivative_filter])
    common = np.polymul(one, slow)
    law = config.proportional_gain * common
    law = law + np.append(config.integral_gain * PERIOD * slow, 0.0)
    law = law + config.derivative_gain * np.polymul(one, one)
    lag = PERIOD / (PERIOD + config.feed_forward_filter)
    reference = np.full(ticks, FORCE)
    forward = config.feed_forward * lfilter([lag], [1.0, lag - 1.0], reference)
    late, closed = np.append(0.0, r * law), np.append(common, 0.0)
    closed = closed + late
    by_error = lfilter(late, closed, reference)
    return by_error + lfilter(np.append(0.0, r * common), closed, forward)


@pytest.mark.parametrize("r", [1.0, 0.6])
@pytest.mark.parametrize(
    "gains",
    [
        {},
        {"proportional_gain": 0.0},
        {"derivative_gain": 0.004, "derivative_filter": 0.01},
        {"feed_forward": 0.5},
        {"derivative_gain": 0.004, "feed_forward": 1.0, "feed_forward_filter": 0.1},
    ],
)
def test_the_step_response_is_that_of_the_z_transform(gains, r):
    config = PidConfig(**gains)
    force = pressed(config, 400, C_T / r)["contact_force"][:, 0]
    np.testing.assert_allclose(force, step_response(config, 400, r), rtol=0, atol=1e-9)


def test_it_is_stable_where_its_documentation_says():
    draw, stable = np.random.default_rng(3), 0
    for _ in range(500):
        kp, ki, r = draw.uniform([-1.5, -100.0, 0.1], [1.5, 1500.0, 2.0])
        poles = np.roots([1.0, r * kp - 1 + r * ki * PERIOD, -r * kp])
        inside = ki > 0 and r * kp > -1 and r * (2 * kp + ki * PERIOD) < 2
        assert (np.abs(poles).max() < 1) == inside
        stable += inside
    assert 100 < stable < 400


def test_a_limit_does_not_wind_it_up():
    assert_does_not_wind_up(PidConfig(lower_limit=-1e-3), 4.0, 2001)


def test_a_bad_reading_holds_the_command():
    for config in (PidConfig(), PidConfig(derivative_gain=0.01, feed_forward=1.0, feed_forward_filter=0.1)):
        assert_holds_a_bad_reading(config)


def test_gains_below_zero_are_refused():
    with pytest.raises(BadInputError, match="proportional_gain"):
        PidConfig(proportional_gain=-0.1)


def test_the_told_bandwidth_is_the_slow_pole():
    assert PidConfig().reference_model_bandwidth() == pytest.approx(1.5)

"""The disturbance observer: a loop in plain numpy, closed forms without lag, stability."""

import numpy as np
import pytest

from forcectl.force.baselines.disturbance_observer import DisturbanceObserverConfig
from tests.force.baselines.ideal_plant import (
    C_T,
    FORCE,
    PERIOD,
    assert_does_not_wind_up,
    assert_holds_a_bad_reading,
    model,
    pressed,
)


def simulated(config: DisturbanceObserverConfig, ticks: int, r: float) -> np.ndarray:
    """The contact force, from the equations as they are printed."""
    g, w, T_m = config.observer_bandwidth, config.reference_bandwidth, config.model_lag
    force, d, x_m, x, F_r = [0.0], 0.0, 0.0, 0.0, 0.0
    for _ in range(ticks - 1):
        x_m += (x - x_m) * PERIOD / (T_m + PERIOD)
        d += (-C_T * force[-1] - x_m - d) * g * PERIOD / (1 + g * PERIOD)
        F_r += (FORCE - F_r) * w * PERIOD / (1 + w * PERIOD)
        x = min(max(-C_T * F_r - d, config.lower_limit), config.upper_limit)
        force.append(-x * r / C_T)
    return np.array(force)


@pytest.mark.parametrize("r", [1.0, 0.5, 2.0])
@pytest.mark.parametrize("lag", [0.0, 0.16])
def test_the_loop_is_that_of_the_printed_equations(r, lag):
    config = DisturbanceObserverConfig(observer_bandwidth=8.0, model_lag=lag)
    force = pressed(config, 1000, C_T / r)["contact_force"][:, 0]
    np.testing.assert_allclose(force, simulated(config, 1000, r), rtol=0, atol=1e-9)


def test_with_the_right_compliance_the_force_is_the_filtered_reference_a_tick_later():
    w = 3.0
    config = DisturbanceObserverConfig(reference_bandwidth=w, model_lag=0.0)
    log = pressed(config, 500)
    expected = FORCE * (1 - (1 + w * PERIOD) ** -np.arange(500.0))
    np.testing.assert_allclose(log["contact_force"][:, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(log["disturbance"], 0.0, atol=1e-15)


def test_it_is_stable_where_its_documentation_says():
    for g in (50.0, 400.0):
        share = g * PERIOD / (1 + g * PERIOD)
        config = DisturbanceObserverConfig(observer_bandwidth=g, reference_bandwidth=100.0, model_lag=0.0)
        for r, stable in ((1.98 / share, True), (2.02 / share, False)):
            force = pressed(config, 3000, C_T / r)["contact_force"][:, 0]
            assert (abs(force[-1] - FORCE) < 0.1) == stable


def test_the_model_has_the_lag_of_the_sensor():
    law = DisturbanceObserverConfig().law(model(), None)
    context = law.CreateDefaultContext()
    assert law.parameter(context, "model_lag")[0] == pytest.approx(2 / 12.6)


def test_a_limit_does_not_wind_it_up():
    assert_does_not_wind_up(DisturbanceObserverConfig(lower_limit=-1e-3, model_lag=0.0), 6.0, 3600)


def test_a_bad_reading_holds_the_command():
    assert_holds_a_bad_reading(DisturbanceObserverConfig())

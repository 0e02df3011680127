"""The plant model behind a record: predicts the tuned loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from vrft_records import TS, contact, loop_step, trapezoidal_moves

from forcectl.estimation.controller_basis import discrete_pid, fir
from forcectl.estimation.plant_model import identify_plant


@pytest.mark.parametrize("delay", [1, 5, 40])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_contact_behind_lags_and_delay_is_found(delay, noise):
    u = trapezoidal_moves()
    numerator, denominator = contact(5.9e3, (75.4, 75.4, 12.6, 12.6), delay)
    y = lfilter(numerator, denominator, u)
    plant = identify_plant(u, y + noise * np.random.default_rng(1).normal(size=u.size), TS)
    assert plant.static_gain == pytest.approx(-5.9e3, rel=2e-3)
    assert plant.explained > 0.999
    probe = np.repeat([0.0, -1e-3, -3e-3, 0.0], 1000)
    np.testing.assert_allclose(
        plant.response(probe), lfilter(numerator, denominator, probe), atol=0.2 if noise else 0.05
    )


def test_the_loop_is_predicted():
    u = trapezoidal_moves()
    numerator, denominator = contact(5.9e3, (75.4, 75.4, 12.6, 12.6), 20)
    plant = identify_plant(u, lfilter(numerator, denominator, u), TS)
    gains = np.array([-4e-5, -8e-7, -1e-3])
    np.testing.assert_allclose(
        plant.closed_loop_step(discrete_pid(TS), gains, 2000),
        loop_step(gains, numerator, denominator, 2000),
        atol=5e-3,
    )


def test_a_loop_that_diverges_is_predicted_to():
    u = trapezoidal_moves()
    plant = identify_plant(u, lfilter(*contact(5.9e3, (12.6, 12.6), 20), u), TS)
    assert np.isnan(plant.closed_loop_step(discrete_pid(TS), [-1e-3, -1e-4, 0.0], 4000)[-1])
    assert np.isnan(plant.closed_loop_step(discrete_pid(TS), [4e-5, 5e-7, 0.0], 8000)[-1])  # wrong sign
    assert np.isfinite(plant.closed_loop_step(fir(1, TS), [-4e-5], 4000)).all()


def test_an_input_that_moves_only_at_the_end_explains_nothing():
    u = np.zeros(500)
    u[-1] = -1e-3
    assert identify_plant(u, np.sin(0.1 * np.arange(500)), TS).explained <= 0.0


def test_the_beginning_of_the_record_may_rest_for_long():
    u = np.concatenate([np.zeros(30_000), trapezoidal_moves()])
    plant = identify_plant(u, lfilter(*contact(1e4, (12.6,), 3), u), TS)
    assert plant.static_gain == pytest.approx(-1e4, rel=1e-3)

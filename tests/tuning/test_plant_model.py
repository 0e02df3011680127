"""The plant models behind a record."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.tuning.plant_model import identify_plants
from tests.examples.vrft_records import TS, contact, trapezoidal_moves


def likely(plants):
    return min(plants, key=lambda plant: plant.criterion)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [1, 5, 40])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_contact_behind_lags_and_delay_is_found(delay, noise):
    u = trapezoidal_moves()
    numerator, denominator = contact(5.9e3, (75.4, 75.4, 12.6, 12.6), delay)
    y = lfilter(numerator, denominator, u)
    plant = likely(identify_plants(u, y + noise * np.random.default_rng(1).normal(size=u.size), TS))
    assert plant.static_gain == pytest.approx(-5.9e3, rel=2e-3)
    assert plant.explained > 0.9999
    probe = np.repeat([0.0, -1e-3, -3e-3, 0.0], 1000)
    difference = plant.response(probe) - lfilter(numerator, denominator, probe)
    assert np.sqrt(np.mean(difference**2)) < (0.05 if noise else 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3])
def test_order_and_response_are_exact_where_the_plant_is_one_of_them(order):
    u = trapezoidal_moves()
    numerator, denominator = contact(2e4, (4.0, 15.0, 40.0)[:order], 17)
    plants = identify_plants(u, lfilter(numerator, denominator, u), TS)
    assert [plant.order for plant in plants] == [1, 2, 3, 4]
    assert likely(plants).order == order
    np.testing.assert_allclose(
        likely(plants).response(np.ones(4000)), lfilter(numerator, denominator, np.ones(4000)), atol=1e-3
    )


@pytest.mark.slow
def test_models_are_stable_and_do_not_ring_whatever_the_record():
    rng = np.random.default_rng(3)
    for _ in range(5):
        for plant in identify_plants(rng.normal(size=600), rng.normal(size=600), TS):
            poles = np.roots(plant.denominator)
            assert np.abs(poles).max(initial=0.0) < 1.0
            assert poles.real.min(initial=0.0) >= -1e-9


def test_an_input_that_moves_only_at_the_end_explains_nothing():
    u = np.zeros(500)
    u[-1] = -1e-3
    assert all(plant.explained <= 0.0 for plant in identify_plants(u, np.sin(0.1 * np.arange(500)), TS))


@pytest.mark.slow
def test_the_beginning_of_the_record_may_rest_for_long():
    u = np.concatenate([np.zeros(30_000), trapezoidal_moves()])
    plant = likely(identify_plants(u, lfilter(*contact(1e4, (12.6,), 3), u), TS))
    assert plant.static_gain == pytest.approx(-1e4, rel=1e-3)

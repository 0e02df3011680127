"""Assertions on signals: what passes, and what the message says where it does not."""

import numpy as np
import pytest
from pydrake.examples import PendulumPlant

from forcectl.errors import BadInputError
from forcectl.testing import (
    assert_energy_does_not_grow,
    assert_no_limit_cycle,
    assert_within,
    run_diagram,
)

TIME = np.arange(0.0, 10.0005, 0.01)


def log(**signals):
    return {"time": TIME, **signals}


def test_bounds():
    wave = log(x=np.sin(TIME), v=np.column_stack([np.sin(TIME), 2 * np.sin(TIME)]))
    assert_within(wave, "x", -1, 1)
    assert_within(wave, "v", [-1, -2], [1, 2])
    assert_within(wave, "x", upper=np.abs(np.sin(TIME)))
    assert_within(wave, "x", 0.0, start=0.0, end=3.0)
    message = r"v\[1\] is 1.5\d* at t = 0.85 s, outside of -inf ... 1.5; \d+ of 1001 samples are"
    with pytest.raises(AssertionError, match=message):
        assert_within(wave, "v", upper=1.5)
    with pytest.raises(AssertionError, match="x is nan at t = 5 s"):
        assert_within(log(x=np.where(TIME < 4.995, 0.0, np.nan)), "x")


def test_bad_bounds():
    with pytest.raises(BadInputError, match="unknown signal 'y'"):
        assert_within(log(x=TIME), "y")
    with pytest.raises(BadInputError, match="no sample between; the log is from 0 to 10 s"):
        assert_within(log(x=TIME), "x", start=11.0)
    with pytest.raises(BadInputError, match=r"lower: has shape \(3,\): must be one number, 1 of them, or 1001 samples"):
        assert_within(log(x=TIME), "x", lower=[1, 2, 3])


def test_limit_cycle():
    swing = np.sin(2 * np.pi * TIME)
    with pytest.raises(AssertionError, match=r"x has a limit cycle of amplitude 0.5, period 1 s, from t = "):
        assert_no_limit_cycle(log(x=0.5 * swing), "x", 0.1)
    assert_no_limit_cycle(log(x=0.5 * swing), "x", 0.6)
    assert_no_limit_cycle(log(x=swing * np.exp(-TIME)), "x", 0.01)
    assert_no_limit_cycle(log(x=np.where(TIME < 5, swing, 0.0)), "x", 0.1)
    assert_no_limit_cycle(log(x=TIME), "x", 0.1)
    with pytest.raises(AssertionError, match="not always a finite number"):
        assert_no_limit_cycle(log(x=swing * np.nan), "x", 0.1)
    with pytest.raises(BadInputError, match="amplitude = 0: must be positive"):
        assert_no_limit_cycle(log(x=swing), "x", 0)


def test_energy_of_a_plant_with_and_without_a_motor():
    plant = PendulumPlant()
    context = plant.CreateDefaultContext()
    context.SetContinuousState([1.0, 0.0])
    free = run_diagram(plant, 5.0, period=0.01, energy=True, context=context)
    assert_energy_does_not_grow(free)
    driven = run_diagram(plant, 5.0, period=0.01, energy=True, inputs={"tau": 1.0})
    with pytest.raises(AssertionError, match=r"energy grows from t = 0\.\d+ s on, by [\d.]+ J until t = .* allowed is"):
        assert_energy_does_not_grow(driven)
    with pytest.raises(BadInputError, match="state: has 2 elements: must be one energy"):
        assert_energy_does_not_grow(free, "state")
    assert free.units["energy"] == "J"


def test_small_growth_that_is_allowed():
    energy = 1.0 - 0.1 * TIME + 0.01 * np.sin(20 * TIME)
    with pytest.raises(AssertionError, match="grows"):
        assert_energy_does_not_grow(log(energy=energy))
    assert_energy_does_not_grow(log(energy=energy), tolerance=0.03)

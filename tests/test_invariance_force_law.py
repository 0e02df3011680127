"""Invariance force control of relative degree 2: exact landing, minimum time, moving references and safe behaviour."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.control.invariance_force_law import one_step_acceleration
from forcectl.lanes import SCALAR_MATH

PERIOD = 0.002
brakings = st.floats(1e-3, 1.0)


def phi(y, rate, gamma):
    return np.where(rate <= 0, y, y - rate**2 / (2 * gamma))


@given(st.floats(-1e-2, 1e-2), st.floats(-0.1, 0.1), brakings, st.floats(0.1, 10.0))
@settings(max_examples=300)
def test_floats_and_arrays_agree_and_stay_within_the_bounds(y, rate, braking, ratio):
    gamma, upper = -braking, ratio * braking
    a = one_step_acceleration(y, rate, gamma, upper, PERIOD, SCALAR_MATH)
    assert a == one_step_acceleration(np.array([y]), np.array([rate]), gamma, upper, PERIOD).item()
    low, high = (gamma, upper) if y <= 0 else (-upper, -gamma)
    assert low <= a <= high


@given(st.floats(-1e-2, 0.0), st.floats(-0.1, 0.1), brakings)
@settings(max_examples=300)
def test_it_is_the_largest_up_to_the_corners_that_keeps_the_constraint_one_step_ahead(y, rate, braking):
    gamma, unit = -braking, braking * PERIOD**2

    def after(a):
        return phi(y + PERIOD * rate + PERIOD**2 * a / 2, rate + PERIOD * a, gamma)

    a = one_step_acceleration(y, rate, gamma, braking, PERIOD, SCALAR_MATH)
    if after(gamma) <= 0:
        assert after(a) <= 1e-9 * unit
        if a < braking:
            # The polygon is at most an eighth of a unit smaller than the set itself.
            assert after(a + 1e-6 * braking) > -(1 / 8 + 1e-9) * unit

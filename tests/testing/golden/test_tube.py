"""What lies in the tube around a signal, and what does not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcectl.testing.golden.tube import beyond, tube_around

TIME = np.arange(0.0, 1.0005, 0.001)


def step(at):
    return (at <= TIME).astype(float)


def apart(a, b, time=0.0, value=0.0, times=(TIME, TIME)):
    """The largest distance of either from the tube around the other."""
    return max(beyond(times[0], a, times[1], b, time, value).max(), beyond(times[1], b, times[0], a, time, value).max())


def test_the_same_signal_is_in_a_tube_of_no_width():
    assert apart(np.sin(TIME), np.sin(TIME)) == 0.0


def test_a_value_beyond_the_tolerance_is_outside_by_what_is_beyond():
    assert apart(np.sin(TIME) + 0.009, np.sin(TIME), value=0.01) == 0.0
    assert apart(np.sin(TIME) + 0.015, np.sin(TIME), value=0.01) == pytest.approx(0.005)


@given(shift=st.integers(-30, 30), width=st.integers(0, 30))
def test_a_step_may_be_shifted_by_the_tolerance_in_time_and_no_more(shift, width):
    distance = apart(step(0.5 + 0.001 * shift), step(0.5), time=0.001 * width)
    assert (distance == 0.0) == (abs(shift) <= width)


@given(shift=st.floats(-0.0099, 0.0099))
def test_a_curve_may_be_shifted_by_less_than_the_tolerance_in_time(shift):
    inner = (TIME > 0.02) & (TIME < 0.98)  # at the ends there is nothing to shift from
    shifted = np.sin(20 * (TIME - shift))
    assert beyond(TIME, shifted, TIME, np.sin(20 * TIME), 0.01, 1e-3)[inner].max() == 0.0


def test_a_pulse_must_be_there_in_both():
    pulse = step(0.5) - step(0.503)
    nothing = np.zeros_like(TIME)
    assert beyond(TIME, nothing, TIME, pulse, 0.01, 0.0).max() == 0.0  # one way a wide tube hides it
    assert apart(nothing, pulse, time=0.01) == 1.0
    assert apart(pulse, nothing, time=0.01) == 1.0


def test_other_sample_times_are_compared_as_lines():
    coarse = TIME[::4]
    assert apart(np.sin(coarse), np.sin(TIME), value=1e-5, times=(coarse, TIME)) == 0.0
    assert apart(step(0.5)[::4], step(0.5), time=0.004, times=(coarse, TIME)) == 0.0
    assert apart(step(0.51)[::4], step(0.5), time=0.004, times=(coarse, TIME)) == 1.0


def test_times_that_differ_by_rounding_are_the_same():
    assert apart(step(0.5), step(0.5), times=(TIME, TIME * (1 + 1e-12))) == 0.0


@pytest.mark.parametrize("what", [np.nan, np.inf, -np.inf])
def test_where_one_is_no_number_the_other_must_be_likewise(what):
    odd = np.where((TIME > 0.5) & (TIME < 0.6), what, np.sin(TIME))
    assert apart(odd, odd) == 0.0
    assert apart(odd, np.sin(TIME)) == np.inf
    shifted = np.where((TIME > 0.502) & (TIME < 0.602), what, np.sin(TIME))
    assert apart(odd, shifted, time=0.003, value=0.002) == 0.0
    assert apart(odd, shifted, time=0.001, value=0.002) == np.inf
    other = np.inf if np.isnan(what) else -what
    assert apart(odd, np.where(np.isfinite(odd), odd, other)) == np.inf


def test_the_tube_is_as_wide_as_stated():
    tube = tube_around(TIME, TIME, np.array([0.5]), 0.01, 0.002)
    np.testing.assert_allclose([tube.lower[0], tube.upper[0]], [0.488, 0.512])


def test_a_log_of_one_sample():
    one = np.zeros(1)
    assert beyond(one, one + 1.0, one, one, 0.0, 0.5)[0] == 0.5

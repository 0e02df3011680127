"""Step responses and what is asserted of them."""

import numpy as np
import pytest
from pydrake.systems.primitives import Adder, Gain, LinearSystem

from forcectl.errors import BadInputError
from forcectl.testing import StepResponse, assert_no_overshoot, assert_settles_within, step_response


def made(value, period=0.1):
    value = np.asarray(value, dtype=float)
    return StepResponse(period * np.arange(value.size), value, 1.0, "u", "y")


def first_order():
    return LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def test_a_first_order_lag():
    response = step_response(first_order(), "u0", "y0", 3.0, duration=5.0, period=0.01)
    np.testing.assert_allclose(response.value, 3.0 * (1 - np.exp(-response.time)), atol=1e-8)
    assert (response.input, response.output, response.amplitude) == ("u0", "y0", 3.0)
    assert response.period == pytest.approx(0.01)


def test_single_elements_step_and_are_watched():
    mixed = Gain(np.array([1.0, 2.0]))
    assert step_response(mixed, "u0", "y0", input_index=1, output_index=1, duration=0.01).value[0] == 2.0
    assert step_response(mixed, "u0", "y0", input_index=1, output_index=0, duration=0.01).value[0] == 0.0
    assert str(step_response(mixed, "u0", "y0", input_index=1, duration=0.01)) == "step response u0[1] -> y0[0]"


def test_other_inputs_have_values():
    assert step_response(Adder(2, 1), "u0", "sum", 1.0, 0.01, others={"u1": 5.0}).value[0] == 6.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"input": "u"}, "unknown vector input 'u'"),
        ({"output": "y"}, "unknown vector output 'y'"),
        ({"input_index": 2}, r"input_index = 2: must be 0 ... 1"),
        ({"output_index": 2}, r"output_index = 2: must be 0 ... 1"),
        ({"others": {"u0": 1.0}}, "others: 'u0' is the input that steps"),
        ({"period": -1.0}, "period = -1.0"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(BadInputError, match=message):
        step_response(**{"system": Gain(1.0, 2), "input": "u0", "output": "y0", **arguments})


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_overshoot_of_rising_and_falling_responses(sign):
    response = made(sign * np.array([0.0, 0.5, 1.2, 1.0]))
    with pytest.raises(AssertionError, match=r"overshoots by 0\.2 \(20\.00%\) at t = 0\.2 s"):
        assert_no_overshoot(response)
    assert_no_overshoot(response, tolerance=0.21)
    assert_no_overshoot(response, final=sign * 1.2)
    assert_no_overshoot(made(sign * np.array([0.0, 0.5, 0.9, 1.0])))


def test_settling_counts_the_last_time_outside():
    response = made([0.0, 1.0, 1.1, 1.0, 1.03, 1.0, 1.0])
    assert_settles_within(response, 0.45)
    assert_settles_within(response, 0.25, band=0.05)
    with pytest.raises(AssertionError, match=r"last outside at t = 0\.4 s, with 1\.03; the band is 1 \+- 0\.02 \(2%\)"):
        assert_settles_within(response, 0.35)


def test_a_response_that_ends_outside_never_settles():
    with pytest.raises(AssertionError, match="never settles"):
        assert_settles_within(made([0.0, 1.0, 1.5]), 0.1, final=1.0)


def test_nothing_can_be_said_about_no_step_or_no_number():
    for check in (assert_no_overshoot, lambda r: assert_settles_within(r, 0.1)):
        with pytest.raises(AssertionError, match="ends where it begins, at 2: there is no step to judge"):
            check(made([2.0, 2.0, 2.0]))
        with pytest.raises(AssertionError, match=r"is nan at t = 0\.1 s"):
            check(made([0.0, np.nan, 1.0]))


def test_a_response_that_is_too_short_is_refused():
    with pytest.raises(BadInputError, match=r"seconds = 1.0: must be within the response, which ends at 0\.2 s"):
        assert_settles_within(made([0.0, 1.0, 1.0]), 1.0)
    with pytest.raises(BadInputError, match=r"band = 0\.0"):
        assert_settles_within(made([0.0, 1.0, 1.0]), 0.1, band=0.0)

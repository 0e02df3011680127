"""Responses against a linear model, of every kind."""

import numpy as np
import pytest
from pydrake.systems.primitives import Gain, LinearSystem, ZeroOrderHold

from forcectl.errors import BadInputError
from forcectl.testing import StepResponse, assert_matches_model, step_response


def second_order(w=5.0, z=0.3):
    return LinearSystem([[0.0, 1.0], [-w * w, -2 * z * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0.0]])


def response():
    return step_response(second_order(), "u0", "y0", 2.0, duration=4.0, period=0.01)


def closed_form(t, w=5.0, z=0.3):
    d = w * np.sqrt(1 - z * z)
    return 2.0 * (1 - np.exp(-z * w * t) * (np.cos(d * t) + z * w / d * np.sin(d * t)))


@pytest.mark.parametrize(
    "model", [closed_form, ([25.0], [1.0, 3.0, 25.0]), second_order()], ids=["function", "transfer", "LinearSystem"]
)
def test_every_kind_of_model(model):
    assert_matches_model(response(), model, atol=1e-6)


@pytest.mark.parametrize(
    "model",
    [lambda t: closed_form(t, w=5.1), ([26.0], [1.0, 3.0, 26.0]), second_order(w=5.1), lambda t: 2.0],
    ids=["function", "transfer", "LinearSystem", "constant"],
)
def test_a_slightly_wrong_model_is_refused(model):
    with pytest.raises(AssertionError, match=r"differs from the model in \d+ of 401 samples, first at t = .* allowed"):
        assert_matches_model(response(), model, atol=1e-3)


def test_discrete_models():
    lag = LinearSystem([[0.5]], [[0.5]], [[1.0]], [[0.0]], 0.1)
    found = step_response(lag, "u0", "y0", 1.0, duration=2.0, period=0.1)
    assert_matches_model(found, ([0.5], [1.0, -0.5], 0.1), atol=1e-12)
    assert_matches_model(found, lag, atol=1e-12)
    hold = step_response(ZeroOrderHold(0.1, 1), "u", "y", 1.0, duration=2.0, period=0.1)
    assert_matches_model(hold, ([1.0], [1.0, 0.0], 0.1), atol=1e-12)
    with pytest.raises(BadInputError, match=r"period of the model = 0.2: must be that of the response, 0\.1 s"):
        assert_matches_model(hold, ([1.0], [1.0, 0.0], 0.2), atol=1e-12)


def test_a_static_gain():
    found = step_response(Gain(3.0, 1), "u0", "y0", 2.0, duration=0.1, period=0.01)
    assert_matches_model(found, ([3.0], [1.0]), atol=1e-12)
    assert_matches_model(found, lambda t: 6.0, rtol=1e-12)


def test_the_relative_tolerance_is_of_the_models_largest_value():
    found = StepResponse(np.array([0.0, 1.0]), np.array([0.1, 10.0]), 1.0, "u", "y")
    assert_matches_model(found, lambda t: np.array([0.0, 10.0]), rtol=0.011)
    with pytest.raises(AssertionError, match=r"allowed 0\.09"):
        assert_matches_model(found, lambda t: np.array([0.0, 10.0]), rtol=0.009)


def test_nan_never_matches():
    found = StepResponse(np.array([0.0, 1.0]), np.array([0.0, np.nan]), 1.0, "u", "y")
    with pytest.raises(AssertionError, match=r"in 1 of 2 samples, first at t = 1 s"):
        assert_matches_model(found, lambda t: np.zeros(2), atol=100.0)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("1/(s+1)", "must be a function of time"),
        (lambda t: np.zeros(3), r"returned shape \(3,\) for times of shape \(401,\)"),
        (LinearSystem([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]), "the model has 2 inputs and 1 outputs"),
    ],
)
def test_other_models_are_refused(model, message):
    with pytest.raises(BadInputError, match=message):
        assert_matches_model(response(), model, atol=1.0)


def test_a_tolerance_must_be_given():
    with pytest.raises(BadInputError, match="one of them must be positive"):
        assert_matches_model(response(), closed_form)

"""A step response compared with the model that it should follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.primitives import LinearSystem

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.testing.response import StepResponse, step_response

TransferFunction: TypeAlias = tuple[Sequence[float], Sequence[float]] | tuple[Sequence[float], Sequence[float], float]
Model: TypeAlias = Callable[[Array], ArrayLike] | TransferFunction | LinearSystem


def assert_matches_model(response: StepResponse, model: Model, *, atol: float = 0.0, rtol: float = 0.0) -> None:
    """The response equals the model's at every sample: `|y - y_model|` <= atol + rtol * max `|y_model|`.

    Args:
        response: from `step_response`.
        model: one of a function of time [s], shape (N,), that gives the response to this step, or one number;
            (numerator, denominator) of a continuous transfer function, highest power first; (numerator, denominator,
            period [s]) of a discrete one; a Drake LinearSystem with one input and one output, continuous or discrete.
        atol: allowed difference, unit of the output.
        rtol: allowed difference as a share of the model's largest value.

    Raises:
        AssertionError: with the time of the first and of the worst difference.
        BadInputError: a model of another kind or rate, or no tolerance.
    """
    __tracebackhide__ = True
    if not (atol > 0 or rtol > 0):
        raise BadInputError(f"atol = {atol}, rtol = {rtol}: one of them must be positive")
    expected = _expected(response, model)
    difference = np.abs(response.value - expected)
    allowed = atol + rtol * float(np.max(np.abs(expected)))
    outside = np.flatnonzero(~(difference <= allowed))  # written so that NaN is outside
    if outside.size == 0:
        return
    first, worst = int(outside[0]), int(outside[np.argmax(np.nan_to_num(difference[outside], nan=np.inf))])
    raise AssertionError(
        f"{response} differs from the model in {outside.size} of {difference.size} samples, first at "
        f"t = {response.time[first]:g} s, most at t = {response.time[worst]:g} s: response {response.value[worst]:g}, "
        f"model {expected[worst]:g}, difference {difference[worst]:g}, allowed {allowed:g}"
    )


def _expected(response: StepResponse, model: Model) -> Array:
    if isinstance(model, LinearSystem):
        source, output = model.get_input_port(), model.get_output_port()
        if source.size() != 1 or output.size() != 1:
            raise BadInputError(
                f"the model has {source.size()} inputs and {output.size()} outputs: must have one of each"
            )
        ports, duration = (source.get_name(), output.get_name()), float(response.time[-1])
        return step_response(model, *ports, response.amplitude, duration, response.period).value
    if callable(model):
        value = np.asarray(model(response.time), dtype=float)
        if value.shape not in ((), response.time.shape):
            raise BadInputError(f"the model returned shape {value.shape} for times of shape {response.time.shape}")
        return np.broadcast_to(value, response.time.shape)
    if isinstance(model, tuple) and len(model) in (2, 3):
        return _transfer_function(response, model)
    raise invalid("model", model, "a function of time, (num, den), (num, den, period) or a LinearSystem")


def _transfer_function(response: StepResponse, model: TransferFunction) -> Array:
    from scipy import signal

    step = np.full(response.time.shape, response.amplitude)
    if len(model) == 2:
        # Exact for a step, which is constant between the samples.
        return np.ravel(signal.lsim((model[0], model[1]), step, response.time, interp=False)[1])
    if not np.isclose(model[2], response.period):
        raise invalid("period of the model", model[2], f"that of the response, {response.period:g} s")
    return np.ravel(signal.dlsim((model[0], model[1], model[2]), step)[1])

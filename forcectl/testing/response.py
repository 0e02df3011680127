"""Step responses, and assertions about their overshoot and settling time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.testing.runs import Input, run_diagram, vector_inputs, vector_outputs


@dataclass(frozen=True, eq=False)
class StepResponse:
    """The response of one element of an output to a step at t = 0.

    Attributes:
        time: [s], shape (N,), evenly spaced from 0.
        value: shape (N,), unit of the output; read before the updates of each instant.
        amplitude: size of the step, unit of the input.
        input: "port" or "port[i]".
        output: likewise.
    """

    time: Array
    value: Array
    amplitude: float
    input: str
    output: str

    @property
    def period(self) -> float:
        """Distance of the samples [s]."""
        return float(self.time[1] - self.time[0])

    def __str__(self) -> str:
        return f"step response {self.input} -> {self.output}"


def step_response(
    system: System,
    input: str,
    output: str,
    amplitude: float = 1.0,
    duration: float = 1.0,
    period: float = 0.001,
    *,
    input_index: int | None = None,
    output_index: int = 0,
    others: Mapping[str, Input] | None = None,
) -> StepResponse:
    """Step one input at t = 0, from the default context, and log one element of an output.

    Args:
        system: any diagram or block.
        input: name of a vector input.
        output: name of a vector output.
        amplitude: size of the step, unit of the input.
        duration: [s].
        period: distance of the samples [s].
        input_index: the element that steps; default all of them.
        output_index: the element that is logged.
        others: values of other inputs, see `run_diagram`; default zero.

    Raises:
        BadInputError: a port or an element that does not exist, or a time that is not positive.
    """
    if input in (others or {}):
        raise BadInputError(f"others: {input!r} is the input that steps")
    stepped = np.full(1, amplitude)
    sizes = {name: port.size() for name, port in vector_inputs(system).items()}
    if input in sizes and input_index is not None:
        if not 0 <= input_index < sizes[input]:
            raise invalid("input_index", input_index, f"0 ... {sizes[input] - 1}")
        stepped = np.zeros(sizes[input])
        stepped[input_index] = amplitude
    size = vector_outputs(system, [output])[output].size()
    if not 0 <= output_index < size:
        raise invalid("output_index", output_index, f"0 ... {size - 1}")
    inputs = {**(others or {}), input: stepped}
    log = run_diagram(system, duration, period=period, inputs=inputs, outputs=[output], accuracy=1e-9)
    named_input = input if input_index is None else f"{input}[{input_index}]"
    named_output = output if size == 1 else f"{output}[{output_index}]"
    return StepResponse(log.time, log[output][:, output_index], float(amplitude), named_input, named_output)


def _final(response: StepResponse, final: float | None) -> tuple[float, float]:
    """Final value, and signed height of the step at the output, which must not be zero."""
    __tracebackhide__ = True
    end = float(response.value[-1]) if final is None else float(final)
    height = end - float(response.value[0])
    if not np.all(np.isfinite(response.value)):
        bad = int(np.flatnonzero(~np.isfinite(response.value))[0])
        raise AssertionError(f"{response} is {response.value[bad]} at t = {response.time[bad]:g} s")
    if height == 0.0:
        raise AssertionError(f"{response} ends where it begins, at {end:g}: there is no step to judge")
    return end, height


def assert_no_overshoot(response: StepResponse, final: float | None = None, tolerance: float = 0.0) -> None:
    """The response never goes beyond its final value.

    Args:
        response: rising or falling.
        final: final value, unit of the output; default the last sample.
        tolerance: how far beyond is allowed, unit of the output.

    Raises:
        AssertionError: with the overshoot, absolute and in percent of the step, and its time.
    """
    __tracebackhide__ = True
    end, height = _final(response, final)
    beyond = (response.value - end) * np.sign(height)
    k = int(np.argmax(beyond))
    if beyond[k] > tolerance:
        raise AssertionError(
            f"{response} overshoots by {beyond[k]:g} ({beyond[k] / abs(height):.2%}) at t = {response.time[k]:g} s: "
            f"it reaches {response.value[k]:g}, the final value is {end:g}, allowed is {tolerance:g} beyond"
        )


def assert_settles_within(
    response: StepResponse, seconds: float, band: float = 0.02, final: float | None = None
) -> None:
    """The response enters a band around its final value within the given time and never leaves it again.

    Args:
        response: rising or falling.
        seconds: [s]; the response must be longer.
        band: half width as a share of the step, 0.02 for 2 %.
        final: final value, unit of the output; default the last sample.

    Raises:
        AssertionError: with the time when the response was last outside the band.
        BadInputError: the response is too short to tell, or the band is not positive.
    """
    __tracebackhide__ = True
    if not band > 0:
        raise invalid("band", band, "positive, such as 0.02 for 2 %")
    if not 0 <= seconds < response.time[-1]:
        raise invalid("seconds", seconds, f"within the response, which ends at {response.time[-1]:g} s")
    end, height = _final(response, final)
    outside = np.flatnonzero(np.abs(response.value - end) > band * abs(height))
    if outside.size and response.time[outside[-1]] >= seconds:
        k = int(outside[-1])
        when = f"is last outside at t = {response.time[k]:g} s" if k + 1 < response.value.size else "never settles"
        raise AssertionError(
            f"{response} {when}, with {response.value[k]:g}; the band is {end:g} +- {band * abs(height):g} "
            f"({band:.0%}), allowed are {seconds:g} s"
        )

"""The delay of a whole diagram, measured from outside: step an input and watch an output."""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import System

from forcectl.doctor.wiring import is_vector
from forcectl.errors import invalid, unknown


def measure_delay(
    system: System,
    input_port_name: str,
    output_port_name: str,
    *,
    tick: float,
    amplitude: float = 1.0,
    start: float = 0.0,
    longest: float = 1.0,
    threshold: float = 0.0,
) -> float | None:
    """Time from a step at an input until the output differs from a run without the step.

    The step comes just before the updates at `start`; the output is read every `tick` just before the updates of
    that instant, as a discrete block of period `tick` would read it. Other vector inputs are held at zero. A
    feedthrough gives 0, one sampled block its period. A continuous filter on the way answers at the first tick, if
    only by little: give a `threshold` to ask for a visible answer.

    Args:
        system: any diagram or block.
        input_port_name: a vector input of `system`.
        output_port_name: a vector output of `system`.
        tick: resolution [s], usually the control period.
        amplitude: size of the step, unit of the input.
        start: when the step comes [s], a multiple of `tick`; matters where periods differ.
        longest: when to give up, after `start` [s].
        threshold: largest difference that still counts as no answer, unit of the output.

    Returns:
        The delay [s], or None when nothing changed.

    Raises:
        BadInputError: unknown port, abstract port, or a value out of range.
    """
    if not tick > 0:
        raise invalid("tick", tick, "positive [s]")
    if not start >= 0:
        raise invalid("start", start, "zero or positive [s]")
    inputs = {system.get_input_port(i, False).get_name(): i for i in range(system.num_input_ports())}
    outputs = {system.get_output_port(i, False).get_name(): i for i in range(system.num_output_ports())}
    if input_port_name not in inputs:
        raise unknown("input port", input_port_name, inputs)
    if output_port_name not in outputs:
        raise unknown("output port", output_port_name, outputs)
    stepped = system.get_input_port(inputs[input_port_name], False)
    watched = system.get_output_port(outputs[output_port_name], False)
    for port in (stepped, watched):
        if not is_vector(port):
            raise invalid("port", port.get_name(), "a vector port: a step of an abstract value has no meaning")

    runs = [Simulator(system), Simulator(system)]
    for run in runs:
        for i in range(system.num_input_ports()):
            port = system.get_input_port(i, False)
            if is_vector(port):
                port.FixValue(run.get_mutable_context(), np.zeros(port.size()))
        run.Initialize()
        if start > 0:
            run.AdvanceTo(start)
    stepped.FixValue(runs[1].get_mutable_context(), np.full(stepped.size(), amplitude))
    for k in range(round(longest / tick) + 1):
        if k > 0:  # at k = 0 AdvanceTo would already carry out the updates of this instant
            for run in runs:
                run.AdvanceTo(start + k * tick)
        difference = watched.Eval(runs[1].get_context()) - watched.Eval(runs[0].get_context())
        if np.any(np.abs(difference) > threshold):
            return float(f"{k * tick:.9g}")
    return None

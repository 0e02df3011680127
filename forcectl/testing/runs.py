"""Run any system with given inputs and keep what its outputs show at every tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, InputPort, OutputPort, System

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.inspect.names import own_name
from forcectl.inspect.ports import optional_inputs
from forcectl.inspect.wiring import is_vector

Array = NDArray[np.float64]
Input = ArrayLike | Callable[[float], ArrayLike]


@dataclass(frozen=True, eq=False)
class Log:
    """Outputs by name over time.

    Attributes:
        time: [s], shape (N,).
        values: each output's values, shape (N, size of the port), unit of the port.
    """

    time: Array
    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        if name not in self.values:
            raise unknown("logged output", name, self.values)
        return self.values[name]


def run_diagram(
    system: System,
    duration: float,
    *,
    period: float,
    inputs: Mapping[str, Input] | None = None,
    outputs: Sequence[str] | None = None,
    context: Context | None = None,
    accuracy: float = 1e-6,
) -> Log:
    """Simulate a system and read its outputs every `period`, before the updates of that instant.

    Args:
        system: any diagram or block.
        duration: [s], counted from the time of the context.
        period: distance of the samples [s].
        inputs: input port name -> constant value, or function of time [s] that is sampled and held every `period`. A
            number fills the whole port. Vector inputs that are not named are held at zero.
        outputs: names of the vector outputs to log; default all.
        context: where to start; default the system's default context. It is changed.
        accuracy: of the integration of continuous states.

    Raises:
        BadInputError: a port that does not exist, or a value that does not fit.
    """
    if not period > 0:
        raise invalid("period", period, "positive [s]")
    if not duration >= period:
        raise invalid("duration", duration, f"at least one period ({period:g} s)")
    context = system.CreateDefaultContext() if context is None else context
    fixed = fix_inputs(system, context, inputs or {})
    ports = vector_outputs(system, outputs)
    simulator = Simulator(system, context)
    start = context.get_time()
    config = SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=period, accuracy=accuracy, start_time=start
    )
    ApplySimulatorConfig(config, simulator)  # it also sets the time, hence `start_time`
    # A context that has already run must not go through the initialisation events once more.
    simulator.Initialize(InitializeParams(suppress_initialization_events=start > 0))
    steps = round(duration / period)
    time = start + period * np.arange(steps + 1)
    values: dict[str, list[Array]] = {name: [] for name in ports}
    for k in range(steps + 1):
        if k > 0:  # AdvanceTo the time it is at would already carry out the updates of this instant
            simulator.AdvanceTo(time[k])
        for port, function in fixed:
            port.FixValue(context, _vector(port, function(float(time[k]))))
        for name, output in ports.items():
            values[name].append(output.Eval(context).copy())
    return Log(time, {name: np.array(rows) for name, rows in values.items()})


def vector_inputs(system: System) -> dict[str, InputPort]:
    """All vector inputs by name."""
    ports = (system.get_input_port(i, False) for i in range(system.num_input_ports()))
    return {port.get_name(): port for port in ports if is_vector(port)}


def vector_outputs(system: System, names: Sequence[str] | None) -> dict[str, OutputPort]:
    """The named vector outputs, or all of them.

    Raises:
        BadInputError: no vector output has this name, or there is none at all.
    """
    ports = (system.get_output_port(i, False) for i in range(system.num_output_ports()))
    known = {port.get_name(): port for port in ports if is_vector(port)}
    if not known:
        raise BadInputError(f"{own_name(system)} has no vector output to look at: export one")
    for name in names or ():
        if name not in known:
            raise unknown("vector output", name, known)
    return {name: known[name] for name in (known if names is None else names)}


def fix_inputs(
    system: System, context: Context, inputs: Mapping[str, Input]
) -> list[tuple[InputPort, Callable[[float], ArrayLike]]]:
    """Fix all vector inputs in `context`; returns those that follow a function of time.

    Inputs that already have a value in the context keep it unless they are named; inputs that the block lists in
    `optional_inputs` stay open.
    """
    known = vector_inputs(system)
    for name in inputs:
        if name not in known:
            raise unknown("vector input", name, known)
    functions: list[tuple[InputPort, Callable[[float], ArrayLike]]] = []
    for name, port in known.items():
        value = inputs.get(name, 0.0)
        if callable(value):
            functions.append((port, value))
            port.FixValue(context, _vector(port, value(context.get_time())))
        elif name in inputs or not (port.HasValue(context) or name in optional_inputs(system)):
            port.FixValue(context, _vector(port, value))
    return functions


def _vector(port: InputPort, value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim > 1 or array.size not in (1, port.size()):
        raise BadInputError(f"input {port.get_name()!r}: value of shape {array.shape}, the port has size {port.size()}")
    return np.broadcast_to(array.ravel(), port.size()).copy()

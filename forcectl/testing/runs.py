"""Run any system with given inputs and log its outputs at every tick."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, EventStatus, InputPort, OutputPort, System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, RunFailedError, invalid, unknown
from forcectl.framework.wiring import optional_inputs
from forcectl.inspect.names import own_name, type_in_words
from forcectl.inspect.ports import one_output, unit
from forcectl.inspect.schedule import instants
from forcectl.inspect.wiring import PortAddress, Wiring, context_of, is_vector
from forcectl.testing.faults import Fault, FaultyPorts

if TYPE_CHECKING:
    import xarray as xr

Input = ArrayLike | Callable[[float], ArrayLike]


@dataclass(frozen=True, eq=False)
class Log:
    """Outputs by name over time.

    Attributes:
        time: [s], shape (N,).
        values: each output's values, shape (N, size of the port), unit of the port.
        units: of the outputs, as far as they are known.
    """

    time: Array
    values: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        if name not in self.values:
            raise unknown("logged output", name, self.values)
        return self.values[name]

    def to_xarray(self) -> xr.Dataset:
        """The log over `time`, with units; outputs with several elements are over `<name>_component` as well."""
        import xarray as xr

        variables = {}
        for name, values in self.values.items():
            attributes = {"units": self.units.get(name, ""), "long_name": name}
            narrow = values.shape[1] == 1
            dimensions = ("time",) if narrow else ("time", f"{name}_component")
            variables[name] = (dimensions, values[:, 0] if narrow else values, attributes)
        return xr.Dataset(variables, {"time": ("time", self.time, {"units": "s", "long_name": "time"})})


def run_diagram(
    system: System,
    duration: float,
    *,
    period: float,
    inputs: Mapping[str, Input] | None = None,
    outputs: Sequence[str] | None = None,
    faults: Mapping[str, Fault | Sequence[Fault]] | None = None,
    energy: bool = False,
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
        outputs: names of the vector outputs to log, `block.port` for those of blocks inside; default all of the system.
        faults: one or several by the name of a port inside, see `forcectl.testing.Fault`. The faulty values are renewed
            every `period`.
        energy: log the kinetic and potential energy of the system as `energy` [J].
        context: where to start; default the system's default context. It is changed.
        accuracy: of the integration of continuous states.

    Raises:
        BadInputError: a port that does not exist, or a value that does not fit.
        RunFailedError: Drake refused to go on, for example with a state that is not a number.
    """
    if not isinstance(system, System):
        raise BadInputError(f"run_diagram() takes a Drake system, not {type_in_words(system)}")
    if not period > 0:
        raise invalid("period", period, "positive [s]")
    if not duration >= period:
        raise invalid("duration", duration, f"at least one period ({period:g} s)")
    own = system.CreateDefaultContext() if context is None else context
    fixed = fix_inputs(system, own, inputs or {})
    ports = vector_outputs(system, outputs, needed=not energy)
    bodies = [block for _, block in Wiring(system).leaves()] if energy else []
    faulty = FaultyPorts(system, faults, own, period) if faults else None
    start = own.get_time()
    simulator, context = _simulator(system, own, period, accuracy, begun=start > 0), own
    steps = round(duration / period)
    time = np.array(instants(start, period, steps + 1))
    values: dict[str, list[Array]] = {name: [] for name in (*ports, *["energy"] * energy)}
    fed = [port for port in vector_inputs(system).values() if port.HasValue(own)]
    finite = True
    with _in_words(lambda: simulator.get_context().get_time()):
        for k in range(steps + 1):
            if k > 0:  # AdvanceTo the time it is at would already carry out the updates of this instant
                _advance(simulator, system, time[k], may_be_nan=not finite)
            for port, function in fixed:
                for each in (context, faulty.fault_free) if faulty else (context,):
                    port.FixValue(each, _vector(port, function(float(time[k]))))
            if faulty and (other := faulty.begin_tick(context)) is not context:
                context, simulator = other, _simulator(system, other, period, accuracy, begun=True)
            for name, output in ports.items():
                values[name].append(output.Eval(context_of(output.get_system(), system, context)).copy())
            if energy:
                values["energy"].append(np.array([_energy(bodies, system, context)]))
            finite = finite and all(np.isfinite(port.Eval(context)).all() for port in fed)
            if faulty and faulty.has_begun and k < steps:
                _carry_out_events(simulator)
                faulty.apply(context)  # values after the updates, for blocks that read between the ticks
                finite = finite and faulty.always_finite
            finite = finite and _has_finite_rates(system, context)
    if context is not own:
        own.SetTimeStateAndParametersFrom(context)
    units = _units(system, ports) | ({"energy": "J"} if energy else {})
    return Log(time, {name: np.array(rows) for name, rows in values.items()}, units)


@contextlib.contextmanager
def _in_words(now: Callable[[], float]) -> Iterator[None]:
    """Turn SystemExit, which a failed precondition in Drake raises, into `RunFailedError` with the time [s]."""
    try:
        yield
    except SystemExit as error:
        why = re.sub(r"Failure at \S+ in ", "", " ".join(str(error).split()))
        raise RunFailedError(f"the simulation stopped at t = {now():g} s: {why}") from error


def _simulator(system: System, context: Context, period: float, accuracy: float, *, begun: bool) -> Simulator:
    simulator = Simulator(system, context)
    config = SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=period, accuracy=accuracy, start_time=context.get_time()
    )
    ApplySimulatorConfig(config, simulator)  # it also sets the time, hence `start_time`
    # A context that has already run must not go through the initialisation events once more.
    simulator.Initialize(InitializeParams(suppress_initialization_events=begun))
    return simulator


def _has_finite_rates(system: System, context: Context) -> bool:
    return bool(np.isfinite(system.EvalTimeDerivatives(context).CopyToVector()).all())


def _carry_out_events(simulator: Simulator) -> None:
    """Carry out the events of this instant, without error control: with NaN its step of length zero would not end."""
    integrator = simulator.get_mutable_integrator()
    integrator.set_fixed_step_mode(True)
    simulator.AdvancePendingEvents()
    integrator.set_fixed_step_mode(False)


def _advance(simulator: Simulator, system: System, time: float, *, may_be_nan: bool) -> None:
    """Advance to `time` [s]; step by step if `may_be_nan`, where NaN may be inside.

    A step whose derivatives are NaN is taken without error control: Drake would reduce its length without end.
    """
    if not may_be_nan:
        simulator.AdvanceTo(time)
        return
    simulator.set_monitor(lambda context: EventStatus.ReachedTermination(system, "one step"))
    try:
        while simulator.get_context().get_time() < time:
            _carry_out_events(simulator)
            finite = _has_finite_rates(system, simulator.get_context())
            simulator.get_mutable_integrator().set_fixed_step_mode(not finite)
            simulator.AdvanceTo(time)
    finally:
        simulator.clear_monitor()


def _energy(blocks: Sequence[System], system: System, context: Context) -> float:
    """Energy of all blocks [J]; the energy that a diagram itself reports leaves its blocks out."""
    own = [(block, context_of(block, system, context)) for block in blocks]
    return float(sum(block.EvalKineticEnergy(each) + block.EvalPotentialEnergy(each) for block, each in own))


def _units(system: System, ports: Mapping[str, OutputPort]) -> dict[str, str]:
    """Units of the logged outputs, as the blocks they come from declare them."""
    wiring = Wiring(system)
    paths = {id(block): path for path, block in reversed(wiring.systems.items())}
    found = {}
    for name, port in ports.items():
        address = PortAddress("output", paths[id(port.get_system())], int(port.get_index()))
        source = wiring.source(address) or address
        found[name] = unit(wiring, address) or unit(wiring, source)
    return found


def vector_inputs(system: System) -> dict[str, InputPort]:
    """All vector inputs by name."""
    ports = (system.get_input_port(i, False) for i in range(system.num_input_ports()))
    return {port.get_name(): port for port in ports if is_vector(port)}


def vector_outputs(system: System, names: Sequence[str] | None, *, needed: bool = True) -> dict[str, OutputPort]:
    """The named vector outputs, of the system or of blocks inside, or all of the system.

    Args:
        system: any diagram or block.
        names: `port`, or `block.port`.
        needed: whether there must be one.

    Raises:
        BadInputError: no vector output has this name, or there is none at all.
    """
    ports = (system.get_output_port(i, False) for i in range(system.num_output_ports()))
    known = {port.get_name(): port for port in ports if is_vector(port)}
    if names is None and not known and needed:
        raise BadInputError(
            f"{own_name(system)} has no vector output to look at: export one, or name a block.port in `outputs`"
        )
    if names is None:
        return known
    wiring = Wiring(system) if any("." in name and name not in known for name in names) else None
    found = {}
    for name in names:
        if name in known:
            found[name] = known[name]
            continue
        inner = wiring.port(one_output(wiring, name)) if wiring and "." in name else None
        if inner is None or not is_vector(inner):
            raise unknown("vector output", name, known)
        found[name] = inner
    return found


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

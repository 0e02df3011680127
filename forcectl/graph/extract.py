"""From a Drake diagram to the plain values of `graph_model`."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    Context,
    Diagram,
    InputPort,
    InputPortIndex,
    OutputPort,
    OutputPortIndex,
    PortDataType,
    System,
)
from pydrake.systems.primitives import AffineSystem, Gain, Multiplexer, Saturation, VectorLogSink

from forcectl.conventions import unit_of
from forcectl.errors import BadInputError, invalid
from forcectl.graph.events import runs_every_step, sample_times
from forcectl.graph.model import Block, BlockGraph, Category, Edge, Endpoint, Parameter, Port

_AUTOMATIC = re.compile(r"@[0-9a-f]{6,}$")
_MOST_MATRIX_ELEMENTS = 64

_AnyPort: TypeAlias = InputPort | OutputPort


def block_graph(
    diagram: System,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    signals: bool = True,
    loggers: bool = False,
    context: Context | None = None,
) -> BlockGraph:
    """Read a diagram once; the result does not refer to it any more.

    Args:
        diagram: any Drake diagram, or a single leaf system.
        depth: levels of nested diagrams that are unfolded: 0 shows one box, 1 its blocks, None everything.
        hide_unused: leave out ports that nothing is connected to.
        signals: write size and unit on the wires.
        loggers: show blocks that only record a signal.
        context: of the diagram, for the values of parameters; the default context when None.

    Raises:
        BadInputError: when `diagram` is no Drake system or `depth` is negative.
    """
    if not isinstance(diagram, System):
        raise BadInputError(f"diagram = {diagram!r}: must be a Drake diagram or system that is built")
    if depth is not None and (isinstance(depth, bool) or not isinstance(depth, int) or depth < 0):
        raise invalid("depth", depth, "a whole number >= 0, or None for all levels")
    reader = _Reader(hide_unused, loggers, context or diagram.CreateDefaultContext())
    ports = {port.get_name() for port in (*_inputs(diagram), *_outputs(diagram))}
    return BlockGraph(reader.read(diagram, _root_name(diagram), "", ports), depth, signals)


class _Reader:
    """Walks down the diagrams; what a diagram's parent leaves unused is left out inside as well."""

    def __init__(self, hide_unused: bool, loggers: bool, context: Context) -> None:
        self._hide_unused = hide_unused
        self._loggers = loggers
        self._context = context

    def read(self, system: System, name: str, parent: str, used: set[str]) -> Block:
        path = f"{parent}::{name}" if parent else name
        inputs = [port for port in _inputs(system) if self._shows(port, used)]
        outputs = [port for port in _outputs(system) if self._shows(port, used)]
        blocks: tuple[Block, ...] = ()
        edges: tuple[Edge, ...] = ()
        if isinstance(system, Diagram):
            blocks, edges = self._inside(system, path, {port.get_name() for port in (*inputs, *outputs)})
        return Block(
            path=path,
            name=name,
            type_name=type_name(system),
            kind="diagram" if isinstance(system, Diagram) else "leaf",
            category=_category(system),
            inputs=tuple(_port(system, port, used) for port in inputs),
            outputs=tuple(_port(system, port, used) for port in outputs),
            automatic_name=_is_automatic(system.get_name()),
            samples=sample_times(system),
            every_step=runs_every_step(system),
            states=_states(system),
            parameters=_parameters(system, self._context),
            blocks=blocks,
            edges=edges,
        )

    def _shows(self, port: _AnyPort, used: set[str]) -> bool:
        return port.get_name() in used or not self._hide_unused

    def _inside(self, diagram: Diagram, path: str, terminals: set[str]) -> tuple[tuple[Block, ...], tuple[Edge, ...]]:
        systems = diagram.GetSystems()
        names = _unique_names(systems)
        hidden = set() if self._loggers else _recorders(diagram)
        shown = [(child, f"{path}::{name}") for child, name in zip(systems, names, strict=True)]
        shown = [(child, owner) for child, owner in shown if child.GetSystemPathname() not in hidden]
        # A system is found by its path name: two Python wrappers of one C++ system need not be one object.
        owners = {diagram.GetSystemPathname(): path}
        owners |= {child.GetSystemPathname(): owner for child, owner in shown}
        wires = [
            wire
            for wire in _wires(diagram, owners)
            if all(end.block != path or end.port in terminals for end in (wire.source, wire.target))
        ]
        used: dict[str, set[str]] = defaultdict(set)
        for wire in wires:
            used[wire.source.block].add(wire.source.port)
            used[wire.target.block].add(wire.target.port)
        for end in _recorded(diagram, owners, hidden):  # a signal that is only recorded keeps its port
            used[end.block].add(end.port)
        blocks = tuple(self.read(child, owner.removeprefix(f"{path}::"), path, used[owner]) for child, owner in shown)
        return blocks, tuple(wires)


def _recorded(diagram: Diagram, owners: dict[str, str], hidden: set[str]) -> list[Endpoint]:
    """Ports of shown systems that lead to a hidden logger."""
    return [
        _endpoint(source.get_output_port(index), owners)
        for (target, _), (source, index) in diagram.connection_map().items()
        if target.GetSystemPathname() in hidden and source.GetSystemPathname() in owners
    ]


def _recorders(diagram: Diagram) -> set[str]:
    """Path names of the loggers in a diagram, and of the multiplexers that only gather signals for them."""
    found = {child.GetSystemPathname() for child in diagram.GetSystems() if isinstance(child, VectorLogSink)}
    fed: dict[str, set[str]] = defaultdict(set)
    for (target, _), (source, _) in diagram.connection_map().items():
        fed[source.GetSystemPathname()].add(target.GetSystemPathname())
    leaving = {diagram.get_output_port_locator(OutputPortIndex(i))[0] for i in range(diagram.num_output_ports())}
    outside = {system.GetSystemPathname() for system in leaving}
    for child in diagram.GetSystems():
        name = child.GetSystemPathname()
        if isinstance(child, Multiplexer) and fed[name] and fed[name] <= found and name not in outside:
            found.add(name)
    return found


def _wires(diagram: Diagram, owners: dict[str, str]) -> list[Edge]:
    """The wires between the shown systems of one diagram, its own terminals included, in the order of their systems."""
    pairs: list[tuple[_AnyPort, _AnyPort]] = []
    for (target, target_index), (source, source_index) in diagram.connection_map().items():
        if target.GetSystemPathname() in owners and source.GetSystemPathname() in owners:
            pairs.append((source.get_output_port(source_index), target.get_input_port(target_index)))
    for i in range(diagram.num_input_ports()):
        for target, index in diagram.GetInputPortLocators(InputPortIndex(i)):
            if target.GetSystemPathname() in owners:
                pairs.append((diagram.get_input_port(i), target.get_input_port(index)))
    for i in range(diagram.num_output_ports()):
        source, index = diagram.get_output_port_locator(OutputPortIndex(i))
        if source.GetSystemPathname() in owners:
            pairs.append((source.get_output_port(index), diagram.get_output_port(i)))
    place = {pathname: number for number, pathname in enumerate(owners)}
    pairs.sort(
        key=lambda pair: [(place[port.get_system().GetSystemPathname()], int(port.get_index())) for port in pair]
    )
    units: dict[Endpoint, str] = {}
    for pair in pairs:  # a signal has the unit of its source, else the first unit that any of its targets knows
        end = _endpoint(pair[0], owners)
        units[end] = units.get(end) or _unit_of_port(pair[0]) or _unit_of_port(pair[1])
    return [_edge(source, target, units, owners) for source, target in pairs]


def _endpoint(port: _AnyPort, owners: dict[str, str]) -> Endpoint:
    return Endpoint(owners[port.get_system().GetSystemPathname()], port.get_name())


def _edge(source: _AnyPort, target: _AnyPort, units: dict[Endpoint, str], owners: dict[str, str]) -> Edge:
    start, end = _endpoint(source, owners), _endpoint(target, owners)
    plain = _port(source.get_system(), source, set())
    signal = Port(plain.name, plain.size, units[start], plain.abstract).signal
    return Edge(start, end, signal, plain.size, units[start])


def _unit_of_port(port: _AnyPort) -> str:
    return _unit(port.get_system(), port.get_name())


def _inputs(system: System) -> list[InputPort]:
    return [system.get_input_port(i) for i in range(system.num_input_ports())]


def _outputs(system: System) -> list[OutputPort]:
    return [system.get_output_port(i) for i in range(system.num_output_ports())]


def _port(system: System, port: _AnyPort, used: set[str]) -> Port:
    abstract = ""
    if port.get_data_type() == PortDataType.kAbstractValued:
        abstract = _value_type(port)
    feedthrough: tuple[str, ...] = ()
    if isinstance(port, OutputPort) and not isinstance(system, Diagram):
        feedthrough = tuple(
            name.get_name()
            for name in _inputs(system)
            if system.HasDirectFeedthrough(name.get_index(), port.get_index())
        )
    name = port.get_name()
    return Port(name, 0 if abstract else port.size(), _unit(system, name), abstract, name in used, feedthrough)


def _unit(system: System, port: str) -> str:
    return unit_of(port, getattr(system, "port_units", None))


def _value_type(port: _AnyPort) -> str:
    """Type held by an abstract port, as short as it can be told."""
    try:
        holder = port.Allocate()
    except RuntimeError:  # C++ types without a Python binding cannot be allocated from here
        return "abstract"
    value = type(holder).__name__
    inner = re.search(r"(?:\[|𝓣)(.*?)(?:\]|𝓤)*$", value)
    if inner is None:
        return "abstract"
    text = re.sub(r"(?:𝓣|\[).*", "", inner.group(1).rpartition(".")[2])
    return text if text and text != "object" else type(holder.get_value()).__name__


def type_name(system: System) -> str:
    """Class name without module, template arguments and scalar type."""
    name = type(system).__name__
    if name in ("LeafSystem", "System", "Diagram"):  # a C++ class without a Python binding
        name = system.GetSystemType().rpartition("::")[2]
    return re.split(r"[<\[𝓣]", name)[0].strip("_")


def _is_automatic(name: str) -> bool:
    return not name or name == "_" or bool(_AUTOMATIC.search(name))


def _root_name(diagram: System) -> str:
    name = diagram.get_name()
    return type_name(diagram) if _is_automatic(name) else name


def _unique_names(systems: Iterable[System]) -> list[str]:
    """Given names as they are; systems without one are called after their type, numbered when there are several."""
    systems = list(systems)
    plain = [type_name(system) if _is_automatic(system.get_name()) else system.get_name() for system in systems]
    total, seen = Counter(plain), Counter[str]()
    names = []
    for name in plain:
        seen[name] += 1
        names.append(name if total[name] == 1 else f"{name} {seen[name]}")
    return names


def _states(system: System) -> tuple[int, int, int]:
    if isinstance(system, Diagram):
        inside = [_states(child) for child in system.GetSystems()]
        return (sum(s[0] for s in inside), sum(s[1] for s in inside), sum(s[2] for s in inside))
    discrete = system.AllocateDiscreteVariables()
    groups = range(discrete.num_groups())
    return (
        system.num_continuous_states(),
        sum(discrete.get_vector(group).size() for group in groups),
        system.num_abstract_states(),
    )


def _category(system: System) -> Category:
    if isinstance(system, Diagram):
        return "nested"
    if isinstance(system, MultibodyPlant | SceneGraph):
        return "multibody"
    continuous, discrete, abstract = _states(system)
    sampled = discrete > 0 or abstract > 0 or bool(sample_times(system))
    if continuous > 0:
        return "hybrid" if sampled else "continuous"
    return "discrete" if sampled else "stateless"


def _parameters(system: System, root_context: Context) -> tuple[Parameter, ...]:
    """Numeric parameters from the context, and the matrices of linear blocks."""
    if isinstance(system, Diagram | MultibodyPlant | SceneGraph):
        return ()  # a plant's parameters are one group per body: no help in a picture
    found: list[Parameter] = []
    if isinstance(system, AffineSystem):
        matrices = {"A": system.A(), "B": system.B(), "C": system.C(), "D": system.D()}
        found = [
            Parameter(name, tuple(float(x) for x in np.ravel(matrix)))
            for name, matrix in matrices.items()
            if 0 < np.size(matrix) <= _MOST_MATRIX_ELEMENTS
        ]
    elif isinstance(system, Gain):
        found = [Parameter("gain", _response(system, 1.0))]
    elif isinstance(system, Saturation):
        found = [
            Parameter("lower limit", _response(system, -np.inf)),
            Parameter("upper limit", _response(system, np.inf)),
        ]
    count = system.num_numeric_parameter_groups()
    if count:
        context = system.GetMyContextFromRoot(root_context)
        names = _parameter_names(system, count)
        for index, name in enumerate(names):
            found.append(Parameter(name, tuple(float(x) for x in context.get_numeric_parameter(index).value())))
    return tuple(found)


def _response(system: System, value: float) -> tuple[float, ...]:
    """Output of a stateless C++ block for a constant input; tells what the block has no accessor for."""
    context = system.CreateDefaultContext()
    port = system.get_input_port(0)
    port.FixValue(context, np.full(port.size(), value))
    return tuple(float(x) for x in system.get_output_port(0).Eval(context))


def _parameter_names(system: System, count: int) -> list[str]:
    """Names from the port block of the class documentation (`parameters: [a, b]`), else numbers."""
    stated = re.search(r"^\s*parameters:\s*\[(.*?)\]", type(system).__doc__ or "", re.MULTILINE | re.DOTALL)
    names = [name.strip() for name in stated.group(1).split(",")] if stated else []
    if len(names) == count:
        return names
    return ["value"] if count == 1 else [f"parameter {index}" for index in range(count)]

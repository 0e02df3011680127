"""From a Drake diagram to the plain values of `graph.model`, read by `forcectl.inspect`."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, Diagram, System
from pydrake.systems.primitives import AffineSystem, Gain, Multiplexer, Saturation, VectorLogSink

from forcectl.framework.wiring import input_names
from forcectl.graph.model import Block, Category, Edge, Endpoint, Parameter, Port
from forcectl.inspect.events import PeriodicEvent, read_timing
from forcectl.inspect.names import is_automatic, type_name
from forcectl.inspect.ports import unit, value_type
from forcectl.inspect.start import StartValues, is_library_plant
from forcectl.inspect.wiring import DiagramLevel, PortAddress, Side, Wiring

_MOST_MATRIX_ELEMENTS = 64

_End: TypeAlias = tuple[Side, PortAddress]


def read_blocks(diagram: System, context: Context, hide_unused: bool, loggers: bool) -> Block:
    """A diagram, or a single leaf system, with everything inside of it; the arguments are those of `export.graph`."""
    wiring = Wiring(diagram)
    top = "" if isinstance(diagram, Diagram) else next(path for path, _ in wiring.leaves())
    return _Reader(wiring, hide_unused, loggers, context).read(top, set(_ends(wiring, top)))


class _Reader:
    """Walks down the diagrams; what a diagram's parent leaves unused is left out inside as well."""

    def __init__(self, wiring: Wiring, hide_unused: bool, loggers: bool, context: Context) -> None:
        self._wiring = wiring
        self._hide_unused = hide_unused
        self._loggers = loggers
        self._context = context
        timing = read_timing(StartValues(wiring))
        self._every_step = timing.every_step
        self._samples: dict[str, list[PeriodicEvent]] = defaultdict(list)
        for event in timing.events:
            self._samples[event.block].append(event)

    def read(self, path: str, used: set[_End]) -> Block:
        system = self._wiring.systems[path]
        ends = [end for end in _ends(self._wiring, path) if end in used or not self._hide_unused]
        blocks: tuple[Block, ...] = ()
        edges: tuple[Edge, ...] = ()
        if isinstance(system, Diagram):
            blocks, edges = self._inside(path, set(ends))
        samples = tuple(sorted(self._samples[path], key=lambda event: (event.period, event.offset)))
        return Block(
            path=path,
            name=self._wiring.names[path],
            type_name=type_name(system),
            kind="diagram" if isinstance(system, Diagram) else "leaf",
            category=_category(system, bool(samples)),
            inputs=tuple(self._port(end, used) for end in ends if end[0] == "input"),
            outputs=tuple(self._port(end, used) for end in ends if end[0] == "output"),
            automatic_name=is_automatic(system.get_name()),
            samples=samples,
            every_step=path in self._every_step,
            states=_states(system),
            parameters=_parameters(system, self._context),
            blocks=blocks,
            edges=edges,
        )

    def _inside(self, path: str, terminals: set[_End]) -> tuple[tuple[Block, ...], tuple[Edge, ...]]:
        level = self._wiring.inside(path)
        if level is None:
            return (), ()
        hidden = set() if self._loggers else _recorders(self._wiring, level)
        place = {owner: number for number, owner in enumerate([path, *level.children])}
        wires = sorted(
            (
                wire
                for wire in level.wires()
                if all(port.system != path or (side, port) in terminals for side, port in wire)
            ),
            key=lambda wire: [(place[port.system], port.index) for _, port in wire],
        )
        shown = [wire for wire in wires if not any(port.system in hidden for _, port in wire)]
        used = {end for wire in shown for end in wire}
        # A signal that is only recorded keeps its port.
        used |= {source for source, reader in wires if reader[1].system in hidden and source[1].system not in hidden}
        blocks = tuple(self.read(child, used) for child in level.children if child not in hidden)
        return blocks, self._edges(shown)

    def _edges(self, wires: list[tuple[_End, _End]]) -> tuple[Edge, ...]:
        units: dict[_End, str] = {}
        for source, target in wires:  # a signal has the unit of its source, else the first that any of its targets has
            units[source] = units.get(source) or unit(self._wiring, *source) or unit(self._wiring, *target)
        edges = []
        for source, target in wires:
            port = replace(self._port(source, set()), unit=units[source])
            start, end = (Endpoint(p.system, self._wiring.port(side, p).get_name()) for side, p in (source, target))
            edges.append(Edge(start, end, port.signal, port.size))
        return tuple(edges)

    def _port(self, end: _End, used: set[_End]) -> Port:
        side, port = end
        system, drake_port = self._wiring.systems[port.system], self._wiring.port(*end)
        abstract = value_type(drake_port)
        feedthrough: tuple[str, ...] = ()
        if side == "output" and not isinstance(system, Diagram):
            pairs, inputs = sorted(self._wiring.feedthrough(port.system)), input_names(system)
            feedthrough = tuple(inputs[i] for i, o in pairs if o == port.index)
        size = 0 if abstract else drake_port.size()
        return Port(drake_port.get_name(), size, unit(self._wiring, *end), abstract, end in used, feedthrough)


def _ends(wiring: Wiring, path: str) -> list[_End]:
    """All ports of a system, inputs first."""
    system = wiring.systems[path]
    inputs: list[_End] = [("input", PortAddress(path, i)) for i in range(system.num_input_ports())]
    return [*inputs, *(("output", PortAddress(path, i)) for i in range(system.num_output_ports()))]


def _recorders(wiring: Wiring, level: DiagramLevel) -> set[str]:
    """Paths of the loggers in a diagram, and of the multiplexers that only gather signals for them."""
    found = {child for child in level.children if isinstance(wiring.systems[child], VectorLogSink)}
    fed: dict[str, set[str]] = defaultdict(set)
    for reader, source in level.connections.items():
        fed[source.system].add(reader.system)
    outside = {source.system for source in level.exported_outputs.values()}
    gather = {
        child
        for child in level.children
        if isinstance(wiring.systems[child], Multiplexer) and fed[child] and fed[child] <= found
    }
    return found | (gather - outside)


def _states(system: System) -> tuple[int, int, int]:
    discrete = system.AllocateDiscreteVariables()
    size = sum(discrete.get_vector(group).size() for group in range(discrete.num_groups()))
    return system.num_continuous_states(), size, system.num_abstract_states()


def _category(system: System, has_events: bool) -> Category:
    if isinstance(system, Diagram):
        return "nested"
    if is_library_plant(system):
        return "multibody"
    continuous, discrete, abstract = _states(system)
    sampled = discrete > 0 or abstract > 0 or has_events
    if continuous > 0:
        return "hybrid" if sampled else "continuous"
    return "discrete" if sampled else "stateless"


def _parameters(system: System, root_context: Context) -> tuple[Parameter, ...]:
    """Numeric parameters from the context, and the matrices of linear blocks."""
    if isinstance(system, Diagram) or is_library_plant(system):
        return ()  # a plant's parameters are one group per body: no help in a picture
    found: list[tuple[str, ArrayLike]] = []
    if isinstance(system, AffineSystem):
        matrices = {"A": system.A(), "B": system.B(), "C": system.C(), "D": system.D()}
        found += [(name, m) for name, m in matrices.items() if 0 < np.size(m) <= _MOST_MATRIX_ELEMENTS]
    elif isinstance(system, Gain):
        found.append(("gain", _response(system, 1.0)))
    elif isinstance(system, Saturation):
        found += [("lower limit", _response(system, -np.inf)), ("upper limit", _response(system, np.inf))]
    if count := system.num_numeric_parameter_groups():
        context = system.GetMyContextFromRoot(root_context)
        for index, name in enumerate(_parameter_names(system, count)):
            found.append((name, context.get_numeric_parameter(index).value()))
    return tuple(Parameter(name, tuple(map(float, np.ravel(values)))) for name, values in found)


def _response(system: System, value: float) -> ArrayLike:
    """Output of a stateless C++ block for a constant input; tells what the block has no accessor for."""
    context = system.CreateDefaultContext()
    port = system.get_input_port(0)
    port.FixValue(context, np.full(port.size(), value))
    response: ArrayLike = system.get_output_port(0).Eval(context)
    return response


def _parameter_names(system: System, count: int) -> list[str]:
    """Names from the port block of the class documentation (`parameters: [a, b]`), else numbers."""
    stated = re.search(r"^\s*parameters:\s*\[(.*?)\]", type(system).__doc__ or "", re.MULTILINE | re.DOTALL)
    names = [name.strip() for name in stated.group(1).split(",")] if stated else []
    if len(names) == count:
        return names
    return ["value"] if count == 1 else [f"parameter {index}" for index in range(count)]

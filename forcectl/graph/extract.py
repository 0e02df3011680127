"""From a Drake diagram to the plain values of `graph.model`, read by `forcectl.inspect`."""

from __future__ import annotations

import inspect
import itertools
import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, Diagram, System
from pydrake.systems.primitives import AffineSystem, Gain, Multiplexer, Saturation, VectorLogSink

from forcectl.graph.model import Block, Category, Edge, Endpoint, Parameter, Port
from forcectl.inspect.events import PeriodicEvent, read_timing
from forcectl.inspect.names import type_name
from forcectl.inspect.ports import unit, value_type
from forcectl.inspect.start import StartValues, is_library_plant
from forcectl.inspect.wiring import DiagramLevel, PortAddress, Wiring, context_of, is_python_block

_MOST_MATRIX_ELEMENTS = 64


def read_blocks(diagram: System, context: Context, hide_unused: bool, loggers: bool) -> Block:
    """A diagram, or a single leaf system, with everything inside of it; the arguments are those of `export.graph`."""
    wiring = Wiring(diagram)
    top = "" if isinstance(diagram, Diagram) else next(path for path, _ in wiring.leaves())
    used = {*wiring.inputs(top), *wiring.outputs(top)}
    return _Reader(wiring, hide_unused, loggers, context).read(top, used)


class _Reader:
    """Reads a diagram level by level; ports that its parent leaves unused are left out inside, too."""

    def __init__(self, wiring: Wiring, hide_unused: bool, loggers: bool, context: Context) -> None:
        self._wiring = wiring
        self._hide_unused = hide_unused
        self._loggers = loggers
        self._context = context
        timing = read_timing(StartValues(wiring))
        self._logged: set[PortAddress] = set()
        self._every_step = timing.every_step
        self._samples: dict[str, list[PeriodicEvent]] = defaultdict(list)
        for event in timing.events:
            self._samples[event.block].append(event)

    def read(self, path: str, used: set[PortAddress]) -> Block:
        system = self._wiring.systems[path]
        inputs, outputs = (
            [port for port in ports if port in used or not self._hide_unused]
            for ports in (self._wiring.inputs(path), self._wiring.outputs(path))
        )
        if not outputs and not isinstance(system, Diagram):  # an unused block keeps its ports
            outputs = self._wiring.outputs(path)
        blocks: tuple[Block, ...] = ()
        edges: tuple[Edge, ...] = ()
        if isinstance(system, Diagram):
            blocks, edges = self._inside(path, {*inputs, *outputs})
        samples = tuple(sorted(self._samples[path], key=lambda event: (event.period, event.offset)))
        return Block(
            path=path,
            name=self._wiring.names[path],
            type_name=type_name(system),
            kind="diagram" if isinstance(system, Diagram) else "leaf",
            category=_category(system, bool(samples)),
            inputs=tuple(self._port(port, used) for port in inputs),
            outputs=tuple(replace(self._port(port, used), logged=port in self._logged) for port in outputs),
            samples=samples,
            every_step=path in self._every_step,
            states=_states(system),
            parameters=_parameters(system, context_of(system, self._wiring.root, self._context)),
            about=_about(system),
            beside=getattr(type(system), "REFRESHED", ""),
            blocks=blocks,
            edges=edges,
        )

    def _inside(self, path: str, terminals: set[PortAddress]) -> tuple[tuple[Block, ...], tuple[Edge, ...]]:
        level = self._wiring.levels[path]
        hidden = set() if self._loggers else _recorders(self._wiring, level)
        place = {owner: number for number, owner in enumerate([path, *level.children])}
        wires = sorted(
            (
                (source, reader)
                for reader, source in level.sources.items()
                if all(port.system != path or port in terminals for port in (source, reader))
            ),
            key=lambda wire: [(place[port.system], port.index) for port in wire],
        )
        shown = [wire for wire in wires if not any(port.system in hidden for port in wire)]
        used = {port for wire in shown for port in wire}
        # An output that is only logged keeps its port.
        used |= {source for source, reader in wires if reader.system in hidden and source.system not in hidden}
        wired = {source for source, _ in shown}
        self._logged |= {source for source in used if source.side == "output" and source not in wired} - {
            port for port in used if port.system == path
        }
        blocks = tuple(self.read(child, used) for child in level.children if child not in hidden)
        return blocks, self._edges(shown)

    def _edges(self, wires: list[tuple[PortAddress, PortAddress]]) -> tuple[Edge, ...]:
        units: dict[PortAddress, str] = {}
        for source, target in wires:  # the unit of a signal is that of its source, or else of its first target with one
            units[source] = units.get(source) or unit(self._wiring, source) or unit(self._wiring, target)
        edges = []
        for source, target in wires:
            port = replace(self._port(source, set()), unit=units[source])
            start, end = (Endpoint(p.system, self._wiring.port(p).get_name()) for p in (source, target))
            edges.append(Edge(start, end, port.signal, port.size))
        return tuple(edges)

    def _port(self, address: PortAddress, used: set[PortAddress]) -> Port:
        port = self._wiring.port(address)
        abstract = value_type(port)
        feedthrough: tuple[str, ...] = ()
        if address.side == "output" and address.system not in self._wiring.levels:
            feedthrough = tuple(self._wiring.port(passed).get_name() for passed in self._wiring.passed(address))
        size = 0 if abstract else port.size()
        return Port(port.get_name(), size, unit(self._wiring, address), abstract, address in used, feedthrough)


def _recorders(wiring: Wiring, level: DiagramLevel) -> set[str]:
    """Paths of the loggers in a diagram, and of the multiplexers that feed only loggers."""
    found = {child for child in level.children if isinstance(wiring.systems[child], VectorLogSink)}
    fed: dict[str, set[str]] = defaultdict(set)
    for reader, source in level.sources.items():
        fed[source.system].add(reader.system)
    multiplexers = (child for child in level.children if isinstance(wiring.systems[child], Multiplexer))
    return found | {child for child in multiplexers if fed[child] and fed[child] <= found}


def _about(system: System) -> tuple[str, ...]:
    """First sentence of a Python block's documentation, and its equation."""
    if not is_python_block(system):
        return ()
    kind = type(system)
    documentation = inspect.getdoc(kind) or ""
    first = " ".join(itertools.takewhile(str.strip, documentation.splitlines()))
    sentence = re.split(r"(?<=[.:])\s", first, maxsplit=1)[0].rstrip(":").strip()
    equation = _equation(documentation) or _equation(inspect.getdoc(inspect.getmodule(kind)) or "")
    return tuple(text for text in (sentence, *equation) if text)


def _equation(documentation: str) -> list[str]:
    """The indented lines after the first `::`, at most four."""
    lines = documentation.splitlines()
    start = next((number for number, line in enumerate(lines, start=1) if line.endswith("::")), len(lines))
    behind = itertools.dropwhile(lambda line: not line.strip(), lines[start:])
    return [line.strip() for line in itertools.takewhile(lambda line: line.startswith(" "), behind)][:4]


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


def _parameters(system: System, context: Context) -> tuple[Parameter, ...]:
    """Numeric parameters from the context, and the matrices of linear blocks."""
    if isinstance(system, Diagram) or is_library_plant(system):
        return ()  # a plant has one group of parameters per body: too many for a picture
    found: list[tuple[str, ArrayLike]] = []
    if isinstance(system, AffineSystem):
        matrices = {"A": system.A(), "B": system.B(), "C": system.C(), "D": system.D()}
        found += [(name, m) for name, m in matrices.items() if 0 < np.size(m) <= _MOST_MATRIX_ELEMENTS]
    elif isinstance(system, Gain):
        found.append(("gain", _response(system, 1.0)))
    elif isinstance(system, Saturation):
        found += [("lower limit", _response(system, -np.inf)), ("upper limit", _response(system, np.inf))]
    if count := system.num_numeric_parameter_groups():
        for index, name in enumerate(_parameter_names(system, count)):
            found.append((name, context.get_numeric_parameter(index).value()))
    return tuple(
        Parameter(name, tuple(map(float, np.ravel(values))), _parameter_unit(system, name)) for name, values in found
    )


def _response(system: System, value: float) -> ArrayLike:
    """Output of a stateless C++ block for a constant input, for values that the block has no accessor for."""
    context = system.CreateDefaultContext()
    port = system.get_input_port(0)
    port.FixValue(context, np.full(port.size(), value))
    return system.get_output_port(0).Eval(context)


def _parameter_names(system: System, count: int) -> list[str]:
    """Parameter names from the block's attribute, else from its documentation (`parameters: [a, b]`), else numbers."""
    stated = re.search(r"^\s*parameters:\s*\[(.*?)\]", type(system).__doc__ or "", re.MULTILINE | re.DOTALL)
    documented = [name.strip().removesuffix(" (optional)") for name in stated.group(1).split(",")] if stated else []
    for names in (list(getattr(system, "parameter_names", ())), documented):
        if len(names) == count:
            return names
    return ["value"] if count == 1 else [f"parameter {index}" for index in range(count)]


def _parameter_unit(system: System, name: str) -> str:
    """Unit from the block's attribute, else the first in brackets after the name in its docstring; "" for a ratio."""
    if not (unit := getattr(system, "parameter_units", {}).get(name, "")) and is_python_block(system):
        documentation = " ".join((inspect.getdoc(type(system)) or "").split())
        stated = re.search(rf"\b{re.escape(name)}\b[^\[\].;]*\[((?:1/)?[^\W\d_][^\[\]]*)\]", documentation)
        unit = stated[1] if stated else ""
    return "" if unit in ("1", "-") else unit

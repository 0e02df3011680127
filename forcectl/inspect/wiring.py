"""The wiring of a diagram: connections at each level, and between leaf blocks.

The path of the whole diagram is "", so `PortAddress("input", "", i)` is one of its own inputs. Nested systems have
paths such as "station/sensor". A single block has the path "" and also its name as a path.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    InputPortIndex,
    OutputPort,
    OutputPortIndex,
    PortDataType,
    System,
)

from forcectl.inspect.names import block_names, own_name

Side = Literal["input", "output"]


@dataclass(frozen=True)
class PortAddress:
    """A port by its side, the path of its system and its index."""

    side: Side
    system: str
    index: int


@dataclass(frozen=True)
class DiagramLevel:
    """The inside of one diagram.

    Attributes:
        path: path of the diagram.
        children: paths of its blocks.
        sources: source of each input of a block and of each output of the diagram. A source is an output of a block or
            an input of the diagram.
    """

    path: str
    children: tuple[str, ...]
    sources: dict[PortAddress, PortAddress]


class Wiring:
    """All systems of a diagram by path, and the wires between their ports.

    Attributes:
        systems: systems by path; "" is the whole diagram (missing for a builder).
        names: name of each block within its diagram: the last part of its path.
        levels: the inside of every diagram by its path, the outermost first.
        sources: source of each port, outside of its system for an input, inside of it for an output; at all levels.
        root: the whole diagram, None for a builder.
    """

    def __init__(self, root: System | DiagramBuilder):
        self.systems: dict[str, System] = {}
        self.names: dict[str, str] = {}
        self.levels: dict[str, DiagramLevel] = {}
        self.root: System | None = None
        if isinstance(root, DiagramBuilder):
            self._add_builder(root)
        else:
            self.root = root
            self.systems[""], self.names[""] = root, own_name(root)
            if isinstance(root, Diagram):
                self._add_diagram("", root)
            else:
                self._add_single(root)
        self.sources = {reader: source for level in self.levels.values() for reader, source in level.sources.items()}
        self._fed: dict[PortAddress, list[PortAddress]] = defaultdict(list)
        for reader, source in self.sources.items():
            self._fed[source].append(reader)
        self._parent = {child: path for path, level in self.levels.items() for child in level.children}
        self._passed: dict[PortAddress, list[PortAddress]] = {}

    def _children(self, path: str, systems: list[System]) -> dict[str, str]:
        """Register the systems of one level; returns path by Drake's own name, which is unique within a level."""
        children: dict[str, str] = {}
        for system, name in zip(systems, block_names(systems), strict=True):
            plain = f"{path}/{name}" if path else name
            # A block with a slash in its name could have the same path as a nested block.
            numbered = (f"{plain} {number}" for number in itertools.count(2))
            child = next(name for name in itertools.chain([plain], numbered) if name not in self.systems)
            children[system.get_name()] = child
            self.systems[child], self.names[child] = system, name
        return children

    def _add_level(self, path: str, children: dict[str, str], sources: dict[PortAddress, PortAddress]) -> None:
        self.levels[path] = DiagramLevel(path, tuple(children.values()), sources)
        for child in children.values():
            if isinstance(self.systems[child], Diagram):
                self._add_diagram(child, self.systems[child])

    @staticmethod
    def _connections(of: Diagram | DiagramBuilder, children: dict[str, str]) -> dict[PortAddress, PortAddress]:
        def port(side: Side, locator: tuple[System, Any]) -> PortAddress:
            return PortAddress(side, children[locator[0].get_name()], int(locator[1]))

        return {port("input", reader): port("output", source) for reader, source in of.connection_map().items()}

    def _add_diagram(self, path: str, diagram: Diagram) -> None:
        children = self._children(path, diagram.GetSystems())
        sources = self._connections(diagram, children)
        for port in self.inputs(path):
            for inner, index in diagram.GetInputPortLocators(InputPortIndex(port.index)):
                sources[PortAddress("input", children[inner.get_name()], int(index))] = port
        for port in self.outputs(path):
            inner, index = diagram.get_output_port_locator(OutputPortIndex(port.index))
            sources[port] = PortAddress("output", children[inner.get_name()], int(index))
        self._add_level(path, children, sources)

    def _add_builder(self, builder: DiagramBuilder) -> None:
        children = self._children("", builder.GetSystems())
        sources = self._connections(builder, children)
        # A builder does not tell as which of its inputs a port is exported, only that it is.
        inputs = (port for child in children.values() for port in self.inputs(child) if port not in sources)
        exported = [port for port in inputs if builder.IsConnectedOrExported(self.port(port))]
        sources |= {port: PortAddress("input", "", number) for number, port in enumerate(exported)}
        self._add_level("", children, sources)

    def _add_single(self, system: System) -> None:
        children = self._children("", [system])
        (child,) = children.values()
        sources = dict(zip(self.inputs(child), self.inputs(""), strict=True))
        self._add_level("", children, sources | dict(zip(self.outputs(""), self.outputs(child), strict=True)))

    def parents(self, path: str) -> list[str]:
        """The nested diagrams around a block, the outermost first."""
        above: list[str] = []
        while path and (path := self._parent[path]):
            above.insert(0, path)
        return above

    def leaves(self) -> Iterator[tuple[str, System]]:
        """Every block that is not itself a diagram, with its path."""
        for path, system in self.systems.items():
            if path and path not in self.levels:
                yield path, system

    def inputs(self, path: str) -> list[PortAddress]:
        """The input ports of a system."""
        return [PortAddress("input", path, i) for i in range(self.systems[path].num_input_ports())]

    def outputs(self, path: str) -> list[PortAddress]:
        """The output ports of a system."""
        return [PortAddress("output", path, i) for i in range(self.systems[path].num_output_ports())]

    def port(self, port: PortAddress) -> InputPort | OutputPort:
        """The Drake port at this address."""
        system = self.systems[port.system]
        # The second argument suppresses Drake's warning for deprecated ports.
        return (system.get_input_port if port.side == "input" else system.get_output_port)(port.index, False)

    def name(self, port: PortAddress) -> str:
        """Full name of a port, such as `station/sensor.measured_force`."""
        if port.system not in self.systems:
            return f"input {port.index}"  # an exported port of a builder has no name yet
        name = self.port(port).get_name()
        return f"{port.system}.{name}" if port.system else name

    def shown_name(self, output: PortAddress) -> str:
        """The name under which the outermost diagram exports a leaf output, such as `station.measured_force`; the name
        of the leaf output itself where no diagram does.
        """
        while exported := [port for port in self._fed.get(output, ()) if port.side == "output"]:
            output = exported[0]
        return self.name(output)

    def source(self, port: PortAddress) -> PortAddress | None:
        """The source of a port's value: a leaf output, an input of the whole diagram, or None if unconnected."""
        while port in self.sources:
            port = self.sources[port]
        return port if port.side == "output" or not port.system else None

    def inner_inputs(self, reader: PortAddress) -> Iterator[PortAddress]:
        """The leaf inputs that an input port of a diagram leads to; a leaf input leads to itself."""
        if reader.system not in self.levels:
            yield reader
        else:
            for inner in self._fed.get(reader, ()):
                yield from self.inner_inputs(inner)

    def fed_inputs(self, output: PortAddress) -> Iterator[PortAddress]:
        """The leaf inputs that read an output port of a block or of a diagram, directly or through exported ports."""
        for reader in self._fed.get(output, ()):
            yield from self.fed_inputs(reader) if reader.side == "output" else self.inner_inputs(reader)

    def is_read(self, output: PortAddress) -> bool:
        """Whether an output of a block is connected to another block, or exported from the diagram around it."""
        return bool(self._fed.get(output))

    def leaf_inputs(self) -> Iterator[PortAddress]:
        """Every input port of every leaf block."""
        for path, _ in self.leaves():
            yield from self.inputs(path)

    def readers(self) -> dict[PortAddress, list[PortAddress]]:
        """The leaf inputs fed by each leaf output and by each input of the whole diagram."""
        readers: dict[PortAddress, list[PortAddress]] = {}
        for reader in self.leaf_inputs():
            if (source := self.source(reader)) is not None:
                readers.setdefault(source, []).append(reader)
        return readers

    def feedthrough(self, path: str) -> frozenset[tuple[int, int]]:
        """Pairs (input, output) of a block with direct feedthrough, by index."""
        return frozenset((port.index, output.index) for output in self.outputs(path) for port in self.passed(output))

    def passed(self, output: PortAddress) -> list[PortAddress]:
        """The inputs of its block on which an output depends by direct feedthrough."""
        if output not in self._passed:  # cached, as Drake allocates a context for every query
            system, inputs = self.systems[output.system], self.inputs(output.system)
            if not inputs or not system.HasDirectFeedthrough(output.index):
                inputs = []
            elif len(inputs) > 1:
                inputs = [port for port in inputs if system.HasDirectFeedthrough(port.index, output.index)]
            self._passed[output] = inputs
        return self._passed[output]


def context_of(block: System, root: System, context: Context) -> Context:
    """The subcontext of a block in the context of `root`, which may itself be part of another diagram."""
    return context if block is root else root.GetSubsystemContext(block, context)


def is_vector(port: InputPort | OutputPort) -> bool:
    """Whether the port carries a vector of numbers."""
    return bool(port.get_data_type() == PortDataType.kVectorValued)


def is_python_block(system: System) -> bool:
    """Whether the block was written in Python (Drake's own classes live in modules called pydrake...)."""
    return not type(system).__module__.startswith("pydrake")

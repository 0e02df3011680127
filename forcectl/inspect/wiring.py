"""The wiring of a diagram: who feeds whom, level by level and between leaf blocks.

A port is addressed by the path of its system and its index. The path of the whole diagram is "", so `Port("", i)` is
one of its own ports; nested systems are called "station/sensor". A single block has the path of its name as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from pydrake.systems.framework import (
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
    """An input or output port; which of the two follows from where it stands."""

    system: str
    index: int


@dataclass(frozen=True)
class DiagramLevel:
    """The inside of one diagram: its blocks and the wires between them."""

    path: str
    children: tuple[str, ...]
    connections: dict[PortAddress, PortAddress] = field(default_factory=dict)  # input -> output
    exported_inputs: dict[PortAddress, int] = field(default_factory=dict)  # inner input -> index at the diagram
    exported_outputs: dict[int, PortAddress] = field(default_factory=dict)  # index at the diagram -> inner output

    def wires(self) -> Iterator[tuple[tuple[Side, PortAddress], tuple[Side, PortAddress]]]:
        """Every pair of ports that stand for the same signal at this level, the source first."""
        for reader, source in self.connections.items():
            yield ("output", source), ("input", reader)
        for inner, index in self.exported_inputs.items():
            yield ("input", PortAddress(self.path, index)), ("input", inner)
        for index, inner in self.exported_outputs.items():
            yield ("output", inner), ("output", PortAddress(self.path, index))


class Wiring:
    """All systems of a diagram by path, and the wires between their ports.

    Attributes:
        systems: by path; "" is the whole diagram (missing for a builder).
        names: the last part of each path, as a block is called within its diagram.
        levels: the inside of every diagram, the outermost first.
        root: the whole diagram, None for a builder.
    """

    def __init__(self, root: System | DiagramBuilder):
        self.systems: dict[str, System] = {}
        self.names: dict[str, str] = {}
        self.levels: list[DiagramLevel] = []
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
        self._parent = {child: level for level in self.levels for child in level.children}
        self._inside = {level.path: level for level in self.levels}
        self._feedthrough: dict[str, frozenset[tuple[int, int]]] = {}

    def _children(self, path: str, systems: list[System]) -> dict[str, str]:
        """Register the systems of one level; returns path by Drake's own name, which is unique within a level."""
        children: dict[str, str] = {}
        for system, name in zip(systems, block_names(systems), strict=True):
            plain = f"{path}/{name}" if path else name
            # A block whose name has a slash in it could have the path of a nested one.
            numbered = (f"{plain} {number}" for number in itertools.count(2))
            child = next(name for name in itertools.chain([plain], numbered) if name not in self.systems)
            children[system.get_name()] = child
            self.systems[child], self.names[child] = system, name
        return children

    def _descend(self, children: dict[str, str]) -> None:
        for child in children.values():
            system = self.systems[child]
            if isinstance(system, Diagram):
                self._add_diagram(child, system)

    @staticmethod
    def _connections(of: Diagram | DiagramBuilder, children: dict[str, str]) -> dict[PortAddress, PortAddress]:
        def port(locator: tuple[System, Any]) -> PortAddress:
            return PortAddress(children[locator[0].get_name()], int(locator[1]))

        return {port(reader): port(source) for reader, source in of.connection_map().items()}

    def _add_diagram(self, path: str, diagram: Diagram) -> None:
        children = self._children(path, diagram.GetSystems())
        inputs = {
            PortAddress(children[inner.get_name()], int(index)): i
            for i in range(diagram.num_input_ports())
            for inner, index in diagram.GetInputPortLocators(InputPortIndex(i))
        }
        outputs: dict[int, PortAddress] = {}
        for i in range(diagram.num_output_ports()):
            inner, index = diagram.get_output_port_locator(OutputPortIndex(i))
            outputs[i] = PortAddress(children[inner.get_name()], int(index))
        connections = self._connections(diagram, children)
        self.levels.append(DiagramLevel(path, tuple(children.values()), connections, inputs, outputs))
        self._descend(children)

    def _add_builder(self, builder: DiagramBuilder) -> None:
        children = self._children("", builder.GetSystems())
        connections = self._connections(builder, children)
        # A builder does not tell which of its inputs an exported port became, only that it was exported.
        exported: dict[PortAddress, int] = {}
        for child in children.values():
            for i in range(self.systems[child].num_input_ports()):
                inner = PortAddress(child, i)
                if inner not in connections and builder.IsConnectedOrExported(self.input_port(inner)):
                    exported[inner] = len(exported)
        self.levels.append(DiagramLevel("", tuple(children.values()), connections, exported))
        self._descend(children)

    def _add_single(self, system: System) -> None:
        (child,) = self._children("", [system]).values()
        inputs = {PortAddress(child, i): i for i in range(system.num_input_ports())}
        outputs = {i: PortAddress(child, i) for i in range(system.num_output_ports())}
        self.levels.append(DiagramLevel("", (child,), {}, inputs, outputs))

    def inside(self, path: str) -> DiagramLevel | None:
        """The inside of a diagram, None for a leaf block."""
        return self._inside.get(path)

    def parents(self, path: str) -> list[str]:
        """The nested diagrams around a block, the outermost first."""
        above: list[str] = []
        while path and (path := self._parent[path].path):
            above.insert(0, path)
        return above

    def depth(self, path: str) -> int:
        """How deep a system is nested: 0 for the whole diagram, 1 for its blocks."""
        return len(self.parents(path)) + bool(path)

    def leaves(self) -> Iterator[tuple[str, System]]:
        """Every block that is not itself a diagram, with its path."""
        for path, system in self.systems.items():
            if path and path not in self._inside:
                yield path, system

    def input_port(self, port: PortAddress) -> InputPort:
        """The Drake input port at this address."""
        # With the extra argument Drake does not print a warning for ports on their way out.
        return self.systems[port.system].get_input_port(port.index, False)

    def output_port(self, port: PortAddress) -> OutputPort:
        """The Drake output port at this address."""
        return self.systems[port.system].get_output_port(port.index, False)

    def port(self, side: Side, port: PortAddress) -> InputPort | OutputPort:
        """The Drake port at this address."""
        return self.input_port(port) if side == "input" else self.output_port(port)

    def input_name(self, port: PortAddress) -> str:
        """`station/controller.measured_force`."""
        if port.system not in self.systems:
            return f"input {port.index}"  # an exported port of a builder has no name yet
        return self._name(port, self.input_port(port).get_name())

    def output_name(self, port: PortAddress) -> str:
        """`station/sensor.measured_force`."""
        return self._name(port, self.output_port(port).get_name())

    @staticmethod
    def _name(port: PortAddress, name: str) -> str:
        return f"{port.system}.{name}" if port.system else name

    def origin(self, output: PortAddress) -> PortAddress:
        """The leaf output that a (possibly nested and exported) output port shows."""
        while output.system in self._inside:
            output = self._inside[output.system].exported_outputs[output.index]
        return output

    def shown_name(self, output: PortAddress) -> str:
        """The name under which a leaf output leaves the outermost nested diagram: `station.measured_force`."""
        while True:
            level = self._parent[output.system]
            exported = [i for i, inner in level.exported_outputs.items() if inner == output]
            if not exported or not level.path:
                break
            output = PortAddress(level.path, exported[0])
        return self.output_name(output)

    def source(self, reader: PortAddress) -> PortAddress | None:
        """The leaf output that feeds an input, `Port("", i)` for an input of the whole diagram, None for nothing."""
        while reader.system:
            level = self._parent[reader.system]
            if reader in level.connections:
                return self.origin(level.connections[reader])
            if reader not in level.exported_inputs:
                return None
            reader = PortAddress(level.path, level.exported_inputs[reader])
        return reader

    def inner_inputs(self, reader: PortAddress) -> Iterator[PortAddress]:
        """The leaf inputs that an input port of a diagram leads to; a leaf input leads to itself."""
        if reader.system not in self._inside:
            yield reader
            return
        for inner, index in self._inside[reader.system].exported_inputs.items():
            if index == reader.index:
                yield from self.inner_inputs(inner)

    def leaf_inputs(self) -> Iterator[PortAddress]:
        """Every input port of every leaf block."""
        for path, system in self.leaves():
            for i in range(system.num_input_ports()):
                yield PortAddress(path, i)

    def readers(self) -> dict[PortAddress, list[PortAddress]]:
        """The leaf inputs fed by each leaf output and by each input of the whole diagram."""
        readers: dict[PortAddress, list[PortAddress]] = {}
        for reader in self.leaf_inputs():
            source = self.source(reader)
            if source is not None:
                readers.setdefault(source, []).append(reader)
        return readers

    def feedthrough(self, path: str) -> frozenset[tuple[int, int]]:
        """Pairs (input, output) of one block that pass through within the same instant."""
        if path not in self._feedthrough:
            system = self.systems[path]
            self._feedthrough[path] = frozenset(
                (i, o)
                for o in range(system.num_output_ports())
                if system.HasDirectFeedthrough(o)
                for i in range(system.num_input_ports())
                if system.HasDirectFeedthrough(i, o)
            )
        return self._feedthrough[path]


def is_vector(port: InputPort | OutputPort) -> bool:
    """Whether the port carries a vector of numbers."""
    return bool(port.get_data_type() == PortDataType.kVectorValued)


def is_python_block(system: System) -> bool:
    """Whether the block was written in Python (Drake's own classes live in modules called pydrake...)."""
    return not type(system).__module__.startswith("pydrake")

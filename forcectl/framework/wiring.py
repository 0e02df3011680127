"""Small helpers to wire diagrams."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from pydrake.systems.framework import DiagramBuilder, InputPortIndex, OutputPort, System
from pydrake.systems.primitives import AffineSystem, Demultiplexer, Multiplexer

from forcectl.arrays import Matrix
from forcectl.errors import BadInputError, about
from forcectl.framework.block import PythonDiagram


def made_by(part: Any, method: str, key: str, kind: Any, wanted: str, *arguments: Any, **named: Any) -> Any:
    """The result of a method of a part; errors in the method are about the part.

    Args:
        part: object that fills a slot.
        method: name of the method.
        key: key of the part, for messages.
        kind: required type of the result.
        wanted: the same in words.
        arguments: arguments of the method.
        named: its arguments by name.

    Raises:
        BadInputError: the method returns another type.
    """
    with about(part):
        made = getattr(part, method)(*arguments, **named)
    if not isinstance(made, kind):
        raise BadInputError(f"{method} must return {wanted}, not {type(made).__name__}", key=key)
    return made


def add_part(part: Any, key: str, builder: DiagramBuilder, *arguments: Any, **named: Any) -> System:
    """The system that the `add_to` of a part adds, see `made_by`."""
    system: System = made_by(part, "add_to", key, System, "a Drake system", builder, *arguments, **named)
    if system not in builder.GetSystems():
        raise BadInputError("add_to must return a system that it has added to the builder it is given", key=key)
    return system


def check_names(builder: DiagramBuilder, systems: Iterable[System]) -> None:
    """BadInputError if one of these blocks has the name of another block in the builder."""
    names = Counter(each.get_name() for each in builder.GetSystems())
    for name in (each.get_name() for each in systems):
        if names[name] > 1:
            raise BadInputError(f" adds a block named {name!r}: must be a name that no other block there has")


def affine(gain: Matrix, offset: Matrix) -> AffineSystem:
    """y = gain u + offset, without state."""
    return AffineSystem(D=gain, y0=offset)


def export_outputs(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> None:
    """Export the ports under their names, in this order."""
    for name, port in ports.items():
        builder.ExportOutput(port, name)


def export_all_outputs(builder: DiagramBuilder, system: System, but: Collection[str] = ()) -> None:
    """Export the outputs of a system under their own names, in their order, except those named in `but`."""
    ports = map(system.get_output_port, range(system.num_output_ports()))
    export_outputs(builder, {port.get_name(): port for port in ports if port.get_name() not in but})


def export_all_inputs(builder: DiagramBuilder, system: System, but: Collection[str] = ()) -> dict[str, InputPortIndex]:
    """Export the inputs of a system under their own names, except those named in `but`; the exported ports by name."""
    names = [name for name in input_names(system) if name not in but]
    return {name: builder.ExportInput(system.GetInputPort(name), name) for name in names}


def through(builder: DiagramBuilder, name: str, block: System, source: OutputPort) -> OutputPort:
    """Add a block with one input and one output behind a port; returns its output."""
    builder.AddNamedSystem(name, block)
    builder.Connect(source, block.get_input_port(0))
    return block.get_output_port(0)


def split(builder: DiagramBuilder, name: str, sizes: Sequence[int], source: OutputPort) -> list[OutputPort]:
    """Split a port into consecutive parts of these sizes, by a `Demultiplexer` of this name."""
    block = builder.AddNamedSystem(name, Demultiplexer(sizes))
    builder.Connect(source, block.get_input_port())
    return [block.get_output_port(i) for i in range(len(sizes))]


def stacked(builder: DiagramBuilder, name: str, ports: Sequence[OutputPort]) -> OutputPort:
    """Stack one or more ports into one, by a `Multiplexer` of this name; a single port is returned as it is."""
    if len(ports) == 1:
        return ports[0]
    block = builder.AddNamedSystem(name, Multiplexer([port.size() for port in ports]))
    for i, port in enumerate(ports):
        builder.Connect(port, block.get_input_port(i))
    return block.get_output_port()


def input_names(system: System) -> list[str]:
    """Names of the input ports, in their order."""
    # The second argument suppresses Drake's warning for deprecated ports.
    return [system.get_input_port(i, False).get_name() for i in range(system.num_input_ports())]


def output_names(system: System) -> list[str]:
    """Names of the output ports, in their order."""
    return [system.get_output_port(i, False).get_name() for i in range(system.num_output_ports())]


def optional_inputs(system: System) -> tuple[str, ...]:
    """Inputs that may be left unconnected, as the block declares in `optional_inputs`."""
    return tuple(getattr(system, "optional_inputs", ()))


class Around(PythonDiagram):
    """Base of diagrams around a system, with the same inputs: takes over its `sample_delay` and `optional_inputs`.

    Args:
        system: system inside the diagram.
    """

    def __init__(self, system: System):
        super().__init__()
        self.sample_delay = dict(getattr(system, "sample_delay", {}))
        self.optional_inputs = optional_inputs(system)


class Enclosed(PythonDiagram):
    """The blocks of one configuration as a diagram of their own.

    ```
    name: Enclosed
    input_ports: [(further inputs of the system)]
    output_ports: [(further outputs of the system)]
    ```

    The ports are those of the system. All outputs are feedthrough of all inputs when those of the system are.

    Sampling: every `period` [s] the system and the blocks that belong to it.

    Args:
        builder: holds the system and the blocks that belong to it; it is built into this diagram.
        system: system whose ports are exported.
    """

    def __init__(self, builder: DiagramBuilder, system: System):
        super().__init__()
        self.optional_inputs = optional_inputs(system)
        export_all_inputs(builder, system)
        export_all_outputs(builder, system)
        builder.BuildInto(self)

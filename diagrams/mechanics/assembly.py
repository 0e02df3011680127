"""Putting the parts of a station together: ports of the same name are connected."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort, PortDataType, System
from pydrake.systems.primitives import Selector, SelectorParams

from forcectl.conventions import SIGNALS, TRUTH, Components, unit_of
from forcectl.diagrams.mechanics.site import STATION_SIGNALS
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, about
from forcectl.framework.block import of_ports
from forcectl.framework.wiring import check_names, input_names, optional_inputs, output_names

# Inputs of a station.
STATION_INPUTS = (
    "joint_position_command",
    "joint_velocity_command",
    "joint_torque_feedforward",
    "gripper_command",
    "external_wrench",
)
# Signals that are used within a station only.
_INTERNAL = ("motor_state", "spring_torque", "torque_integral", "joint_torque", "displacement", "reaction_forces")


def selector(size: int, rows: list[int], name: str) -> Selector:
    """A block that outputs some elements of a vector, at a port of this name."""
    one = SelectorParams.OutputSelection
    output = SelectorParams.OutputPortParams(
        name=name, selections=[one(input_port_index=0, input_offset=row) for row in rows]
    )
    return Selector(SelectorParams(inputs=[SelectorParams.InputPortParams(name="state", size=size)], outputs=[output]))


def check_reads(port: InputPort, source: OutputPort) -> None:
    """Raise BadInputError for an input whose kind or size differs from that of the signal of its name."""
    name, vector = port.get_name(), source.get_data_type() == PortDataType.kVectorValued
    if port.get_data_type() != source.get_data_type():
        kind = f"a vector of size {source.size()}" if vector else "abstract"
        raise BadInputError(f" reads {name} as another kind of port: must be {kind}")
    if vector and port.size() != source.size():
        raise BadInputError(f" reads {name} of size {port.size()}: must be {source.size()}")


class Assembly:
    """A station while it is being built.

    Args:
        builder: of the station.
        workcell: the workcell.

    Attributes:
        signals: the ports that the parts added so far output, by name.
    """

    def __init__(self, builder: DiagramBuilder, workcell: Workcell):
        self.builder, self._workcell = builder, workcell
        self.signals: dict[str, OutputPort] = {}
        self._open: list[tuple[str, InputPort, Any]] = []
        self._parts: list[tuple[Any, System]] = []
        self._sensed: dict[str, dict[str, str]] = {}  # by output and sensor: the signal's name in the station
        # Of outputs of further sensors, by their name with the sensor's name in front.
        self._units: dict[str, str] = {}
        self._components: dict[str, str | Components] = {}

    def offer(self, name: str, port: OutputPort) -> None:
        """Offer a port as the signal of a name.

        Raises:
            BadInputError: another part outputs a signal of that name.
        """
        if name in self.signals:
            first, second = self.signals[name].get_system().get_name(), port.get_system().get_name()
            raise BadInputError(f"both {first!r} and {second!r} output {name}: must be one of them", key="sensors")
        self.signals[name] = port

    def add(self, system: System, part: Any = None) -> None:
        """Add a part: its outputs are offered, its inputs are connected by `finish`.

        Args:
            system: already in the builder.
            part: its configuration, for messages.
        """
        self._take(system, part, (), "")

    def add_sensor(self, system: System, name: str, part: Any) -> None:
        """Add a sensor; an output whose name another sensor uses already gets the name of this sensor in front.

        Args:
            system: already in the builder; is renamed when another block there has its name.
            name: of the sensor.
            part: its configuration.
        """
        block = system.get_name()
        if sum(each.get_name() == block for each in self.builder.GetSystems()) > 1:
            system.set_name(f"{name}_{block}")
        self._take(system, part, self._sensed, f"{name}_")
        for output in output_names(system):
            known = self._sensed.setdefault(output, {})
            known[name] = f"{name}_{output}" if known else output

    def _take(self, system: System, part: Any, known: Collection[str], prefix: str) -> None:
        self.register(system, part)
        with about(part):
            self._workcell.check_sizes(system)
        for name in input_names(system):
            self.require(name, system.GetInputPort(name), part)
        for name in output_names(system):
            if name not in known:
                self.offer(name, system.GetOutputPort(name))
            elif name not in TRUTH or name == "body_contact_wrench":  # other true signals are the same for all
                self.offer(prefix + name, system.GetOutputPort(name))
                self._units[prefix + name] = unit_of(name, getattr(system, "port_units", {}))
                shape = SIGNALS[name].shape if name in SIGNALS else ""
                if made := of_ports(system, "port_components").get(name, shape):
                    self._components[prefix + name] = made

    def register(self, system: System, part: Any) -> None:
        """Record which part a block belongs to, for messages."""
        self._parts.append((part, system))

    def require(self, name: str, port: InputPort, part: Any = None) -> None:
        """Register an input, which `finish` connects to the signal of that name; `part` is for messages."""
        self._open.append((name, port, part))

    def finish(self, station: Diagram) -> None:
        """Connect the registered inputs, export the inputs and outputs of the station, and build it.

        Raises:
            BadInputError: an input that nothing is connected to.
        """
        exported: dict[str, object] = {}
        places = {name: i for i, name in enumerate(STATION_INPUTS)}
        for name, port, part in sorted(self._open, key=lambda each: places.get(each[0], -1)):
            if name in self.signals:
                with about(part):
                    check_reads(port, self.signals[name])
                self.builder.Connect(self.signals[name], port)
            elif name in exported:
                self.builder.ConnectInput(exported[name], port)
            elif name in places:
                exported[name] = self.builder.ExportInput(port, name)
            elif name not in optional_inputs(port.get_system()):
                known = ", ".join(sorted({*self.signals, *places}))
                meaning = f" ({STATION_SIGNALS[name]})" if name in STATION_SIGNALS else ""
                with about(part):
                    raise BadInputError(f" reads {name}{meaning}, which no part outputs: must be one of {known}")
        for name, port in self.signals.items():
            if name not in _INTERNAL and port.get_data_type() == PortDataType.kVectorValued:
                self.builder.ExportOutput(port, name)
        for part, system in reversed(self._parts):  # the last one first: the error is about it
            with about(part):
                check_names(self.builder, [system])
        self.builder.BuildInto(station)
        station.port_units, station.port_components = self._units, self._components
        several = {name: names for name, names in self._sensed.items() if len(names) > 1 and name not in TRUTH}
        station.sensed_by_several = several

"""Putting the parts of a station together: ports of the same name are connected."""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort, PortDataType, System

from forcectl.conventions import TRUTH
from forcectl.diagrams.mechanics.site import STATION_SIGNALS
from forcectl.errors import BadInputError

# What comes from outside of a station.
STATION_INPUTS = ("joint_position_command", "joint_velocity_command", "joint_torque_feedforward", "external_wrench")
# What only its parts need.
_INTERNAL = ("motor_state", "spring_torque", "torque_integral", "joint_torque", "displacement", "reaction_forces")


class Assembly:
    """A station in the making.

    Args:
        builder: of the station.

    Attributes:
        signals: the ports that the parts added so far put out, by name.
    """

    def __init__(self, builder: DiagramBuilder):
        self.builder = builder
        self.signals: dict[str, OutputPort] = {}
        self._open: list[tuple[str, InputPort, System]] = []
        self._sensed: set[str] = set()  # names of what sensors put out

    def offer(self, name: str, port: OutputPort) -> None:
        """Make a port known under a name.

        Raises:
            BadInputError: another part puts out a signal of that name.
        """
        if name in self.signals:
            first, second = self.signals[name].get_system().get_name(), port.get_system().get_name()
            raise BadInputError(f"both {first!r} and {second!r} put out {name}: must be one of them", key="sensors")
        self.signals[name] = port

    def add(self, system: System) -> None:
        """Take a part in: its outputs are offered, its inputs are connected by `finish`.

        Args:
            system: already in the builder.
        """
        self._take(system, {})

    def add_sensor(self, system: System, name: str) -> None:
        """Take a sensor in. What another sensor puts out already has the name of this one in front.

        Args:
            system: already in the builder; is renamed when another block there has its name.
            name: of the sensor.
        """
        block = system.get_name()
        if sum(each.get_name() == block for each in self.builder.GetSystems()) > 1:
            system.set_name(f"{name}_{block}")
        ports = map(system.get_output_port, range(system.num_output_ports()))
        self._take(system, {each: f"{name}_{each}" for each in {port.get_name() for port in ports} & self._sensed})
        self._sensed |= {port.get_name() for port in map(system.get_output_port, range(system.num_output_ports()))}

    def _take(self, system: System, renamed: Mapping[str, str]) -> None:
        for port in map(system.get_input_port, range(system.num_input_ports())):
            self._open.append((port.get_name(), port, system))
        for port in map(system.get_output_port, range(system.num_output_ports())):
            name = port.get_name()
            if name not in renamed or name not in TRUTH:  # a truth that is known already is the same
                self.offer(renamed.get(name, name), port)

    def add_output(self, system: System, name: str) -> None:
        """Offer the output of a block that is connected already.

        Args:
            system: with one output.
            name: of the signal.
        """
        self.offer(name, system.get_output_port())

    def want(self, name: str, port: InputPort) -> None:
        """Connect an input of the station's own to the signal of that name when everything is there."""
        self._open.append((name, port, port.get_system()))

    def connect_known(self) -> None:
        """Connect the open inputs whose signals are there."""
        rest = []
        for name, port, system in self._open:
            if name in self.signals:
                self.builder.Connect(self.signals[name], port)
            else:
                rest.append((name, port, system))
        self._open = rest

    def finish(self, station: Diagram) -> None:
        """Connect what is open, export what comes from outside and what is put out, and build.

        Raises:
            BadInputError: an input that nothing is connected to.
        """
        self.connect_known()
        exported: dict[str, object] = {}
        for name in STATION_INPUTS:
            for port in (port for wanted, port, _ in self._open if wanted == name):
                if name in exported:
                    self.builder.ConnectInput(exported[name], port)
                else:
                    exported[name] = self.builder.ExportInput(port, name)
        for name, _, system in self._open:
            if name not in STATION_INPUTS:
                known = ", ".join(sorted({*STATION_SIGNALS, *self.signals}))
                raise BadInputError(f"{system.get_name()!r} wants {name}: must be a signal of this station: {known}")
        for name, port in self.signals.items():
            if name not in _INTERNAL and port.get_data_type() == PortDataType.kVectorValued:
                self.builder.ExportOutput(port, name)
        self.builder.BuildInto(station)

"""One log for all signals of a diagram."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, Multiplexer, VectorLogSink

from forcectl.conventions import Components, unit_of
from forcectl.errors import BadInputError, show
from forcectl.framework.block import of_ports

_COORDINATES = ("time", "variant")  # of a log


@dataclass(frozen=True)
class LoggedSignal:
    """The rows of a signal in the log vector, and their units and names.

    Attributes:
        unit: of its components; several units stand once each, with commas in between.
        labels: names of its components; None for a scalar.
        dimension: name of the dimension along its components; None for a scalar.
        meanings: names of the values 0, 1, ... of an enumerated signal; else empty.
        reasons: a reason for each of these values, in words; "" for none.
        units: of each component, where they differ; else empty.
    """

    rows: slice
    unit: str
    labels: tuple[str, ...] | None
    dimension: str | None = None
    meanings: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Probe:
    """An output port anywhere in a diagram that is read at every tick of the log.

    Attributes:
        components: names of its components; None for a scalar.
    """

    name: str
    port: OutputPort
    unit: str
    components: Components | None = None


@dataclass(frozen=True)
class LoggedLoop:
    """A diagram ready to simulate, with its log.

    Attributes:
        sink: the block that holds the log.
        signals: the rows of each signal in the log, by name.
        period: control tick and log period [s].
    """

    diagram: Diagram
    sink: VectorLogSink
    signals: dict[str, LoggedSignal]
    period: float


def add_log(
    builder: DiagramBuilder,
    ports: Mapping[str, OutputPort],
    period: float,
    components: Mapping[str, Components],
) -> tuple[VectorLogSink, dict[str, LoggedSignal]]:
    """Log the ports every `period` [s] with one multiplexer and one sink, at a tenth of the cost of a sink for each.

    The unit of a signal is that of its components, else the one in `port_units` of its block, else that of the
    conventions. Names of its values, and reasons for some, stand in `port_meanings` and `port_reasons` of the block.

    Args:
        ports: by signal name.
        components: by signal name, where it is no scalar.

    Returns:
        the sink, and the rows of each signal.

    Raises:
        BadInputError: the name of a port is not allowed for a variable of a log.
    """
    for name, port in ports.items():
        taken = (*_COORDINATES, ".")  # "." is the file itself
        if not name.isprintable() or "/" in name or name in taken or not name.strip():
            block = port.get_system().get_name()
            allowed = f"printable characters without '/', and not one of {', '.join(taken)}"
            raise BadInputError(f"block {block!r}: output port {show(name)}: a name to be logged must be {allowed}")
    multiplexer = builder.AddNamedSystem("log_signals", Multiplexer([port.size() for port in ports.values()]))
    signals, row = {}, 0
    for i, (name, port) in enumerate(ports.items()):
        builder.Connect(port, multiplexer.get_input_port(i))
        dimension, named, units = components.get(name, (None, None, ()))
        known = of_ports(port.get_system(), "port_units")
        unit = ",".join(dict.fromkeys(units)) or unit_of(name, known) or unit_of(port.get_name(), known)
        meanings, reasons = (
            of_ports(port.get_system(), f"port_{what}").get(port.get_name(), ()) for what in ("meanings", "reasons")
        )
        signals[name] = LoggedSignal(slice(row, row + port.size()), unit, named, dimension, meanings, reasons, units)
        row += port.size()
    sink = LogVectorOutput(multiplexer.get_output_port(), builder, period)
    sink.set_name("log")
    return sink, signals

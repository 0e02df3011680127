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
    """Where a signal stands in the log vector.

    Attributes:
        unit: of its components; of several units each once, with commas in between.
        labels: names of its components; None for a scalar.
        dimension: that they are along; None for a scalar.
        meanings: names of the values 0, 1, ... of a signal that is the number of something; else empty.
        reasons: of each of them, in words; "" for none.
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
        components: what they are; None for a scalar.
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
        signals: what the rows of the log are.
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
    """Log the ports every `period` [s]: one multiplexer and one sink, a tenth of the cost of a sink each.

    A signal has the units of its components, else the unit that its block gives the port of that name in `port_units`,
    or that of the conventions, and the names of its values, and reasons of some, that the block gives it in
    `port_meanings` and `port_reasons`.

    Args:
        ports: by signal name.
        components: by signal name, where it is no scalar.

    Returns:
        the sink, and what its rows mean.

    Raises:
        BadInputError: a port has a name that no variable of a log can have.
    """
    for name, port in ports.items():
        taken = (*_COORDINATES, ".")  # which is the file itself
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
            of_ports(port.get_system(), f"port_{what}").get(name, ()) for what in ("meanings", "reasons")
        )
        signals[name] = LoggedSignal(slice(row, row + port.size()), unit, named, dimension, meanings, reasons, units)
        row += port.size()
    sink = LogVectorOutput(multiplexer.get_output_port(), builder, period)
    sink.set_name("log")
    return sink, signals

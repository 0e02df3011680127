"""The way of a signal through the blocks, from one port to another."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass

from forcectl.doctor.report import PeriodicEvent
from forcectl.doctor.wiring import Port, Wiring
from forcectl.errors import BadInputError, unknown

PortName = str | tuple[str, str]  # "station/sensor.measured_force", "measured_force", or (system path, port name)


@dataclass(frozen=True)
class Hop:
    """One block on the way."""

    block: str
    input: int
    output: int
    kind: str  # "feedthrough", "fixed" (declared delay without a sample), "continuous", "discrete", "unrestricted"
    event: PeriodicEvent | None = None  # of a sampled block


class Hops:
    """Which outputs of a block an input reaches, and how."""

    def __init__(self, wiring: Wiring, events: tuple[PeriodicEvent, ...]):
        self.wiring = wiring
        self.readers = wiring.readers()
        self._updates: dict[str, PeriodicEvent] = {}
        for event in events:
            known = self._updates.get(event.block)
            if event.kind != "publish" and (known is None or event.period < known.period):
                self._updates[event.block] = event

    def update_of(self, block: str) -> PeriodicEvent | None:
        """The fastest periodic update of a block."""
        return self._updates.get(block)

    def through(self, reader: Port) -> list[Hop]:
        """Every way from an input of a block to its outputs. An input of a block with state may reach all of them."""
        wiring, system = self.wiring, self.wiring.systems[reader.system]
        pairs = wiring.feedthrough(reader.system)
        update = self.update_of(reader.system)
        hops = []
        for o in range(system.num_output_ports()):
            if (reader.index, o) in pairs:
                hops.append(Hop(reader.system, reader.index, o, "feedthrough"))
            elif update is not None:
                hops.append(Hop(reader.system, reader.index, o, update.kind, update))
            elif self.declared(reader.system, reader.index, o) is not None:
                hops.append(Hop(reader.system, reader.index, o, "fixed"))
            elif system.num_continuous_states():
                hops.append(Hop(reader.system, reader.index, o, "continuous"))
        return hops

    def declared(self, block: str, input_index: int, output_index: int) -> float | None:
        """What the block's `sample_delay` says about this way [s], None when it says nothing."""
        names = (
            self.wiring.input_port(Port(block, input_index)).get_name(),
            self.wiring.output_port(Port(block, output_index)).get_name(),
        )
        table: dict[tuple[str, str], float] = getattr(self.wiring.systems[block], "sample_delay", {})
        return float(table[names]) if names in table else None

    def shortest(self, starts: list[Port], target: Port, inside: str = "") -> list[Hop] | None:
        """The way with the least delay from any of the inputs `starts` to the leaf output `target`, or None.

        With `inside`, only blocks within that nested diagram are passed.
        """
        heap: list[tuple[float, int, int, tuple[Hop, ...]]] = []
        order = itertools.count()  # entries of equal cost are never compared further
        done: set[Port] = set()

        def push(readers: list[Port], delay: float, trail: tuple[Hop, ...]) -> None:
            for reader in readers:
                if inside and not reader.system.startswith(f"{inside}/"):
                    continue
                for hop in self.through(reader):
                    heapq.heappush(heap, (delay + self._cost(hop), len(trail) + 1, next(order), (*trail, hop)))

        push(starts, 0.0, ())
        while heap:
            delay, _, _, trail = heapq.heappop(heap)
            output = Port(trail[-1].block, trail[-1].output)
            if output == target:
                return list(trail)
            if output not in done:
                done.add(output)
                push(self.readers.get(output, []), delay, trail)
        return None

    def _cost(self, hop: Hop) -> float:
        declared = self.declared(hop.block, hop.input, hop.output)
        if declared is not None:
            return declared
        return hop.event.period if hop.event is not None else 0.0


def find_outputs(wiring: Wiring, name: PortName) -> list[Port]:
    """The leaf outputs that a name stands for; where no output has it, those that feed the inputs of that name.

    A bare port name means the ports of that name that are nested least: `measured_force` is the station's, not that
    of a block inside it.
    """
    named = {
        Port(path, i): path.count("/") + bool(path)
        for path, system in wiring.systems.items()
        for i in range(system.num_output_ports())
        if _matches(path, system.get_output_port(i, False).get_name(), name)
    }
    least = min(named.values(), default=0)
    outermost = [wiring.origin(port) for port, depth in named.items() if depth == least]
    feeding = (_feeding(wiring, port) for port in find_inputs(wiring, name))
    return _unique(outermost or [port for port in feeding if port is not None])


def find_inputs(wiring: Wiring, name: PortName) -> list[Port]:
    """The input ports, of blocks and of diagrams, that a name stands for: those that are nested least."""
    named = {
        Port(path, i): path.count("/") + bool(path)
        for path, system in wiring.systems.items()
        for i in range(system.num_input_ports())
        if _matches(path, system.get_input_port(i, False).get_name(), name)
    }
    least = min(named.values(), default=0)
    return [port for port, depth in named.items() if depth == least]


def one_output(wiring: Wiring, name: PortName) -> Port:
    """The leaf output that a user's name stands for.

    Raises:
        BadInputError: no port has this name, or several different ones have it.
    """
    found = find_outputs(wiring, name)
    if len(found) == 1:
        return found[0]
    if found:
        options = ", ".join(wiring.output_name(port) for port in found)
        raise BadInputError(f"port {_text(name)!r} is ambiguous: give the block as well, one of {options}")
    raise unknown("port", _text(name), _all_names(wiring))


def start_readers(wiring: Wiring, hops: Hops, name: PortName) -> tuple[str, list[Port], Port | None]:
    """Where a way begins: its name, the inputs read first, and the leaf output read (None: it begins at an input).

    A name of an output begins behind that output, a name of an input in front of its block.
    """
    if any(_matches(path, port, name) for path, port in _output_names(wiring)):
        output = one_output(wiring, name)
        return wiring.shown_name(output), hops.readers.get(output, []), output
    inputs = find_inputs(wiring, name)
    if not inputs:
        raise unknown("port", _text(name), _all_names(wiring))
    inner = _unique([reader for port in inputs for reader in wiring.inner_inputs(port)])
    return wiring.input_name(inputs[0]), inner, None


def _feeding(wiring: Wiring, reader: Port) -> Port | None:
    inner = next(wiring.inner_inputs(reader), None)
    source = wiring.source(inner) if inner is not None else None
    return source if source is not None and source.system else None


def _matches(path: str, port: str, name: PortName) -> bool:
    if isinstance(name, tuple):
        return (path, port) == name
    return name in (port, f"{path}.{port}" if path else port)


def _text(name: PortName) -> str:
    return ".".join(part for part in name if part) if isinstance(name, tuple) else name


def _output_names(wiring: Wiring) -> list[tuple[str, str]]:
    return [
        (path, system.get_output_port(i, False).get_name())
        for path, system in wiring.systems.items()
        for i in range(system.num_output_ports())
    ]


def _all_names(wiring: Wiring) -> list[str]:
    inputs = [
        wiring.input_name(Port(path, i))
        for path, system in wiring.systems.items()
        for i in range(system.num_input_ports())
    ]
    return inputs + [_text(name) for name in _output_names(wiring)]


def _unique(ports: list[Port]) -> list[Port]:
    return list(dict.fromkeys(ports))

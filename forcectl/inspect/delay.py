"""The delay from one port to another, block by block, and once around a force loop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from forcectl.errors import BadInputError
from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.ports import PortName, find_inputs, find_outputs, named_outputs, one_output, start_of_way
from forcectl.inspect.schedule import clean, schedule
from forcectl.inspect.stages import stages_of
from forcectl.inspect.start import StartValues
from forcectl.inspect.ways import Hop, Hops
from forcectl.inspect.wiring import PortAddress, Wiring

COMMANDS = ("joint_position_command", "displacement_command")
SENSOR = "measured_force"
TRUTHS = ("contact_force", "arm_contact_force")
LOAD = "external_wrench"


@dataclass(frozen=True)
class DelayRow:
    """The delay that one block on a signal path adds [s]."""

    block: str
    input: str
    output: str
    kind: str  # "feedthrough", "continuous", "discrete", "unrestricted", "aperiodic" or "fixed"
    samples: int  # samples of the block's own period between input and output
    delay: float  # [s], until the next block on the path reads the value
    basis: str  # where `samples` comes from: "structure", "declared", "measured" or "assumed"


@dataclass(frozen=True)
class DelayChain:
    """The delays on the signal path from one port to another; times in [s]."""

    source: str
    target: str
    rows: tuple[DelayRow, ...]
    reader: str  # the block that reads the target port first; "": a reader at the last block's ticks is assumed
    total: float  # sum of the rows
    worst: float  # total with the longest wait for the tick of a slower block


@dataclass(frozen=True)
class Start:
    """The start of a signal path.

    Attributes:
        name: full name of the port.
        readers: leaf inputs at which the path begins.
        output: leaf output that feeds them; None: the path begins at the inputs themselves.
    """

    name: str
    readers: list[PortAddress]
    output: PortAddress | None


def ends_of_way(hops: Hops, source: PortName, target: PortName) -> tuple[Start, PortAddress]:
    """The start of a signal path, at an output or at an input, and the leaf output at its end.

    Often nothing on the path reads an output that is only logged, such as the true contact force beside its sensor.
    Then the path starts at the nearest output from which it is computed by feedthrough, and from which a path leads to
    `target`.

    Raises:
        BadInputError: a name that no port has, or that several different ports have.
    """
    name, inputs, output = start_of_way(hops.wiring, source)
    end = one_output(hops.wiring, target)
    if output is None:
        return Start(name, inputs, None), end
    for origin in _same_instant(hops.wiring, output):
        readers = hops.readers.get(origin, [])
        if origin == output == end or hops.shortest(readers, end) is not None:
            return Start(name, readers, origin if origin.system else None), end
    return Start(name, hops.readers.get(output, []), output), end


def _same_instant(wiring: Wiring, output: PortAddress) -> Iterator[PortAddress]:
    """A leaf output and all outputs from which it is computed by feedthrough, the nearest first."""
    queue = [output]
    for port in queue:  # the list grows meanwhile
        yield port
        sources = map(wiring.source, wiring.passed(port) if port.system else ())
        queue += dict.fromkeys(source for source in sources if source is not None and source not in queue)


def trace(
    values: StartValues, hops: Hops, source: PortName, target: PortName, onward: PortName | None = None
) -> DelayChain | None:
    """The signal path of least delay from `source` to `target`, or None when there is no path.

    Args:
        values: start values of the diagram.
        hops: connections through the blocks of the diagram.
        source: the first port.
        target: the last port.
        onward: next port of the signal in a loop; the reader of `target` is then the block on the path to it.

    Raises:
        BadInputError: a name that no port has, or that several different ports have.
    """
    start, end = ends_of_way(hops, source, target)
    way = [] if start.output == end else hops.shortest(start.readers, end)
    if way is None:
        return None
    stages = stages_of(values, hops, way)
    consumers = _consumers(hops, end, set())
    if onward is not None and None in consumers.values():  # a continuous reader may be outside of the loop
        consumers = _next_in_loop(hops, end, one_output(hops.wiring, onward)) or consumers
    continuous = any(event is None for event in consumers.values())
    events = [event for event in consumers.values() if event is not None] or _passed_at(hops, way)
    rhythm = _rhythm_of(hops, start.output) if start.output is not None else None
    parts, worst = schedule(stages, rhythm, None if continuous else events)
    rows = tuple(
        DelayRow(stage.block, stage.input, stage.output, stage.kind, stage.samples, clean(part), stage.basis)
        for stage, part in zip(stages, parts, strict=True)
    )
    reader = ", ".join(consumers)
    return DelayChain(start.name, values.wiring.shown_name(end), rows, reader, clean(sum(parts)), clean(worst))


def ways_around(wiring: Wiring) -> list[tuple[PortName, PortName]]:
    """The default signal paths, which lead once around the loop: from command to contact force, sensor and command.

    Without a force sensor the last path begins where an external wrench acts, and leads through the joint sensors.
    """
    command = next((name for name in COMMANDS if len(find_outputs(wiring, name)) == 1), None)
    truth = next((name for name in TRUTHS if len(find_outputs(wiring, name)) == 1), None)
    sensors = find_outputs(wiring, SENSOR)
    ways: list[tuple[PortName, PortName]] = [(command, truth)] if command is not None and truth is not None else []
    if len(sensors) > 1:
        return []
    if sensors or find_inputs(wiring, SENSOR):
        ways += [(truth, SENSOR)] if sensors and truth is not None else []
        ways += [(SENSOR, command)] if command is not None else []
    elif truth is not None and command is not None:
        ways.append((LOAD if find_inputs(wiring, LOAD) else truth, command))
    return ways


def way_and_back(hops: Hops, source: PortName, target: PortName) -> list[tuple[PortName, PortName]]:
    """The path from `source` to `target`, and before it the path back, where both are outputs of blocks in one loop.

    Raises:
        BadInputError: both are the same port.
    """
    wiring = hops.wiring
    begins = find_outputs(wiring, source)
    if begins and begins == find_outputs(wiring, target):
        raise BadInputError(f"the path from {source} to {target} is empty: must be between two ports")
    back: list[tuple[PortName, PortName]] = [(target, source)]
    return [*(back if len(begins) == 1 and _closes(hops, source, target) else []), (source, target)]


def _closes(hops: Hops, source: PortName, target: PortName) -> bool:
    """Whether the path back starts after `source`; the substitute for a `target` that nothing reads may lie before."""
    start, end = ends_of_way(hops, target, source)
    if not named_outputs(hops.wiring, target) or start.output in find_outputs(hops.wiring, target):
        return True
    return start.output is not None and hops.shortest(hops.readers.get(end, []), start.output) is not None


def _consumers(hops: Hops, output: PortAddress, seen: set[PortAddress]) -> dict[str, PeriodicEvent | None]:
    """The events of the blocks that read an output, directly or through feedthrough; None for continuous blocks.

    A block is left out if it passes the signal on by feedthrough to a block with a shorter period.
    """
    found: dict[str, PeriodicEvent | None] = {}
    for reader in hops.readers.get(output, []):
        if reader in seen:
            continue
        seen.add(reader)
        update = hops.updates.get(reader.system)
        if update is None and hops.wiring.systems[reader.system].num_continuous_states():
            found[reader.system] = None
            continue
        behind: dict[str, PeriodicEvent | None] = {}
        for hop in hops.through(reader):
            if hop.event is None:
                behind |= _consumers(hops, hop.output, seen)
        sooner = any(event is None or update is None or event.period < update.period for event in behind.values())
        found |= behind if sooner or update is None else {reader.system: update}
    return found


def _next_in_loop(hops: Hops, end: PortAddress, onward: PortAddress) -> dict[str, PeriodicEvent | None]:
    """The first block with state on the path from an output to `onward`; else the readers of `onward`."""
    way = hops.shortest(hops.readers.get(end, []), onward) or []
    holding = next((hop for hop in way if hop.kind != "feedthrough"), None)
    return _consumers(hops, onward, set()) if holding is None else {holding.block: holding.event}


def _passed_at(hops: Hops, way: list[Hop]) -> list[PeriodicEvent]:
    """The fastest update of the blocks after the last hold, which have feedthrough for the signal, such as a plant."""
    held = max((k for k, hop in enumerate(way) if hop.event is not None), default=-1)
    updates = [hops.updates.get(hop.block) for hop in way[held + 1 :]]
    return sorted((event for event in updates if event is not None), key=lambda event: event.period)[:1]


def _rhythm_of(hops: Hops, output: PortAddress) -> PeriodicEvent | None:
    """The event that changes the value of an output: of its own block, or of a block that feeds it by feedthrough."""
    update = hops.updates.get(output.system)
    feeding = hops.wiring.passed(output)
    if update is not None and not feeding:
        return update
    for reader in feeding:
        source = hops.wiring.source(reader)
        if source is not None and source.system and (found := _rhythm_of(hops, source)) is not None:
            return found
    return None

"""Every sample of delay from one port to another, block by block, and once around a force loop."""

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
    """What one block on the way adds to the delay [s]."""

    block: str
    input: str
    output: str
    kind: str  # "feedthrough", "continuous", "discrete", "unrestricted", "aperiodic" or "fixed"
    samples: int  # samples of the block's own period between input and output
    delay: float  # [s], as the next reader on the way sees it
    basis: str  # where `samples` comes from: "structure", "declared", "measured" or "assumed"


@dataclass(frozen=True)
class DelayChain:
    """Every sample of delay from one port to another; times in [s]."""

    source: str
    target: str
    rows: tuple[DelayRow, ...]
    reader: str  # the block that reads the target port first, "" when a reader at the last block's own rate is meant
    total: float  # sum of the rows
    worst: float  # with the longest wait for a slower block to look


@dataclass(frozen=True)
class Start:
    """Where a way begins.

    Attributes:
        name: the port as the user would write it in full.
        readers: leaf inputs that are read first.
        output: the leaf output they read; None: the way begins at these inputs.
    """

    name: str
    readers: list[PortAddress]
    output: PortAddress | None


def ends_of_way(hops: Hops, source: PortName, target: PortName) -> tuple[Start, PortAddress]:
    """Where a way begins, behind an output or in front of an input's block, and the leaf output where it ends.

    Often nothing on the way reads an output that is only logged, such as a true contact force beside its sensor. What
    it is computed from in the same instant, the nearest that leads to `target`, then stands for it.

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
    """A leaf output and everything it is computed from without a state in between, the nearest first."""
    queue = [output]
    for port in queue:  # grows on the way
        yield port
        sources = map(wiring.source, wiring.passed(port) if port.system else ())
        queue += dict.fromkeys(source for source in sources if source is not None and source not in queue)


def trace(
    values: StartValues, hops: Hops, source: PortName, target: PortName, onward: PortName | None = None
) -> DelayChain | None:
    """The way of least delay from `source` to `target`, or None when there is no way.

    Args:
        values: of the diagram at its start.
        hops: of the diagram.
        source: the first port.
        target: the last port.
        onward: the port that the signal reaches next in a loop: what reads `target` on the way there counts.

    Raises:
        BadInputError: a name that no port has, or that several different ports have.
    """
    start, end = ends_of_way(hops, source, target)
    way = [] if start.output == end else hops.shortest(start.readers, end)
    if way is None:
        return None
    stages = stages_of(values, hops, way)
    consumers = _consumers(hops, end, set())
    if onward is not None and None in consumers.values():  # a continuous block may only stand beside the loop
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
    """The ways that are looked at when the user names none, from the command back to the command.

    Command to contact force, contact force to sensor, sensor to command. Without a force sensor the contact force acts
    where an external wrench does, and shows itself in the joint readings.
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
    """The way from `source` to `target`, and before it the way back, where both ends are outputs of blocks in a loop.

    Raises:
        BadInputError: both are one port.
    """
    wiring = hops.wiring
    begins = find_outputs(wiring, source)
    if begins and begins == find_outputs(wiring, target):
        raise BadInputError(f"the way from {source} to {target} has no length: must be between two ports")
    back: list[tuple[PortName, PortName]] = [(target, source)]
    return [*(back if len(begins) == 1 and _closes(hops, source, target) else []), (source, target)]


def _closes(hops: Hops, source: PortName, target: PortName) -> bool:
    """Whether the way back begins behind `source`: what stands for a target that nothing reads may lie before it."""
    start, end = ends_of_way(hops, target, source)
    if not named_outputs(hops.wiring, target) or start.output in find_outputs(hops.wiring, target):
        return True
    return start.output is not None and hops.shortest(hops.readers.get(end, []), start.output) is not None


def _consumers(hops: Hops, output: PortAddress, seen: set[PortAddress]) -> dict[str, PeriodicEvent | None]:
    """The sampled blocks that read an output, directly or through feedthrough, and continuous ones (None).

    A block that samples more slowly than one behind it, to which it passes the signal on, is left out.
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
    """The first block with state that reads an output on the way to `onward`, else what reads `onward`."""
    way = hops.shortest(hops.readers.get(end, []), onward) or []
    holding = next((hop for hop in way if hop.kind != "feedthrough"), None)
    return _consumers(hops, onward, set()) if holding is None else {holding.block: holding.event}


def _passed_at(hops: Hops, way: list[Hop]) -> list[PeriodicEvent]:
    """The fastest update of the blocks behind the last hold that only pass the signal on, such as a plant."""
    held = max((k for k, hop in enumerate(way) if hop.event is not None), default=-1)
    updates = [hops.updates.get(hop.block) for hop in way[held + 1 :]]
    return sorted((event for event in updates if event is not None), key=lambda event: event.period)[:1]


def _rhythm_of(hops: Hops, output: PortAddress) -> PeriodicEvent | None:
    """The event that changes the value on an output: of the block itself or of one it passes on."""
    update = hops.updates.get(output.system)
    feeding = hops.wiring.passed(output)
    if update is not None and not feeding:
        return update
    for reader in feeding:
        source = hops.wiring.source(reader)
        if source is not None and source.system and (found := _rhythm_of(hops, source)) is not None:
            return found
    return None

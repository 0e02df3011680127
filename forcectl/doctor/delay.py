"""Every sample of delay from a sensor to a command, block by block."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pydrake.systems.primitives import DiscreteTimeDelay

from forcectl.doctor.paths import Hops, PortName, find_inputs, find_outputs, one_output, start_readers
from forcectl.doctor.report import DelayChain, DelayRow, Finding, PeriodicEvent, error, warning
from forcectl.doctor.schedule import clean, schedule
from forcectl.doctor.stages import stages_of
from forcectl.doctor.values import StartValues
from forcectl.doctor.wiring import Port, Wiring

COMMANDS = ("joint_position_command", "displacement_command")
SENSOR = "measured_force"
TRUTH = "contact_force"


def trace(values: StartValues, hops: Hops, source: PortName, target: PortName) -> DelayChain | None:
    """The way of least delay from `source` to `target`, or None when there is no way.

    Raises:
        BadInputError: a name that no port has, or that several different ports have.
    """
    start, readers, output = start_readers(values.wiring, hops, source)
    end = one_output(values.wiring, target)
    way = [] if output == end else hops.shortest(readers, end)
    if way is None:
        return None
    stages = stages_of(values, hops, way)
    consumers = _consumers(hops, end, set())
    continuous = any(event is None for event in consumers.values())
    events = [event for event in consumers.values() if event is not None]
    rhythm = _rhythm_of(hops, output) if output is not None else None
    parts, worst = schedule(stages, rhythm, None if continuous else events)
    rows = tuple(
        DelayRow(stage.block, stage.input, stage.output, stage.kind, stage.samples, clean(part), stage.basis)
        for stage, part in zip(stages, parts, strict=True)
    )
    reader = ", ".join(consumers)
    return DelayChain(start, values.wiring.shown_name(end), rows, reader, clean(sum(parts)), clean(worst))


def default_traces(wiring: Wiring) -> list[tuple[PortName, PortName]]:
    """The ways that are looked at when the user names none: force to sensor, sensor to command."""
    command = next((name for name in COMMANDS if len(find_outputs(wiring, name)) == 1), None)
    traces: list[tuple[PortName, PortName]] = []
    sensors = find_outputs(wiring, SENSOR)
    if len(sensors) > 1 or not (sensors or find_inputs(wiring, SENSOR)):
        return traces
    if sensors and len(find_outputs(wiring, TRUTH)) == 1:
        traces.append((TRUTH, SENSOR))
    if command is not None:
        traces.append((SENSOR, command))
    return traces


def _consumers(hops: Hops, output: Port, seen: set[Port]) -> dict[str, PeriodicEvent | None]:
    """The sampled blocks that read an output, directly or through feedthrough, and continuous ones (None)."""
    found: dict[str, PeriodicEvent | None] = {}
    for reader in hops.readers.get(output, []):
        if reader in seen:
            continue
        seen.add(reader)
        update = hops.update_of(reader.system)
        if update is not None or hops.wiring.systems[reader.system].num_continuous_states():
            found[reader.system] = update
        else:
            for hop in hops.through(reader):
                found |= _consumers(hops, Port(hop.block, hop.output), seen)
    return found


def _rhythm_of(hops: Hops, output: Port) -> PeriodicEvent | None:
    """The event that changes the value on an output: of the block itself or of one it passes on."""
    update = hops.update_of(output.system)
    feeding = [i for i, o in hops.wiring.feedthrough(output.system) if o == output.index]
    if update is not None and not feeding:
        return update
    for i in feeding:
        source = hops.wiring.source(Port(output.system, i))
        if source is not None and source.system and (found := _rhythm_of(hops, source)) is not None:
            return found
    return None


def chain_findings(values: StartValues, chain: DelayChain, expected: float | None) -> Iterator[Finding]:
    """More than one hold on the way that nobody declared, and a total that is not the expected one."""
    where = f"{chain.source} -> {chain.target}"
    holds = [
        row
        for row in chain.rows
        if row.samples
        and row.delay > 0
        and row.basis != "declared"
        and not isinstance(values.wiring.systems[row.block], DiscreteTimeDelay)
    ]
    if len(holds) > 1:
        extra = sum(row.delay for row in holds[:-1])
        blocks = ", ".join(f"{row.block} {row.delay:g} s" for row in holds)
        yield warning(
            "extra-sample",
            where,
            f"{len(holds)} blocks hold the signal ({blocks}); one is enough, the others add {extra:g} s. Make them "
            "feedthrough, or declare sample_delay where it is meant",
        )
    if expected is not None and not math.isclose(chain.total, expected, rel_tol=1e-6, abs_tol=1e-9):
        yield error("unexpected-delay", where, f"the delay is {chain.total:g} s, expected {expected:g} s")

"""Every sample of delay from a sensor to a command, block by block.

How Drake orders one instant: unrestricted updates first, then discrete updates; updates of the same kind all read
the state from before. So a value that changes in a discrete update at t_k is seen by another discrete (or
unrestricted) update at its first tick after t_k, while one that changes in an unrestricted update is seen by the
discrete updates of the same instant. A block therefore adds the time from the tick at which it reads its input to
the tick at which the next reader on the way reads its output, which is one period of the faster of the two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pydrake.systems.primitives import DiscreteTimeDelay

from forcectl.doctor.paths import Hop, Hops, PortName, find_outputs, one_output, start_readers
from forcectl.doctor.probe import samples_through
from forcectl.doctor.report import DelayChain, DelayRow, Finding, PeriodicEvent, error, warning
from forcectl.doctor.values import StartValues
from forcectl.doctor.wiring import Port, Wiring

COMMANDS = ("joint_position_command", "displacement_command")
SENSOR = "measured_force"
TRUTH = "contact_force"

_RANK = {"unrestricted": 0, "discrete": 1}
_MOST_PHASES = 1000


@dataclass(frozen=True)
class _Stage:
    """A hop with its number of samples and where that number comes from."""

    hop: Hop
    samples: int
    fixed: float  # [s], declared by a block without samples
    basis: str


def trace(
    values: StartValues, hops: Hops, source: PortName, target: PortName, findings: list[Finding]
) -> DelayChain | None:
    """The way of least delay from `source` to `target`, or None when there is no way.

    Raises:
        BadInputError: a name that no port has, or that several different ports have.
    """
    start, readers, output = start_readers(values.wiring, hops, source)
    end = one_output(values.wiring, target)
    way = [] if output == end else hops.shortest(readers, end)
    if way is None:
        return None
    stages = [_stage(values, hops, hop, findings) for hop in way]
    reader, consumer = _consumer(hops, end)
    rhythm = _rhythm_of(hops, output) if output is not None else None
    best, worst, rows = _schedule(values.wiring, stages, rhythm, consumer)
    return DelayChain(start, values.wiring.output_name(end), rows, reader, best, worst)


def default_traces(wiring: Wiring) -> list[tuple[PortName, PortName]]:
    """The ways that are looked at when the user names none: force to sensor, sensor to command."""
    command = next((name for name in COMMANDS if len(find_outputs(wiring, name)) == 1), None)
    traces: list[tuple[PortName, PortName]] = []
    if len(find_outputs(wiring, SENSOR)) != 1:
        return traces
    if len(find_outputs(wiring, TRUTH)) == 1:
        traces.append((TRUTH, SENSOR))
    if command is not None:
        traces.append((SENSOR, command))
    return traces


def _stage(values: StartValues, hops: Hops, hop: Hop, findings: list[Finding]) -> _Stage:
    declared = hops.declared(hop.block, hop.input, hop.output)
    if hop.event is None:
        return _Stage(hop, 0, declared or 0.0, "structure" if declared is None else "declared")
    measured = samples_through(values, hop)
    if declared is None:
        return _Stage(hop, measured or 1, 0.0, "assumed" if measured is None else "measured")
    samples = round(declared / hop.event.period)
    if measured is not None and not math.isclose(measured * hop.event.period, declared, rel_tol=1e-6):
        port = values.wiring.output_name(Port(hop.block, hop.output))
        findings.append(
            warning(
                "delay-differs",
                port,
                f"the block declares a sample_delay of {declared:g} s, but run alone it takes {measured} samples of "
                f"{hop.event.period:g} s = {measured * hop.event.period:g} s; correct the table or the block",
            )
        )
    return _Stage(hop, max(samples, 1), 0.0, "declared")


def _consumer(hops: Hops, output: Port) -> tuple[str, PeriodicEvent | str | None]:
    """Who reads an output first: a sampled block's event, "continuous", or None for nobody in this diagram."""
    return _first(hops, output, set())


def _first(hops: Hops, output: Port, seen: set[Port]) -> tuple[str, PeriodicEvent | str | None]:
    best: tuple[str, PeriodicEvent | str | None] = ("", None)
    for reader in hops.readers.get(output, []):
        if reader in seen or not reader.system:
            continue
        seen.add(reader)
        update = hops.update_of(reader.system)
        if update is not None:
            found: tuple[str, PeriodicEvent | str | None] = (reader.system, update)
        elif hops.wiring.systems[reader.system].num_continuous_states():
            found = (reader.system, "continuous")
        else:
            behind = [_first(hops, Port(hop.block, hop.output), seen) for hop in hops.through(reader)]
            found = min(behind, key=_eagerness, default=("", None))
        best = min(best, found, key=_eagerness)
    return best


def _eagerness(found: tuple[str, PeriodicEvent | str | None]) -> float:
    event = found[1]
    if event is None:
        return math.inf
    return 0.0 if isinstance(event, str) else event.period


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


def _schedule(
    wiring: Wiring, stages: list[_Stage], rhythm: PeriodicEvent | None, consumer: PeriodicEvent | str | None
) -> tuple[float, float, tuple[DelayRow, ...]]:
    """Shortest and longest delay over all phases, and the rows of the shortest."""
    events = [stage.hop.event for stage in stages if stage.hop.event is not None]
    best: tuple[float, list[float]] | None = None
    worst = 0.0
    for start in _phases(rhythm, events):
        parts = _walk(stages, start, consumer)
        total = sum(parts)
        if best is None or total < best[0] - 1e-12:
            best = (total, parts)
        worst = max(worst, total)
    total, parts = best if best is not None else (0.0, [])
    rows = [
        DelayRow(
            stage.hop.block,
            wiring.input_port(Port(stage.hop.block, stage.hop.input)).get_name(),
            wiring.output_port(Port(stage.hop.block, stage.hop.output)).get_name(),
            stage.hop.kind,
            stage.samples,
            _clean(part),
            stage.basis,
        )
        for stage, part in zip(stages, parts, strict=True)
    ]
    return _clean(total), _clean(worst), tuple(rows)


def _phases(rhythm: PeriodicEvent | None, events: list[PeriodicEvent]) -> Iterator[float]:
    """Instants at which the source may change: its own ticks, else those of the first block that looks."""
    first = rhythm or (events[0] if events else None)
    if first is None:
        yield 0.0
        return
    slowest = max([first, *events], key=lambda event: event.period)
    # Late enough that every block has ticked before, then over one period of the slowest.
    offset = first.offset + math.ceil(max(e.offset for e in [first, *events]) / first.period) * first.period
    for k in range(min(_MOST_PHASES, max(1, round(slowest.period / first.period)))):
        yield offset + k * first.period


def _walk(stages: list[_Stage], start: float, consumer: PeriodicEvent | str | None) -> list[float]:
    """What each stage adds [s] when the source changes just before the updates at `start`."""
    time, rank = start, -1  # when the value at hand changed, and in which kind of update
    reads: list[tuple[int, float]] = []  # (stage, instant at which its delay begins)
    parts = [0.0] * len(stages)
    last: PeriodicEvent | None = None
    for i, stage in enumerate(stages):
        event = stage.hop.event
        if event is None:
            parts[i] = stage.fixed
            time += stage.fixed
            continue
        read = _next_tick(event, time, rank)
        if reads:
            parts[reads[-1][0]] += read - time
        elif stages:
            parts[i] += read - time  # waiting for the first tick counts to the block that ticks
        reads.append((i, read))
        parts[i] += (stage.samples - 1) * event.period
        time, rank, last = read + (stage.samples - 1) * event.period, _RANK[event.kind], event
    if last is None or isinstance(consumer, str):
        return parts  # a continuous reader sees the new value at once
    # Nobody reads in this diagram: meant is a reader at the last block's own ticks, before that block updates.
    reader = consumer or PeriodicEvent("", last.kind, last.period, last.offset)
    parts[reads[-1][0]] += _next_tick(reader, time, rank) - time
    return parts


def _next_tick(event: PeriodicEvent, time: float, rank: int) -> float:
    """First tick of `event` that sees a value changed at `time` by an update of `rank` (-1: before all updates)."""
    ticks = (time - event.offset) / event.period
    same_instant = _RANK[event.kind] > rank
    k = math.ceil(ticks - 1e-6) if same_instant else math.floor(ticks + 1e-6) + 1
    return event.offset + max(k, 0) * event.period


def _clean(seconds: float) -> float:
    return float(f"{seconds:.9g}") if abs(seconds) > 1e-12 else 0.0


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
    if len(holds) > 1 and chain.source.endswith(SENSOR):
        extra = sum(row.delay for row in holds[:-1])
        yield warning(
            "extra-sample",
            where,
            f"{len(holds)} blocks hold the signal ({', '.join(f'{r.block} {r.delay:g} s' for r in holds)}); one is "
            f"enough, the others add {extra:g} s. Make them feedthrough, or declare sample_delay where it is meant",
        )
    if expected is not None and not math.isclose(chain.total, expected, rel_tol=1e-6, abs_tol=1e-9):
        yield error(
            "unexpected-delay",
            where,
            f"the delay is {chain.total:g} s, expected {expected:g} s",
        )

"""How long each block on a way holds the signal: declared by the block, measured by running it alone, or assumed.

`sample_delay`, {(input, output): seconds}, may be given by a block or by a nested diagram. For a block that holds its
output over a sample that is the whole period; for the exact discretisation of a continuous filter, whose first answer
one tick later is no delay but physics, and for a block with an unrestricted update, the last sample is not counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from pydrake.systems.framework import Diagram, System

from forcectl.doctor.paths import Hop, Hops
from forcectl.doctor.probe import samples_through
from forcectl.doctor.report import Finding, error, warning
from forcectl.doctor.schedule import Stage, clean, schedule
from forcectl.doctor.values import StartValues
from forcectl.doctor.wiring import Port


def stages_of(values: StartValues, hops: Hops, way: list[Hop]) -> list[Stage]:
    """One stage per block; a nested diagram that declares the delay between its ports may stand for its blocks."""
    stages: list[Stage] = []
    i = 0
    while i < len(way):
        diagram = _declared_diagram(hops, way, i)
        if diagram is None:
            stages.append(_stage(values, hops, way[i]))
            i += 1
            continue
        stage, end = diagram
        inner = [_stage(values, hops, hop) for hop in way[i:end]]
        if math.isclose(sum(schedule(inner, None, [])[0]), stage.delay or 0.0, abs_tol=1e-9):
            stages += [replace(s, basis="declared") for s in inner]
        else:
            stages.append(stage)
        i = end
    return stages


def _stage(values: StartValues, hops: Hops, hop: Hop) -> Stage:
    wiring = hops.wiring
    stage = Stage(
        hop.block,
        wiring.input_port(Port(hop.block, hop.input)).get_name(),
        wiring.output_port(Port(hop.block, hop.output)).get_name(),
        hop.kind,
        "structure",
    )
    declared = hops.declared(hop.block, hop.input, hop.output)
    if hop.event is None:
        return stage if declared is None else replace(stage, delay=declared, basis="declared")
    measured = samples_through(values, hop)
    if declared is None:
        basis = "assumed" if measured is None else "measured"
        return replace(stage, event=hop.event, samples=measured or 1, basis=basis)
    samples = measured or max(1, round(declared / hop.event.period))
    stage = replace(stage, event=hop.event, samples=samples, basis="declared")
    if hop.kind == "unrestricted" or math.isclose(declared, samples * hop.event.period, rel_tol=1e-6):
        return stage
    return replace(stage, delay=declared, samples=round(declared / hop.event.period))


def _declared_diagram(hops: Hops, way: list[Hop], start: int) -> tuple[Stage, int] | None:
    """The outermost nested diagram that declares the delay of a part of the way from `start`, and where it ends."""
    wiring = hops.wiring
    names = way[start].block.split("/")[:-1]
    first = Port(way[start].block, way[start].input)
    for depth in range(1, len(names) + 1):
        path = "/".join(names[:depth])
        system = wiring.systems[path]
        for i, o, delay in _table(system):
            if first not in wiring.inner_inputs(Port(path, i)):
                continue
            last = wiring.origin(Port(path, o))
            for end in range(start, len(way)):
                if not way[end].block.startswith(f"{path}/"):
                    break
                if Port(way[end].block, way[end].output) == last:
                    event = next((hop.event for hop in way[start : end + 1] if hop.event is not None), None)
                    kind = "fixed" if event is None else event.kind
                    samples = 0 if event is None else round(delay / event.period)
                    inner, outer = system.get_input_port(i, False), system.get_output_port(o, False)
                    names_ = (inner.get_name(), outer.get_name())
                    return Stage(path, *names_, kind, "declared", event, samples, delay), end + 1
    return None


def _table(system: System) -> Iterator[tuple[int, int, float]]:
    """The entries of a `sample_delay` by port index; entries with unknown ports are left out."""
    inputs = {system.get_input_port(i, False).get_name(): i for i in range(system.num_input_ports())}
    outputs = {system.get_output_port(i, False).get_name(): i for i in range(system.num_output_ports())}
    for (source, target), delay in getattr(system, "sample_delay", {}).items():
        if source in inputs and target in outputs:
            yield inputs[source], outputs[target], float(delay)


def declared_findings(values: StartValues, hops: Hops) -> Iterator[Finding]:
    """Every `sample_delay` of every block and nested diagram, compared with what it really does."""
    wiring = hops.wiring
    for path, system in wiring.systems.items():
        if not path and not isinstance(system, Diagram):
            continue  # a single block stands in the list under its own name as well
        table = getattr(system, "sample_delay", {})
        known = list(_table(system))
        if len(known) < len(table):
            yield error("sample-delay-ports", path, f"sample_delay names ports that the block has not: {sorted(table)}")
        for i, o, delay in known:
            way = _way_inside(hops, path, i, o)
            if way is None:
                yield warning("delay-differs", path, f"sample_delay between ports that nothing joins: {sorted(table)}")
                continue
            found = [_measured(values, hops, hop) for hop in way]
            if any(part is None for part in found):
                continue  # a block that cannot be run alone: nothing to compare with
            whole = sum(part for part in found if part is not None)
            periods = [hop.event.period for hop in way if hop.event is not None]
            # Each sampled block may leave its last sample uncounted, see above.
            allowed = [whole - sum(periods[:n]) for n in range(len(periods) + 1)]
            if not any(math.isclose(delay, value, rel_tol=1e-6, abs_tol=1e-9) for value in allowed):
                outputs = system.get_output_port(o, False).get_name()
                yield warning(
                    "delay-differs",
                    f"{path}.{outputs}" if path else outputs,
                    f"sample_delay says {delay:g} s, but run alone it takes {clean(whole):g} s; correct one of them",
                )


def _way_inside(hops: Hops, path: str, input_index: int, output_index: int) -> list[Hop] | None:
    wiring = hops.wiring
    starts = list(wiring.inner_inputs(Port(path, input_index)))
    if starts == [Port(path, input_index)]:  # a block, where only the one hop is meant
        return next(([hop] for hop in hops.through(starts[0]) if hop.output == output_index), None)
    return hops.shortest(starts, wiring.origin(Port(path, output_index)), inside=path)


def _measured(values: StartValues, hops: Hops, hop: Hop) -> float | None:
    """What a reader of the block's own period sees [s]; None when the block cannot be run alone."""
    if hop.event is None:
        return hops.declared(hop.block, hop.input, hop.output) or 0.0
    samples = samples_through(values, hop)
    return None if samples is None else samples * hop.event.period

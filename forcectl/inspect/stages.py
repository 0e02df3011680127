"""The delay of each block on a signal path: declared by the block, measured by running it alone, or assumed.

A block or a nested diagram may declare `sample_delay`, {(input, output): seconds}. For a block that holds its output
over a sample, it is the whole period. The last sample is not counted for a block with an unrestricted update, nor for
the exact discretisation of a continuous filter: that it responds first at the next tick is its dynamics, not a delay.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.schedule import Stage, schedule
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.ways import Hop, Hops, declared_delays
from forcectl.inspect.wiring import is_vector

_MOST_SAMPLES = 200
_STEPS = (1.0, -1.0, 1e-3)  # sizes of the disturbance, of which one should be outside of dead zones and saturation


def stages_of(values: StartValues, hops: Hops, way: list[Hop]) -> list[Stage]:
    """One stage per block, or one for a nested diagram that declares the delay between its ports."""
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
    source, output = (hops.wiring.port(port).get_name() for port in (hop.input, hop.output))
    stage = Stage(hop.block, source, output, hop.kind, "structure")
    declared = hops.declared(hop.input, hop.output)
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
    """The outermost nested diagram that declares the delay of a part of the path from `start`, and the end of it."""
    wiring = hops.wiring
    for path in wiring.parents(way[start].block):
        for (reader, output), delay in declared_delays(wiring, path).items():
            if way[start].input not in wiring.inner_inputs(reader):
                continue
            for end in range(start, len(way)):
                if path not in wiring.parents(way[end].block):
                    break
                if way[end].output == wiring.source(output):
                    event = next((hop.event for hop in way[start : end + 1] if hop.event is not None), None)
                    kind = "fixed" if event is None else event.kind
                    samples = 0 if event is None else round(delay / event.period)
                    source, target = (wiring.port(port).get_name() for port in (reader, output))
                    return Stage(path, source, target, kind, "declared", event, samples, delay), end + 1
    return None


def samples_through(values: StartValues, hop: Hop) -> int | None:
    """Samples from a change at the input to the first change at the output that a reader of the same period samples.

    Two copies of the block run from the same start, one with its input disturbed. Other inputs have the values at the
    start of the diagram, and also zero in further runs, as the start values may keep the block in saturation. The
    smallest count is returned. None: no change within 200 samples, or the block cannot run alone.
    """
    if hop.event is None or isinstance(values.wiring.systems[hop.block], MultibodyPlant):
        return None
    if not all(is_vector(values.wiring.port(port)) for port in (hop.input, hop.output)):
        return None
    least = _least(values, hop, hop.event, at_zero=False)
    if least == 1:
        return least
    return min(filter(None, (least, _least(values, hop, hop.event, at_zero=True))), default=None)


def _least(values: StartValues, hop: Hop, event: PeriodicEvent, at_zero: bool) -> int | None:
    try:
        return min((n for step in _STEPS if (n := _count(values, hop, event, step, at_zero)) is not None), default=None)
    except FAILURES:
        return None


def _count(values: StartValues, hop: Hop, event: PeriodicEvent, step: float, at_zero: bool) -> int | None:
    plain, disturbed = values.block_context(hop.block), values.block_context(hop.block)
    port, output = values.wiring.port(hop.input), values.wiring.port(hop.output)
    for context in (plain, disturbed) if at_zero else ():
        for reader in map(values.wiring.port, values.wiring.inputs(hop.block)):
            if is_vector(reader) and reader.HasValue(context):
                reader.FixValue(context, np.zeros(reader.size()))
    port.FixValue(disturbed, port.Eval(plain) + step)
    runs = [Simulator(values.wiring.systems[hop.block], context) for context in (plain, disturbed)]
    for run in runs:
        run.Initialize()
    for sample in range(1, _MOST_SAMPLES + 1):
        for run in runs:
            run.AdvanceTo(event.offset + sample * event.period)
        a, b = (output.Eval(run.get_context()) for run in runs)
        if not np.array_equal(a, b, equal_nan=True):
            return sample
    return None

"""Findings about delays: undeclared ones, and those that differ from the declared or the expected delay."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import DiscreteTimeDelay

from forcectl.doctor.report import Finding, error, warning
from forcectl.inspect.delay import DelayChain
from forcectl.inspect.schedule import clean
from forcectl.inspect.stages import samples_through
from forcectl.inspect.start import StartValues
from forcectl.inspect.ways import Hop, Hops, declared_delays
from forcectl.inspect.wiring import PortAddress


def chain_findings(values: StartValues, chain: DelayChain, expected: float | None) -> Iterator[Finding]:
    """More than one undeclared hold on the signal path, and a total delay that is not the expected one."""
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


def declared_findings(values: StartValues, hops: Hops) -> Iterator[Finding]:
    """Every `sample_delay` of every block and nested diagram that differs from the measured delay."""
    wiring = hops.wiring
    for path, system in wiring.systems.items():
        if not path and not isinstance(system, Diagram):
            continue  # a single block is also listed under its name
        table = getattr(system, "sample_delay", {})
        known = declared_delays(wiring, path)
        if len(known) < len(table):
            yield error(
                "sample-delay-ports", path, f"sample_delay names ports that the block does not have: {sorted(table)}"
            )
        for (reader, output), delay in known.items():
            way = _way_inside(hops, reader, output)
            if way is None:
                yield warning(
                    "delay-differs", path, f"sample_delay of ports without a signal path between them: {sorted(table)}"
                )
                continue
            found = [part for hop in way if (part := _measured(values, hops, hop)) is not None]
            if len(found) < len(way):
                continue  # a block that cannot be run alone: nothing to compare with
            whole = sum(found)
            periods = [hop.event.period for hop in way if hop.event is not None]
            # Each sampled block may leave out its last sample, see `forcectl.inspect.stages`.
            allowed = [whole - sum(periods[:n]) for n in range(len(periods) + 1)]
            if not any(math.isclose(delay, value, rel_tol=1e-6, abs_tol=1e-9) for value in allowed):
                yield warning(
                    "delay-differs",
                    wiring.name(output),
                    f"sample_delay declares {delay:g} s, but {clean(whole):g} s are measured; correct one of them",
                )


def _way_inside(hops: Hops, reader: PortAddress, output: PortAddress) -> list[Hop] | None:
    starts = list(hops.wiring.inner_inputs(reader))
    if starts == [reader]:  # a block: only the hop through it
        return next(([hop] for hop in hops.through(reader, output) if hop.output == output), None)
    end = hops.wiring.source(output)
    return None if end is None else hops.shortest(starts, end, inside=reader.system)


def _measured(values: StartValues, hops: Hops, hop: Hop) -> float | None:
    """The delay for a reader of the block's own period [s]; None when the block cannot run alone."""
    if hop.event is None:
        return hops.declared(hop.input, hop.output) or 0.0
    samples = samples_through(values, hop)
    return None if samples is None else samples * hop.event.period

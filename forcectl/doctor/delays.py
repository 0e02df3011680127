"""Delays that were not declared, that differ from what was declared, or from what is expected."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import DiscreteTimeDelay

from forcectl.doctor.report import Finding, error, warning
from forcectl.inspect.delay import DelayChain
from forcectl.inspect.probe import samples_through
from forcectl.inspect.schedule import clean
from forcectl.inspect.start import StartValues
from forcectl.inspect.ways import Hop, Hops, declared_delays
from forcectl.inspect.wiring import PortAddress


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


def declared_findings(values: StartValues, hops: Hops) -> Iterator[Finding]:
    """Every `sample_delay` of every block and nested diagram, compared with what it really does."""
    wiring = hops.wiring
    for path, system in wiring.systems.items():
        if not path and not isinstance(system, Diagram):
            continue  # a single block stands in the list under its own name as well
        table = getattr(system, "sample_delay", {})
        known = declared_delays(system)
        if len(known) < len(table):
            yield error("sample-delay-ports", path, f"sample_delay names ports that the block has not: {sorted(table)}")
        for (i, o), delay in known.items():
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
    starts = list(wiring.inner_inputs(PortAddress(path, input_index)))
    if starts == [PortAddress(path, input_index)]:  # a block, where only the one hop is meant
        return next(([hop] for hop in hops.through(starts[0]) if hop.output == output_index), None)
    return hops.shortest(starts, wiring.origin(PortAddress(path, output_index)), inside=path)


def _measured(values: StartValues, hops: Hops, hop: Hop) -> float | None:
    """What a reader of the block's own period sees [s]; None when the block cannot be run alone."""
    if hop.event is None:
        return hops.declared(hop.block, hop.input, hop.output) or 0.0
    samples = samples_through(values, hop)
    return None if samples is None else samples * hop.event.period

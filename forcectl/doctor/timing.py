"""Findings about sample periods that are no multiples of each other, and about blocks whose updates fail."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from forcectl.doctor.report import Finding, error, info, warning
from forcectl.doctor.values import LONGEST
from forcectl.errors import raised
from forcectl.framework.wiring import optional_inputs
from forcectl.inspect.events import PeriodicEvent, Timing
from forcectl.inspect.start import StartValues


def failed_updates(values: StartValues, timing: Timing) -> Iterator[Finding]:
    """Blocks that could not run alone, because of an error in them or a missing input."""
    for path, failure in timing.failures.items():
        system, context = values.wiring.systems[path], values.block_context(path)
        ports = (system.get_input_port(i, False) for i in range(system.num_input_ports()))
        open_ports = [port.get_name() for port in ports if not port.HasValue(context)]
        missing = [name for name in open_ports if name not in optional_inputs(system)]
        if missing:
            text = f"could not be run to see its events: no value at {', '.join(missing)}"
            yield info("timing-unknown", path, text)
            continue
        text = "its updates fail when the block runs alone from its start values"
        yield error("update-raises", path, f"{text}: {raised(failure, LONGEST)}")


def timing_findings(events: tuple[PeriodicEvent, ...]) -> Iterator[Finding]:
    """Periods that do not divide each other, and offsets that never coincide; only an info for publish events."""
    seen: dict[tuple[bool, float, float], PeriodicEvent] = {}
    for event in events:
        seen.setdefault((event.kind == "publish", event.period, event.offset), event)
    for first, second in itertools.combinations(seen.values(), 2):
        yield from _compare(first, second)


def _compare(a: PeriodicEvent, b: PeriodicEvent) -> Iterator[Finding]:
    finding = info if "publish" in (a.kind, b.kind) else warning
    where = f"{a.block}, {b.block}"
    slow, fast = max(a.period, b.period), min(a.period, b.period)
    ratio = slow / fast
    if abs(ratio - round(ratio)) > 1e-6 * ratio:
        yield finding(
            "periods-do-not-divide",
            where,
            f"periods {a.period:g} s and {b.period:g} s: {slow:g}/{fast:g} = {ratio:.6g} is no whole number, so the "
            f"samples drift against each other; {round(ratio)} x {fast:g} = {round(ratio) * fast:g} s would divide",
        )
        return
    shift = (a.offset - b.offset) / fast
    if abs(shift - round(shift)) > 1e-6:
        yield finding(
            "offsets-differ",
            where,
            f"offsets {a.offset:g} s and {b.offset:g} s at periods {a.period:g} s and {b.period:g} s never meet at one "
            "instant; use the same offset unless the delay in between is meant",
        )

"""The check that every output is a finite number at the start."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forcectl.doctor.report import Finding, error, info
from forcectl.errors import raised
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import PortAddress, Wiring, context_of, is_vector

LONGEST = 220  # largest length of an error text in a finding


def non_finite_outputs(values: StartValues) -> Iterator[Finding]:
    """Vector outputs that are not finite, or cannot be computed, at t = 0 in the default context.

    The block in which a NaN originates is an error; blocks that only pass it on are an info.
    """
    wiring, root = values.wiring, values.root
    if root is None:
        return
    bad: dict[PortAddress, str] = {}
    for path, system in wiring.leaves():
        context = context_of(system, wiring.root, root)
        for output in wiring.outputs(path):
            port = wiring.port(output)
            if not is_vector(port):
                continue
            try:
                value = port.Eval(context)
            except FAILURES as failure:
                bad[output] = f"cannot be computed at t = 0: {raised(failure, LONGEST)}"
                continue
            if not np.all(np.isfinite(value)):
                bad[output] = f"is not finite at t = 0: {np.array2string(np.asarray(value), threshold=8)}"
    for output, what in bad.items():
        yield _judge(wiring, bad, output, what)


def _judge(wiring: Wiring, bad: dict[PortAddress, str], output: PortAddress, what: str) -> Finding:
    sources = {reader: wiring.source(reader) for reader in wiring.passed(output)}
    name = wiring.name(output)
    for source in sources.values():
        if source in bad:
            return info("passes-on", name, f"{what}; comes from {wiring.name(source)}")
    if what.startswith("is not"):
        return error("non-finite-output", name, f"{what}; outputs must start finite")
    # A block with an unconnected abstract input cannot be evaluated; the input itself is reported elsewhere.
    open_abstract = [
        wiring.name(reader) for reader, source in sources.items()
        if not is_vector(wiring.port(reader)) and (source is None or not source.system)
    ]  # fmt: skip
    if open_abstract:
        return info("not-computed", name, f"not examined: {', '.join(open_abstract)} not connected")
    return error("output-raises", name, what)

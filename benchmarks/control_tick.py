"""Time per control tick: the closed loops advanced tick by tick, 2 ms each, as a real-time program would.

What is timed is one `AdvanceTo` from Python, the call itself included (nothing is subtracted), log included. The first
half second is left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

TICKS, SKIPPED = 1000, 250


def benchmark(repeats: int) -> Iterator[Row]:
    import numpy as np
    from pydrake.systems.analysis import Simulator

    from benchmarks._loops import SHIPPED_FIDELITIES, build

    for fidelity in SHIPPED_FIDELITIES:
        spent = np.empty((repeats, TICKS))
        for row in spent:
            loop = build(fidelity)
            simulator = Simulator(loop.diagram)
            simulator.Initialize()
            simulator.AdvanceTo(SKIPPED * loop.period)
            for k in range(TICKS):
                started = time.perf_counter()
                simulator.AdvanceTo((SKIPPED + k + 1) * loop.period)
                row[k] = time.perf_counter() - started
        p50, p99 = (float(np.median(np.percentile(spent, share, axis=1))) for share in (50, 99))
        note = f"{TICKS} ticks, median of {repeats} runs"
        yield Row(f"{fidelity}, p50", 1e6 * p50, "us", note=note)
        yield Row(f"{fidelity}, p99", 1e6 * p99, "us", note="a tick is 2000 us")


if __name__ == "__main__":
    main("Time per control tick", benchmark, repeats=3)

"""Memory over a long run: resident size of the process from one simulated minute to the tenth.

The log is taken out every quarter of a second, as `forcectl run` does; what it takes out is thrown away here, so that
growth is the simulation's own. FORCECTL_BENCHMARK_FIDELITY=Multibody measures that one, which takes minutes.
"""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

MINUTES = 10
CHUNK = 0.25  # [s]


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def benchmark(repeats: int) -> Iterator[Row]:
    from pydrake.systems.analysis import Simulator

    from benchmarks._loops import build

    fidelity = os.environ.get("FORCECTL_BENCHMARK_FIDELITY", "Kinematic")
    loop = build(fidelity)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    sizes = []
    for _ in range(MINUTES):
        for _ in range(round(60 / CHUNK)):
            simulator.AdvanceTo(simulator.get_context().get_time() + CHUNK)
            loop.sink.FindMutableLog(simulator.get_mutable_context()).Clear()
        sizes.append(_resident_mb())
    yield Row(f"{fidelity}, resident after a minute", sizes[0], "MB")
    yield Row(f"{fidelity}, resident after {MINUTES} minutes", sizes[-1], "MB")
    yield Row(f"{fidelity}, growth in between", sizes[-1] - sizes[0], "MB", "<= 1", note="flat")


if __name__ == "__main__":
    main("Memory over ten simulated minutes", benchmark, repeats=1)

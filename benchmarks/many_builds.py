"""Memory over many builds and short runs in one process: growth of the resident size after three that warm up.

FORCECTL_BENCHMARK_BUILDS says how many there are of each experiment (default 20; 200 take minutes).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

EXPERIMENTS = (("fig_2_7", "OneDimensional"), ("fig_2_7", "Multibody"), ("fig_5_3", None), ("peg_in_hole", None))


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.scenario.scenario import build, load_scenario
    from forcectl.testing import assert_memory_released

    builds = int(os.environ.get("FORCECTL_BENCHMARK_BUILDS", "20"))
    for experiment, fidelity in EXPERIMENTS:
        scenario = load_scenario(experiment, fidelity=fidelity)
        record = assert_memory_released(
            lambda scenario=scenario: build(scenario).diagram, duration=0.05, builds=builds, allowed_kb=float("inf")
        )
        name = " ".join(filter(None, (experiment, fidelity)))
        yield Row(f"{name}, growth per build", record.growth_kb, "kB", "<= 500", note=f"{record.systems} systems")


if __name__ == "__main__":
    main("Memory over many builds", benchmark, repeats=1)

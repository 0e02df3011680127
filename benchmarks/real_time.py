"""Real-time factor: simulated seconds per second of computing, log included, building not.

Pressing with 15 N from the first touch, for some seconds, start-up of the run included.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

BATCH = 200
DURATION = 5.0  # [s]
REQUIRED = {"OneDimensional": "", "Kinematic": ">= 30", "Multibody": ">= 5"}
GOAL = {"Multibody": "15"}


def benchmark(repeats: int) -> Iterator[Row]:
    from benchmarks._loops import SHIPPED_FIDELITIES, build, build_scalar, runner

    linear, sticking, elements, linear_batch = interleaved_medians(
        [
            runner(build_scalar(linear=True).diagram, DURATION),
            runner(build_scalar().diagram, DURATION),
            runner(build_scalar(BATCH).diagram, DURATION),
            runner(build_scalar(BATCH, linear=True).diagram, DURATION),
        ],
        repeats,
    )
    yield Row("1-D loop, linear", DURATION / linear, "x real time", ">= 150")
    yield Row("1-D loop, sticking friction, noise", DURATION / sticking, "x real time", ">= 50")
    yield Row(
        f"a batch of {BATCH}, cost of one element", elements / sticking, "x", note="one diagram, sticking friction"
    )
    yield Row(f"a batch of {BATCH}, per element", BATCH * DURATION / elements, "x real time")
    yield Row(f"a linear batch of {BATCH}, per element", BATCH * DURATION / linear_batch, "x real time")
    times = interleaved_medians([runner(build(fidelity).diagram, DURATION) for fidelity in SHIPPED_FIDELITIES], repeats)
    for fidelity, spent in zip(SHIPPED_FIDELITIES, times, strict=True):
        goal = GOAL.get(fidelity, "")
        yield Row(f"{fidelity} closed loop", DURATION / spent, "x real time", REQUIRED[fidelity], goal)


if __name__ == "__main__":
    main("Real-time factor", benchmark)

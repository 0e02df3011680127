"""Sweeps: cost per trial beyond its own simulation, two processes against one, start and memory of a large plan.

The overhead is the time of a sweep of short trials in one process, less the same scenarios resolved, built and run one
after the other by hand. Times of the machine are elapsed times: run this when nothing else runs.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main, seconds

STIFFNESS = "station.environment.stiffness"
TRIALS = 40


def _sweep(count: int, fidelity: str, duration: float) -> dict[str, Any]:
    return {
        "scenario": "fig_2_8",
        "overrides": {"station.fidelity": fidelity, "duration": duration},
        "keys": {STIFFNESS: [5e3 + 10 * i for i in range(count)]},
    }


def _run(sweep: dict[str, Any], **options: Any) -> float:
    """Without a directory there is no report, which is not what is measured."""
    from forcectl.sweeps.run_sweep import sweep as run

    return seconds(lambda: run(sweep, **options))


def _by_hand(count: int, duration: float) -> None:
    from forcectl.runs.simulate import simulate
    from forcectl.scenario.scenario import as_file, build, resolve

    file = as_file("fig_2_8")
    for i in range(count):
        changes = {"station.fidelity": "OneDimensional", "duration": duration, STIFFNESS: 5e3 + 10 * i}
        scenario = resolve(file, overrides=changes)
        simulate(scenario, build(scenario), "default")


_LARGE = """
import resource, sys, time
started = time.perf_counter()
from forcectl.sweeps import run_sweep
from forcectl.sweeps.at_work import SweepRun
class Started(Exception): pass
def stop(self, engine): raise Started
SweepRun.all = stop
sweep = {"scenario": "fig_2_8", "overrides": {"station.fidelity": "OneDimensional"}, "design": "random",
         "trials": 100_000, "keys": {"station.environment.stiffness": __import__("pydrake.common.schema",
         fromlist=["Uniform"]).Uniform(1e3, 1e6)}}
try:
    run_sweep.sweep(sweep, out=sys.argv[1], engine="sequential")
except Started:
    pass
scale = 1 if sys.platform == "darwin" else 1024
print(time.perf_counter() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / 1e6)
"""


def benchmark(repeats: int) -> Iterator[Row]:
    sweep = _sweep(TRIALS, "OneDimensional", 1.0)
    _by_hand(2, 1.0)
    pairs = [(seconds(lambda: _by_hand(TRIALS, 1.0)), _run(sweep, engine="sequential")) for _ in range(repeats)]
    floor, whole = min(a for a, _ in pairs), min(b for _, b in pairs)
    yield Row("a trial of 1 s, 1-D, by hand", 1e3 * floor / TRIALS, "ms")
    yield Row("overhead per trial, sequential", 1e3 * (whole - floor) / TRIALS, "ms", "<= 20")
    multibody = _sweep(24, "Multibody", 2.0)
    one, two = (min(_run(multibody, workers=n) for _ in range(repeats)) for n in (1, 2))
    short = _sweep(2, "Multibody", 0.1)
    start = _run(short, workers=2)
    yield Row("start and end with processes", start, "s")
    yield Row("24 multibody trials of 2 s, two processes against one", (one - start) / (two - start), "", ">= 1.8")
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _LARGE, str(Path(folder) / "out")]
        told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    yield Row("start of 100 000 planned trials", float(told[0]), "s", "<= 10")
    yield Row("memory of the coordinator then", float(told[1]), "MB", "<= 500")


if __name__ == "__main__":
    main("Sweeps", benchmark, repeats=2)

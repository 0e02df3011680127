"""Sweeps: cost per trial beyond its own simulation, two processes against one, batches, a large plan.

The overhead is the time of a sweep of short trials, times the processes, less the same scenarios resolved, built and
run one after the other by hand. The floor of a batch is its equations in NumPy, without Drake. Times of the machine are
elapsed times: run this when nothing else runs.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._loops import build_scalar, runner
from benchmarks._measure import Row, main, seconds

STIFFNESS = "station.environment.stiffness"
TRIALS = 40


def _sweep(count: int, fidelity: str, duration: float) -> dict[str, Any]:
    return {
        "scenario": "fig_2_8",
        "overrides": {"station.fidelity": fidelity, "duration": duration},
        "keys": {STIFFNESS: [5e3 + 10 * i for i in range(count)]},
        "batches": False,
    }


def _linear(count: int) -> dict[str, Any]:
    """Linear runs of 5 s."""
    changes = {
        "station.fidelity": "OneDimensional",
        "duration": 5.0,
        "station.environment.one_sided": False,
        "station.drive.servo.ideal": True,
        "station.sensors.force.noise_std": 0.0,
        "station.sensors.force.quantum": 0.0,
        "station.sensors.force.range": np.inf,
    }
    stiffness = np.geomspace(1e3, 1e5, count).tolist()
    return {"scenario": "fig_2_8", "overrides": changes, "keys": {STIFFNESS: stiffness}}


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


def _equations(size: int, duration: float) -> None:
    """A linear batch in NumPy: filter of the command, spring, filter of the sensor, integral law."""
    from forcectl.plant.drives.position_loop import second_order, zero_order_hold
    from forcectl.plant.sensors.force_sensor import filter_matrices

    period = 0.002
    a, b = zero_order_hold(*second_order(75.4, 1.0), period)
    f, g, _, d = filter_matrices(12.6, 1.0, period)
    gain = 1e-4 * 1.5 * period * np.ones(size)
    x, late, y, command = np.zeros((2, size)), np.zeros(size), np.zeros((2, size)), np.zeros(size)
    for _ in range(round(duration / period)):
        force = -1e4 * x[0]
        measured = y[0] + d * force
        y = f @ y + g * force
        x, late = a @ x + b * late, command
        command = command - gain * (15.0 - measured)


def _batch(size: int, duration: float, linear: bool) -> float:
    """Computing time of a batch [s]."""
    run = runner(build_scalar(size, linear).diagram, duration)
    run()
    return seconds(run)


def _through_dask(sweep: dict[str, Any], few: dict[str, Any]) -> float:
    """Elapsed time of a sweep on two workers of a Dask scheduler [s], less that of few of its trials."""
    import distributed

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        _run(few, scheduler=cluster.scheduler_address)  # workers import what they need
        short, whole = (_run(each, scheduler=cluster.scheduler_address) for each in (few, sweep))
    return whole - short


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
    # First: a process is said to have had the memory of the one that started it.
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _LARGE, str(Path(folder) / "out")]
        told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    yield Row("start of 100 000 planned trials", float(told[0]), "s", "<= 10")
    yield Row("memory of the coordinator then", float(told[1]), "MB", "<= 500")
    sweep = _sweep(TRIALS, "OneDimensional", 1.0)
    _by_hand(2, 1.0)
    pairs = [(seconds(lambda: _by_hand(TRIALS, 1.0)), _run(sweep, engine="sequential")) for _ in range(repeats)]
    floor, whole = min(a for a, _ in pairs), min(b for _, b in pairs)
    yield Row("a trial of 1 s, 1-D, by hand", 1e3 * floor / TRIALS, "ms")
    yield Row("overhead per trial, sequential", 1e3 * (whole - floor) / TRIALS, "ms", "<= 20")
    few = _sweep(4, "OneDimensional", 1.0)
    there = min(_through_dask(sweep, few) for _ in range(repeats)) * 2 / (TRIALS - 4)
    yield Row("overhead per trial, two workers of a Dask scheduler", 1e3 * (there - floor / TRIALS), "ms", "<= 50")
    yield Row("200 linear elements, 10 s, in NumPy alone", seconds(lambda: _equations(200, 10.0)), "s")
    yield Row("200 linear elements, 10 s", min(_batch(200, 10.0, True) for _ in range(repeats)), "s", "<= 0.45")
    for name, linear in (("linear", True), ("with friction and noise", False)):
        costs = [min(_batch(n, 2.0, linear) for _ in range(repeats)) / n for n in (50, 500, 2000)]
        told = f"an element of 500 and of 2000 against one of 50, {name}"
        yield Row(told, max(costs[1:]) / costs[0], "", "<= 1")
    yield Row("2000 linear trials of 5 s, one process", _run(_linear(2000), workers=1), "s", "<= 30")
    alone = _run(_linear(80) | {"batches": False}, workers=2) - _run(_linear(8) | {"batches": False}, workers=2)
    yield Row("the same without batches, two processes (72 of them)", 2000 / 72 * alone, "s", "<= 480")
    multibody = _sweep(24, "Multibody", 2.0)
    one, two = (min(_run(multibody, workers=n) for _ in range(repeats)) for n in (1, 2))
    short = _sweep(2, "Multibody", 0.1)
    start = _run(short, workers=2)
    yield Row("start and end with processes", start, "s")
    yield Row("24 multibody trials of 2 s, two processes against one", (one - start) / (two - start), "", ">= 1.8")


if __name__ == "__main__":
    main("Sweeps", benchmark, repeats=2)

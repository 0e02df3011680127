"""Simulating one variant: build, advance piece by piece, watch the log, measure the speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from forcectl.diagrams.closed_loop import ClosedLoop
from forcectl.simulation.logs import ChunkedLog, first_fault, to_dataset
from forcectl.simulation.metrics import metrics_of
from forcectl.simulation.scenario import Scenario

CHUNK = 0.25  # [s] of simulated time between two looks at the log
FORCE_LIMIT = 10.0  # a contact force above this many sensor ranges is a diverging run


@dataclass(frozen=True)
class Outcome:
    """One simulated variant. `failure` says why it had to stop; the log then ends there and `metrics` is empty."""

    variant: str
    log: xr.Dataset
    metrics: dict[str, float | None]
    failure: str | None
    diagram: Diagram | None  # None when it came from another process


def simulate(
    scenario: Scenario,
    loop: ClosedLoop,
    variant: str,
    realtime_rate: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> Outcome:
    """Simulate a scenario.

    Args:
        scenario: complete (see `load_scenario`). loop: what `build` made of it.
        variant: its name, for the log.
        realtime_rate: at most this many simulated seconds per second; 0: as fast as possible.
        progress: called with the variant and the share done, after every `CHUNK`.
    """
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    simulator.set_target_realtime_rate(realtime_rate)
    log = ChunkedLog()
    limits = {"contact_force": FORCE_LIMIT * scenario.station.force_sensor.range}
    count = max(1, int(np.ceil(scenario.duration / CHUNK - 1e-9)))
    failure, computing = None, 0.0
    for i in range(1, count + 1):
        failure, seconds = _advance(simulator, min(i * CHUNK, scenario.duration), initialize=i == 1)
        computing += seconds
        times, values = log.take(loop.sink.FindMutableLog(context))
        fault = first_fault(times, values, loop.signals, limits)
        if fault is not None:
            name, when, value = fault
            what = "is not a number" if np.isnan(value) else f"diverges ({value:.4g} {loop.signals[name].unit})"
            failure = f"{name} {what} at t = {when:.4f} s"
        if progress:
            progress(variant, i / count)
        if failure is not None:
            break
    times, values = log.samples()
    bandwidth = scenario.reference_model if scenario.reference_model is not None else loop.reference_model_bandwidth
    dataset = to_dataset(times, values, loop.signals, variant, bandwidth or None)
    metrics: dict[str, float | None] = {}
    if failure is None:
        factor = scenario.duration / computing if computing > 0 else None
        metrics = metrics_of(dataset, window=scenario.model_error_window, realtime_factor=factor)
    return Outcome(variant, dataset, metrics, failure, loop.diagram)


def _advance(simulator: Simulator, until: float, initialize: bool) -> tuple[str | None, float]:
    """Advance to `until` [s]; returns why it could not (or None), and the computing time [s]."""
    started = time.perf_counter()
    try:
        if initialize:
            simulator.Initialize()
            started = time.perf_counter()
        simulator.AdvanceTo(until)
    except RuntimeError as error:  # Drake's solvers give up this way, for example "SAP solver failed to converge"
        reason = " ".join(str(error).split())
        now = simulator.get_context().get_time()
        return f"solver failed at t = {now:.4f} s: {reason[:200]}", time.perf_counter() - started
    return None, time.perf_counter() - started

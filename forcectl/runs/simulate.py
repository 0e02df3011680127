"""Simulating one variant: build, advance piece by piece, watch the log, measure the speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System

from forcectl.diagrams.loop import Loop
from forcectl.diagrams.model import Setting
from forcectl.errors import RunFailedError
from forcectl.runs.logs import ChunkedLog, first_fault, to_dataset
from forcectl.scenario.scenario import Scenario

Array = NDArray[np.float64]
CHUNK = 0.25  # [s] of simulated time between two looks at the log


@dataclass(frozen=True)
class VariantOutcome:
    """One simulated variant. `failure` says why it had to stop; the log then ends there and `metrics` is empty."""

    variant: str
    log: xr.Dataset
    metrics: dict[str, float | None]
    failure: str | None = None
    # The next two are None when the outcome comes from another process.
    diagram: Diagram | None = None
    cause: BaseException | None = None  # what a block or a solver raised


def simulate(
    scenario: Scenario,
    loop: Loop,
    variant: str,
    realtime_rate: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> VariantOutcome:
    """Simulate a scenario.

    Args:
        scenario: complete (see `load_scenario`).
        loop: what `build` made of it.
        variant: its name, for the log.
        realtime_rate: at most this many simulated seconds per second; 0: as fast as possible.
        progress: called with the variant and the share done, after every `CHUNK`.
    """
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    simulator.set_target_realtime_rate(realtime_rate)
    log = ChunkedLog()
    limits = scenario.limits()
    ends = ends_of_chunks(scenario.duration)
    failure, computing, ended, enough = None, 0.0, None, False
    for i, end in enumerate(ends):
        cause, seconds = advance(simulator, end)
        computing += seconds if i else 0.0  # the first one initializes
        times, values = log.take(loop.sink.FindMutableLog(context))
        fault = first_fault(times, values, loop.signals, limits, faulty=bool(scenario.station.faults))
        if fault is not None:
            name, when, value = fault
            failure = fault_of(name, when, value, loop.signals[name].unit)
            log.cut(when)
        elif cause is not None:
            failure = f"{_state_fault(loop.diagram, context)} at t = {context.get_time():.4f} s: {_reason(cause)}"
        elif scenario.after_end is not None:
            ended = _machine_end(times, values, loop.signals) if ended is None else ended
            if enough := ended is not None and ended + scenario.after_end < end:
                log.cut(ended + scenario.after_end)
        if progress:
            progress(variant, 1.0 if enough else i / (len(ends) - 1))
        if failure is not None or enough:
            break
    times, values = log.samples()
    bandwidth = scenario.model_bandwidth(loop.reference_model_bandwidth)
    dataset = to_dataset(times, values, loop.signals, variant, bandwidth, loop.derived(values))
    speed = end / computing if computing > 0 else None
    return judged(scenario, loop.setting, VariantOutcome(variant, dataset, {}, failure, loop.diagram, cause), speed)


def _machine_end(times: Array, values: Array, signals: Mapping[str, Any]) -> float | None:
    """When a state machine ended, if it did [s]."""
    if "machine_end" not in signals:
        return None
    ended = np.flatnonzero(values[signals["machine_end"].rows][0] > 0)
    return float(times[ended[0]]) if ended.size else None


def ends_of_chunks(duration: float) -> list[float]:
    """Times at which the log is looked at [s]: the start, every `CHUNK`, the end."""
    count = max(1, int(np.ceil(duration / CHUNK - 1e-9)))
    return [min(i * CHUNK, duration) for i in range(count + 1)]


def judged(scenario: Scenario, setting: Setting, outcome: VariantOutcome, speed: float | None) -> VariantOutcome:
    """An outcome with its metrics, unless it has failed.

    Args:
        scenario: that was simulated.
        setting: of its loop.
        outcome: without metrics.
        speed: simulated time over computing time [1].
    """
    if outcome.failure is not None:
        return outcome
    try:
        return replace(outcome, metrics=scenario.metrics(outcome.log, setting, speed))
    except RunFailedError as error:
        return replace(outcome, failure=str(error), cause=error)


def fault_of(name: str, when: float, value: float, unit: str) -> str:
    """What is said of a sample that no healthy run has, see `first_fault`."""
    what = "is not a number" if np.isnan(value) else f"diverges ({value:.4g} {unit})"
    return f"{name} {what} at t = {when:.4f} s"


def advance(simulator: Simulator, until: float) -> tuple[BaseException | None, float]:
    """Advance to `until` [s], 0: initialize; returns what stopped it (or None), and the computing time [s]."""
    started = time.perf_counter()
    try:
        if until == 0:
            simulator.Initialize()
        else:
            simulator.AdvanceTo(until)
    # Drake's solvers give up with a RuntimeError, its failed preconditions arrive as SystemExit, and a block of the
    # user's own may raise anything.
    except (Exception, SystemExit) as error:
        return error, time.perf_counter() - started
    return None, time.perf_counter() - started


def _reason(error: BaseException) -> str:
    text = " ".join(str(error).split())[:200]
    return text if isinstance(error, RuntimeError) and text else f"{type(error).__name__} {text}".strip()


def _state_fault(diagram: Diagram, context: Context) -> str:
    """Which block's state is not a finite number, in words; else that the simulation stopped."""
    for name, block in _blocks(diagram):
        own = block.GetMyContextFromRoot(context)
        groups = [own.get_discrete_state(i).value() for i in range(own.num_discrete_state_groups())]
        if not np.isfinite(np.concatenate([own.get_continuous_state_vector().CopyToVector(), *groups])).all():
            return f"state of {name} is not a finite number"
    return "simulation stopped"


def _blocks(diagram: Diagram, path: str = "") -> Iterator[tuple[str, System]]:
    for block in diagram.GetSystems():
        name = f"{path}{block.get_name()}"
        yield from _blocks(block, f"{name}/") if isinstance(block, Diagram) else [(name, block)]

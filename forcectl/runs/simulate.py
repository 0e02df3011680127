"""Simulating one variant: find its gains, build, advance in chunks, check the log, measure the speed."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System

from forcectl.analysis.findings.finding import RunFinding
from forcectl.arrays import Array
from forcectl.diagrams.loop import Loop
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError, RunFailedError, place_in_code
from forcectl.interrupts import Interrupts
from forcectl.runs.logs import ChunkedLog, first_fault, to_dataset
from forcectl.runs.probed import Probed
from forcectl.scenario.gains import FoundGains, asks_for_gains, identifications, text_of, with_gains
from forcectl.scenario.scenario import Scenario, build

CHUNK = 0.25  # [s] of simulated time between two checks of the log
FOUND: dict[str, dict[str, float | None]] = {}  # text of an experiment that finds gains -> its metrics, in this process
MOST_FOUND = 100  # entries that are kept
_NOT_CONVERGED, _ADVICE = "solver failed to converge", " Reasons for divergence"  # in a message of Drake's


@dataclass(frozen=True)
class VariantOutcome:
    """One simulated variant.

    Attributes:
        metrics, findings: of the log; empty after a failure.
        gains: found by an experiment before the run, see `found_gains`.
        failure: why it had to stop; the log then ends there.
        interrupted: by Ctrl-C; `failure` then says when.
        realtime_factor: simulated time divided by computing time [1]; None where several were computed at once.
        diagram: None when the outcome comes from another process.
        cause: exception of a block or a solver; None when the outcome comes from another process.
    """

    variant: str
    log: xr.Dataset
    metrics: dict[str, float | None] = field(default_factory=dict)
    findings: list[RunFinding] = field(default_factory=list)
    gains: list[FoundGains] = field(default_factory=list)
    failure: str | None = None
    interrupted: bool = False
    realtime_factor: float | None = None
    diagram: Diagram | None = None
    cause: BaseException | None = None


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
        loop: what `build` made of it; where gains have to be found first, another one is built with them.
        variant: its name, for the log.
        realtime_rate: at most this many simulated seconds per second; 0: as fast as possible.
        progress: called with the variant and the share done, after every `CHUNK`.

    Ctrl-C ends the simulation: the outcome is then `interrupted`, with the log up to there.

    Raises:
        RunFailedError: the experiment that is to find gains fails.
        KeyboardInterrupt: Ctrl-C while gains are found.
    """
    if asks_for_gains(scenario):
        gains = found_gains(scenario, progress and (lambda name, share: progress(variant, 0.0)))
        tuned = with_gains(scenario, gains)
        return replace(simulate(tuned, build(tuned), variant, realtime_rate, progress), gains=gains)
    with Interrupts(held=True) as interrupts:
        outcome = _simulated(scenario, loop, variant, realtime_rate, progress, interrupts)
        if interrupts.asked and not interrupts.handled:  # after the last step: the log is kept
            interrupts.handled = True
            if outcome.failure is None:
                failure = f"interrupted at t = {float(outcome.log['time'][-1]):.3f} s"
                outcome = replace(outcome, failure=failure, interrupted=True)
        return outcome


def found_gains(scenario: Scenario, progress: Callable[[str, float], None] | None = None) -> list[FoundGains]:
    """The gains that experiments find for the laws of a scenario; an experiment is simulated once in a process.

    Args:
        scenario: complete.
        progress: called now and then.

    Raises:
        RunFailedError: an experiment had to stop, or found no gains that the law can use.
        KeyboardInterrupt: Ctrl-C.
    """
    gains = []
    for one in identifications(scenario, scenario.experiment):
        text = text_of(one.scenario)
        metrics = FOUND.get(text)
        if metrics is None:
            outcome = simulate(one.scenario, build(one.scenario), one.experiment, progress=progress)
            if outcome.interrupted:
                raise KeyboardInterrupt
            if outcome.failure is not None:
                raise RunFailedError(f"gains of {one.key} from {one.experiment}: {outcome.failure}") from outcome.cause
            metrics = outcome.metrics
            if text:
                FOUND[text] = metrics
            if len(FOUND) > MOST_FOUND:
                del FOUND[next(iter(FOUND))]
        values = {name: metrics.get(name) for name in one.names}
        found = {name: one.scale * value for name, value in values.items() if value is not None}
        if len(found) < len(values) or not any(found.values()):
            raise RunFailedError(f"gains of {one.key}: {one.experiment} finds none on this station: {values}")
        gains.append(FoundGains(one.key, one.experiment, found))
    try:
        with_gains(scenario, gains)
    except BadInputError as error:
        raise RunFailedError(str(error)) from error
    return gains


def _simulated(
    scenario: Scenario,
    loop: Loop,
    variant: str,
    realtime_rate: float,
    progress: Callable[[str, float], None] | None,
    interrupts: Interrupts,
) -> VariantOutcome:
    """`simulate` with interrupts held; only while Drake advances they are let through."""
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    simulator.set_target_realtime_rate(realtime_rate)
    log = ChunkedLog()
    probed = Probed(loop, simulator)
    limits = scenario.limits()
    ends = ends_of_chunks(scenario.duration)
    failure, computing, ended, enough = None, 0.0, None, False
    for i, end in enumerate(ends):
        cause, seconds = advance(simulator, end, interrupts)
        computing += seconds if i else 0.0  # the first one initializes
        times, values = log.take(loop.sink.FindMutableLog(context))
        fault = first_fault(times, values, loop.signals, limits, faulty=scenario.station.fails())
        if isinstance(cause, KeyboardInterrupt):
            failure = f"interrupted at t = {times[-1] if times.size else ends[max(i - 1, 0)]:.3f} s"
        elif fault is not None:
            name, when, value = fault
            failure = fault_of(name, when, value, loop.signals[name].unit)
            log.cut(when)
        elif cause is not None:
            failure = why_stopped(loop.diagram, context, cause)
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
    probes = probed.samples(times)
    further = probes | loop.derived(values, probes)
    dataset = to_dataset(times, values, loop.signals, variant, bandwidth, further)
    speed = end / computing if computing > 0 else None
    interrupts.handled = isinstance(cause, KeyboardInterrupt)
    outcome = VariantOutcome(
        variant,
        dataset,
        failure=failure,
        interrupted=interrupts.handled,
        realtime_factor=speed,
        diagram=loop.diagram,
        cause=cause,
    )
    return judged(scenario, loop.setting, outcome)


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


def judged(scenario: Scenario, setting: Setting, outcome: VariantOutcome) -> VariantOutcome:
    """An outcome with its metrics and findings, unless it has failed.

    Args:
        scenario: that was simulated.
        setting: of its loop.
        outcome: without metrics and findings.
    """
    if outcome.failure is not None:
        return outcome
    try:
        metrics = scenario.metrics(outcome.log, setting)
        return replace(outcome, metrics=metrics, findings=scenario.found(outcome.log, setting))
    except RunFailedError as error:
        return replace(outcome, failure=str(error), cause=error)


def fault_of(name: str, when: float, value: float, unit: str) -> str:
    """The text about a faulty sample, see `first_fault`."""
    what = "is not a number" if np.isnan(value) else f"diverges ({value:.4g} {unit})"
    return f"{name} {what} at t = {when:.4f} s"


def advance(
    simulator: Simulator, until: float, interrupts: Interrupts | None = None
) -> tuple[BaseException | None, float]:
    """Advance to `until` [s], 0: initialize; returns what stopped it (or None), and the computing time [s].

    Args:
        simulator: of a diagram.
        until: time at the end [s].
        interrupts: that are held; they are let through, and stop the advance.
    """
    started = time.perf_counter()
    try:
        with interrupts.let_through() if interrupts else contextlib.nullcontext():
            if until == 0:
                simulator.Initialize()
            else:
                simulator.AdvanceTo(until)
    except KeyboardInterrupt as error:
        if interrupts is None:
            raise
        return error, time.perf_counter() - started
    # Drake's solvers fail with a RuntimeError, its failed preconditions arrive as SystemExit, and a user's block
    # may raise anything.
    except BaseException as error:
        asked = interrupts is not None and interrupts.asked
        return KeyboardInterrupt() if asked else error, time.perf_counter() - started
    return None, time.perf_counter() - started


def why_stopped(diagram: Diagram, context: Context, error: BaseException) -> str:
    """The text about a simulation that an error stopped: block, time and error.

    Args:
        diagram: that was simulated.
        context: of the diagram, as the error left it.
        error: of a block or a solver.
    """
    text = " ".join(str(error).split())
    what = "simulation stopped"
    if name := next((name for name, block in _blocks(diagram) if not _is_sound(block, context)), ""):
        what = f"state of {name} is not a finite number"
    elif _NOT_CONVERGED in text:
        plants = [name for name, block in _blocks(diagram) if isinstance(block, MultibodyPlant)]
        what = f"contact solver of {', '.join(plants)} gave up"
    text = text.split(_ADVICE)[0][:200]
    reason = text if isinstance(error, RuntimeError) and text else f"{type(error).__name__} {text}".strip()
    return f"{what} at t = {context.get_time():.4f} s: {reason}{place_in_code(error)}"


def _is_sound(block: System, context: Context) -> bool:
    """Whether the state of a block is finite, except entries that are not so by default, which stand for "none"."""
    now, default = (_state(each) for each in (block.GetMyContextFromRoot(context), block.CreateDefaultContext()))
    return bool((np.isfinite(now) | ~np.isfinite(default)).all())


def _state(own: Context) -> Array:
    groups = [own.get_discrete_state(i).value() for i in range(own.num_discrete_state_groups())]
    return np.concatenate([own.get_continuous_state_vector().CopyToVector(), *groups])


def _blocks(diagram: Diagram, path: str = "") -> Iterator[tuple[str, System]]:
    for block in diagram.GetSystems():
        name = f"{path}{block.get_name()}"
        yield from _blocks(block, f"{name}/") if isinstance(block, Diagram) else [(name, block)]

"""Simulating one-dimensional scenarios as the elements of one batched diagram."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydrake.systems.analysis import Simulator

from forcectl.arrays import Array
from forcectl.conventions import unit_of
from forcectl.diagrams.log import LoggedLoop, LoggedSignal
from forcectl.diagrams.model import Setting
from forcectl.diagrams.one_dimensional_loop import build_one_dimensional_loop, is_scalar, scalar_loop
from forcectl.errors import RunFailedError
from forcectl.framework.fields import stacked
from forcectl.framework.linear_batch import WIDE
from forcectl.runs.logs import ChunkedLog, first_fault, to_dataset
from forcectl.runs.simulate import VariantOutcome, advance, ends_of_chunks, fault_of, judged, simulate
from forcectl.scenario.gains import asks_for_gains
from forcectl.scenario.scenario import Scenario

MOST = 200  # elements of a batch; more are hardly faster
_MOST_SAMPLES = 2e7  # largest number of samples of the signals of all elements
_ROWS = 10  # approximate number of signals of an element


def batch_size(scenario: Scenario) -> int:
    """How many scenarios like this one may run as one batch; 0 where it cannot.

    Args:
        scenario: complete.
    """
    if scenario.log or asks_for_gains(scenario) or not is_scalar(scenario.parts):
        return 0
    ticks = scenario.duration / (scenario.station.period or 0.002)
    return int(np.clip(_MOST_SAMPLES / (_ROWS * ticks), 1, MOST))


def simulate_batch(
    scenarios: Sequence[Scenario], variant: str, progress: Callable[[str, float], None] | None = None
) -> list[VariantOutcome]:
    """Simulate scenarios that differ only in the numbers that elements of a batch may differ in, and in their seeds.

    An outcome equals that of `simulate` to rounding, and bit for bit that in any other batch. A batch has no guard:
    an element on which the guard could have acted is simulated again, alone and with the guard.

    Args:
        scenarios: for which `batch_size` is not 0; of each a loop can be built.
        variant: its name, for the logs.
        progress: called with the variant and the share done, now and then.

    Raises:
        BadInputError: they differ in other values.
        RunFailedError: the simulation stopped.
    """
    workcell, settings, loops = scenarios[0].setting().workcell, [], []
    for scenario in scenarios:
        own = workcell.with_environment(scenario.station)
        settings.append(scenario.parts.setting(own))
        loops.append(scalar_loop(scenario.parts, own))
    # In a batch that is wide enough all blocks add up in the same order, whatever its size.
    missing = max(0, WIDE - len(loops))
    seeds = [scenario.seed for scenario in scenarios] + missing * [scenarios[-1].seed]
    loop = build_one_dimensional_loop(stacked(loops + missing * loops[-1:]), size=len(seeds), seeds=seeds)
    batch = _Batch(loop, scenarios, settings[0])
    times, values, failures = batch.run(lambda share: progress and progress(variant, share))
    outcomes = []
    for i, (scenario, setting) in enumerate(zip(scenarios, settings, strict=True)):
        failure, end = failures.get(i, (None, np.inf))
        kept = times <= end
        rows = batch.rows(values, i)[:, kept]
        bandwidth = scenario.model_bandwidth(scenario.parts.reference_model_bandwidth)
        if not batch.passes(i, scenario, setting, values[:, kept], failure is not None):
            outcomes.append(simulate(scenario, scenario.build(), variant))
            continue
        log = to_dataset(times[kept], rows, batch.signals, variant, bandwidth)
        outcomes.append(judged(scenario, setting, VariantOutcome(variant, log, failure=failure)))
    return outcomes


@dataclass(frozen=True)
class _Batch:
    """A loop whose first elements are scenarios of one robot."""

    loop: LoggedLoop
    scenarios: Sequence[Scenario]
    setting: Setting

    @cached_property
    def signals(self) -> Mapping[str, LoggedSignal]:
        """The signals of one element, as `simulate` logs them: those of the batch, and the motors of the robot."""
        joints = tuple(self.setting.workcell.robot.parameters.arm_joints)
        motors = LoggedSignal(slice(1, 1 + len(joints)), unit_of("motor_position"), joints, "joint")
        own = self.loop.signals
        first = next(iter(own))
        found = {first: LoggedSignal(slice(0, 1), own[first].unit, None), "motor_position": motors}
        for row, name in enumerate(list(own)[1:], 1 + len(joints)):
            found[name] = replace(own[name], rows=slice(row, row + 1), labels=None, dimension=None)
        # Zero where a guard does not act, see `passes`.
        if self.scenarios[0].guard is not None and "status" not in own:
            end = len(own) + len(joints)
            found["status"] = LoggedSignal(slice(end, end + 1), unit_of("status"), None)
        return found

    def rows(self, values: Array, element: int) -> Array:
        """The signals of an element (m, k) out of those of the batch (n, k)."""
        found = []
        for name in self.signals:
            if name == "motor_position":
                contact, start = self.setting.workcell.contact, self.setting.workcell.motor_start
                displacement = values[self.loop.signals["contact_displacement"].rows][element]
                found.append(start[:, None] + contact.direction[:, None] * displacement)
            elif name not in self.loop.signals:
                found.append(np.zeros((1, values.shape[1])))
            else:
                found.append(values[self.loop.signals[name].rows][[element]])
        return np.concatenate(found)

    def passes(self, element: int, scenario: Scenario, setting: Setting, values: Array, failed: bool) -> bool:
        """Whether the guard of an element, if it has one, would not have acted on any sample of the log (n, k)."""
        if scenario.guard is None:
            return True
        names = ("desired_force", "measured_force", "displacement_command")
        desired, measured, command = (values[self.loop.signals[name].rows][element] for name in names)
        return not failed and scenario.guard.passes(setting.model, desired, measured, command)

    def run(self, progress: Callable[[float], object]) -> tuple[Array, Array, dict[int, tuple[str, float]]]:
        """Simulate; returns times (k,) [s], the log (n, k), and reason and time [s] of failed elements."""
        simulator, log = Simulator(self.loop.diagram), ChunkedLog()
        context = simulator.get_mutable_context()
        failures: dict[int, tuple[str, float]] = {}
        signals, limits = self.signals, [scenario.limits() for scenario in self.scenarios]
        ends = ends_of_chunks(self.scenarios[0].duration)
        for i, end in enumerate(ends):
            cause, _ = advance(simulator, end)
            if cause is not None:
                raise RunFailedError("the simulation of a batch stopped") from cause
            times, values = log.take(self.loop.sink.FindMutableLog(context))
            for element in self._suspicious(values, limits):
                fault = first_fault(times, self.rows(values, element), signals, limits[element])
                if fault is not None and element not in failures:
                    name, when, value = fault
                    failures[element] = fault_of(name, when, value, signals[name].unit), when
            progress(i / (len(ends) - 1))
            if len(failures) == len(self.scenarios):
                break
        return *log.samples(), failures

    def _suspicious(self, values: Array, limits: Sequence[Mapping[str, float]]) -> list[int]:
        """Elements with a value that is not finite, or beyond a limit."""
        count, bad = len(self.scenarios), np.zeros(len(self.scenarios), dtype=bool)
        for name, signal in self.loop.signals.items():
            peaks = np.abs(values[signal.rows][:count]).max(axis=1, initial=0.0)
            bad |= ~(peaks <= [limit.get(name, np.finfo(float).max) for limit in limits])
        return np.flatnonzero(bad).tolist()

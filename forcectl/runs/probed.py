"""Samples of output ports that a scenario logs in addition to the signals of its loop."""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from forcectl.arrays import Array
from forcectl.diagrams.derived import Derived
from forcectl.diagrams.loop import Loop


class Probed:
    """Samples of the probes of a loop, taken at the times of its log.

    Args:
        loop: with or without probes.
        simulator: of its diagram; if there are probes, its monitor takes the samples.
    """

    def __init__(self, loop: Loop, simulator: Simulator):
        self._probes, self._period = loop.probes, loop.period
        self._taken: dict[int, list[Array]] = {}  # by tick
        root = simulator.get_context()
        ports = [probe.port for probe in self._probes]
        self._reads = [(port, port.get_system().GetMyContextFromRoot(root)) for port in ports]
        if self._probes:
            simulator.set_monitor(self._take)

    def _take(self, context: Context) -> EventStatus:
        tick = round(context.get_time() / self._period)
        if tick not in self._taken and abs(context.get_time() - tick * self._period) < 1e-6 * self._period:
            self._taken[tick] = [port.Eval(own).copy() for port, own in self._reads]
        return EventStatus.DidNothing()

    def samples(self, times: Array) -> dict[str, Derived]:
        """The signals at `times` (k,) [s] by name; NaN at times that the run has not reached."""
        found = {}
        for i, probe in enumerate(self._probes):
            missing = np.full(probe.port.size(), np.nan)
            rows = [
                self._taken[tick][i] if (tick := round(t / self._period)) in self._taken else missing for t in times
            ]
            samples = np.array(rows).reshape(len(times), probe.port.size())
            if probe.components is None:
                found[probe.name] = Derived(probe.unit, samples[:, 0])
            else:
                dimension, labels, units = probe.components
                found[probe.name] = Derived(probe.unit, samples, "", dimension, labels, units=units)
        return found

"""Findings of the guard: why it took over, and how it reacted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.findings.pressing import times
from forcectl.analysis.stretches import stretches
from forcectl.arrays import Array
from forcectl.force.guard.limits import Cause, Reaction

Codes = NDArray[np.int64]

GUARD = 10  # status = 10 times the guard's part plus the controller's own part, below 10
_SHOWN = 3  # causes of a run that are spelled out
_DOES = {
    Reaction.HOLD: "holds the command",
    Reaction.SLOW: "slows the command down",
    Reaction.RETREAT: "retreats from the surface",
    Reaction.STOP: "stops",
}
_WHY = {
    Cause.READING: "readings of the force are not numbers or not plausible",
    Cause.FROZEN: "the force sensor repeats its reading",
    Cause.REFERENCE: "the desired force is not a number or beyond the sensor's range",
    Cause.CONTACT: "the contact is lost",
    Cause.FORCE: "the force exceeds maximum_force, or is predicted to",
    Cause.COMMAND: "the controller's command jumps or is not a number",
    Cause.RESPONSE: "the measured force is too small for the displacement into the surface",
    Cause.ENERGY: "the energy that goes into the surface exceeds its limit",
}


def guard_codes(log: Any) -> Codes:
    """Reaction times ten plus cause at each tick, shape (k,); zeros where there is no guard.

    Args:
        log: over time.
    """
    if "status" not in log:
        return np.zeros(log.sizes["time"], dtype=np.int64)
    status = log["status"].values.reshape(log.sizes["time"], -1)
    return (np.nan_to_num(status).max(axis=1).astype(np.int64)) // GUARD


def own_status(status: Array) -> Array:
    """The controller's part of a status."""
    return np.mod(status, GUARD)


def guard_findings(log: Any) -> Iterator[RunFinding]:
    """The findings about the guard.

    Args:
        log: over time, of one variant.
    """
    codes, time = guard_codes(log), log["time"].values
    episodes = stretches(codes > 0)
    by_cause: dict[Cause, list[slice]] = {}
    for part in episodes:
        by_cause.setdefault(Cause(int(codes[part.start]) % 10), []).append(part)
    for cause, parts in list(by_cause.items())[:_SHOWN]:
        first = parts[0]
        spent = sum(part.stop - part.start for part in parts)
        worst = max(Reaction(int(codes[part].max()) // 10) for part in parts)
        begin = float(time[first.start])
        text = f"{_WHY[cause]}, from {begin:.3f} s on: the guard {_DOES[worst]}, {times(len(parts))}, for {spent} ticks"
        yield finding("guard_stopped" if worst == Reaction.STOP else "guarded", text, begin)

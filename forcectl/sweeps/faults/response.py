"""Outcome of a run with a fault, from its log: force, steps of the command, time until safe, what identifies it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from forcectl.analysis.findings.guard import guard_codes
from forcectl.arrays import Array, Mask
from forcectl.force.guard.limits import Cause
from forcectl.scenario.scenario import Scenario
from forcectl.sweeps.faults.declared import SOUND, DeclaredFault

# The norm of the forces along several normals, the largest of the forces on several arms.
_TRUE = {"contact_force": partial(np.linalg.norm, axis=1), "arm_contact_force": partial(np.max, axis=1)}
_COMMANDS = {"displacement_command": (1e3, "mm"), "joint_position_command": (1e3, "mrad")}
_MORE = 1.2  # times the largest desired force: the limit of a safe force where no maximum is given


@dataclass(frozen=True)
class Response:
    """A row of the table.

    Attributes:
        controller: tag of the controller.
        fault: name; `SOUND` for the run without one.
        peak_force: largest true force from the fault on [N]; None where the run has none.
        command_step: largest change of the command in a tick from the fault on.
        step_unit: unit of `command_step`.
        safe_time: from the fault until the force stays below its limit [s]; None: it is above at the end.
        status: of the guard at the end, the largest of several; None where the controller has no guard.
        named_by: statuses of the guard and kinds of findings that identify the fault.
        failure: why the run stopped; "" where it did not.
        finite: whether every command is a finite number.
    """

    controller: str
    fault: str
    peak_force: float | None = None
    command_step: float | None = None
    step_unit: str = ""
    safe_time: float | None = None
    status: int | None = None
    named_by: tuple[str, ...] = ()
    failure: str = ""
    finite: bool = True


def response_of(
    controller: str,
    fault: DeclaredFault | None,
    scenario: Scenario,
    log: Any,
    begin: float,
    findings: Sequence[str],
    sound: Sequence[str],
) -> Response:
    """The row of a run.

    Args:
        controller: tag.
        fault: None for the sound run.
        scenario: that was simulated.
        log: over time.
        begin: of the fault [s].
        findings: kinds of the findings of the run.
        sound: kinds of those of the run without a fault.
    """
    time = log["time"].values
    begin = 0.0 if fault is not None and fault.from_start else begin
    after = time >= begin - 1e-9
    force = next((truth(_rows(log, name)) for name, truth in _TRUE.items() if name in log), None)
    command, unit = next(((_rows(log, n) * k, u) for n, (k, u) in _COMMANDS.items() if n in log), (None, ""))
    steps = None if command is None else np.abs(np.diff(command, axis=0, prepend=command[:1])).max(axis=1)
    status = _rows(log, "status").max(axis=1) if "status" in log else None
    return Response(
        controller,
        SOUND if fault is None else fault.name,
        None if force is None or not after.any() else float(force[after].max()),
        None if steps is None or not after.any() else float(steps[after].max()),
        unit,
        None if force is None else _safe_after(time - begin, force, largest_force(scenario, log)),
        None if status is None or not len(status) else int(status[-1]),
        () if fault is None else _named(fault, log, after, findings, sound),
        finite=command is None or bool(np.isfinite(command).all()),
    )


def largest_force(scenario: Scenario, log: Any) -> float:
    """The true force below which a run is safe [N]: the guard's maximum, else a fifth above the largest desired."""
    guard = scenario.guard
    if guard is not None and guard.maximum_force is not None:
        return guard.maximum_force
    desired = _rows(log, "desired_force") if "desired_force" in log else np.zeros((1, 1))
    finite = desired[np.isfinite(desired)]
    return _MORE * float(finite.max(initial=0.0)) or np.inf


def _safe_after(since: Array, force: Array, limit: float) -> float | None:
    above = np.flatnonzero(force > limit)
    if not above.size or since[above[-1]] < 0:
        return 0.0
    last = int(above[-1])
    return float(since[last + 1]) if last + 1 < len(since) else None


def _named(
    fault: DeclaredFault, log: Any, after: Mask, findings: Sequence[str], sound: Sequence[str]
) -> tuple[str, ...]:
    seen = {int(code) % 10 for code in np.unique(guard_codes(log)[after])}
    causes = [
        f"status {cause.value}: {cause.name.lower()}" for cause in Cause if cause in fault.causes and cause in seen
    ]
    new = [kind for kind in dict.fromkeys(findings) if kind in fault.findings and kind not in sound]
    return (*causes, *new)


def _rows(log: Any, name: str) -> Array:
    """A signal, shape (k, n)."""
    return log[name].values.reshape(log.sizes["time"], -1)

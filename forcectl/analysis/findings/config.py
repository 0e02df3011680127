"""Scenario part `findings`: the checks of every run, and their thresholds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from forcectl.analysis.findings.compliance import compliance_findings
from forcectl.analysis.findings.finding import KINDS, RunFinding
from forcectl.analysis.findings.force import force_findings
from forcectl.analysis.findings.guard import guard_findings
from forcectl.analysis.findings.joints import joint_findings, task_findings
from forcectl.analysis.findings.pressing import SurfaceSignals
from forcectl.analysis.slot import surfaces
from forcectl.diagrams.model import Setting
from forcectl.errors import check_distinct
from forcectl.framework.fields import Config, key

_SHARE = "above 0 and below 1"


@dataclass(kw_only=True)
class FindingsConfig(Config):
    """Scenario part `findings`: thresholds. Shares of a force are relative to the reference."""

    largest_force: float | None = key(
        None, "largest true contact force that is allowed; null: no limit", unit="N", bounds="positive"
    )
    settled_share: float = key(
        0.05,
        "largest deviation from the reference at which a force counts as settled, as a share of the reference",
        bounds=_SHARE,
    )
    swing_share: float = key(
        0.02,
        "largest oscillation of the force, peak to peak, that may last, as a share of the reference",
        bounds=_SHARE,
    )
    growth: float = key(
        1.5,
        "growth of an oscillation, its later half by its earlier half, above which the loop counts as unstable",
        bounds="above 1 and at most 100",
    )
    bounce: float = key(0.05, "longest loss of contact that counts as a bounce", unit="s", bounds="not negative")
    saturated: float = key(
        0.2, "time at its extreme value after which a command counts as saturated", unit="s", bounds="positive"
    )
    chatter_rate: float = key(
        20.0,
        "rate of reversals from which on a command at rest counts as chattering",
        unit="1/s",
        bounds="above 0 and at most 10000",
    )
    chatter_share: float = key(
        0.002,
        "smallest reversal of the displacement command that counts as chatter: divided by the total compliance, as a "
        "share of the reference",
        bounds=_SHARE,
    )
    limit_share: float = key(
        0.01,
        "allowed excess over a joint limit, as a share of the speed limit or of the position range",
        bounds="from 0 to 1",
    )
    stuck: float = key(0.02, "shortest standstill of a joint that counts as sticking", unit="s", bounds="positive")
    releases: int = key(
        3, "number of releases of a sticking joint from which on stick-slip is reported", bounds="from 1 to 1000"
    )
    ignore: list[str] = key([], "kinds of findings that are left out", choices=lambda: KINDS)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("ignore", self.ignore)

    def found(self, log: Any, setting: Setting, motion: tuple[float, float] | None) -> list[RunFinding]:
        """The findings of one variant, ignored ones as well, by what they are of: surfaces, joints, tasks, guard.

        Args:
            log: over time.
            setting: of the run.
            motion: begin and end of the motion along the surface [s]; None without one.
        """
        return [
            *self._of_surfaces(log, setting, motion),
            *joint_findings(log, setting, self),
            *task_findings(log, setting),
            *guard_findings(log),
        ]

    def _of_surfaces(self, log: Any, setting: Setting, motion: tuple[float, float] | None) -> Iterator[RunFinding]:
        if "desired_force" not in log or "measured_force" not in log:
            return
        sensors = setting.workcell.config.sensors.values()
        ranges = [sensor.range for sensor in sensors if hasattr(sensor, "range")]
        filtered = all(getattr(sensor, "bandwidth", np.inf) * setting.workcell.period < 1 for sensor in sensors)
        truth = setting.truth
        robots, modelled = truth.robot_compliance, setting.model.environment_compliance
        compliances, contacts = robots + truth.environment_compliance, setting.workcell.contacts
        rows = zip(surfaces(log), contacts, compliances, robots, modelled, strict=True)
        for (label, one), contact, compliance, robot, of_model in rows:
            even = contact.surface if contact.surface is not None and contact.surface.even else None
            signals = SurfaceSignals.of(one, float(compliance), motion, even is not None)
            found = [*force_findings(signals, ranges, self, filtered)]
            if even is not None and even.materials is None:
                found += compliance_findings(signals, float(robot), float(of_model))
            for each in found:
                yield replace(each, text=f"{label[:-1]}: {each.text}") if label else each

"""Metrics of a part that is turned until it locks, under a contact force in a band (Fig. 6.17), from the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from forcectl.analysis.insertion import decided_in_the_air, part_orientation
from forcectl.analysis.slot import CONTACT_TRUTH, check_modes, check_parts, variants_of
from forcectl.analysis.tables.task_tables import KEPT_FORCE_METRICS
from forcectl.analysis.transitions import Stay, stays
from forcectl.diagrams.model import Setting
from forcectl.errors import check_distinct, invalid
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from forcectl.diagrams.log import LoggedSignal

_LOCKS = 0.02  # [Nm] true torque from which on the lock has begun


@dataclass(kw_only=True)
class KeptForceAnalysis(Config):
    """Scenario part `!KeptForce`.

    A rotation under a contact force in a band, by the true wrench of a `!ContactTruth`.

    Force and torque are those along and about the z axis of its frame. Angles and speeds are those of the task, as
    commanded.
    """

    needs: ClassVar[dict[str, str]] = CONTACT_TRUTH | {"task_position": "a controller of tasks"}

    mode: str = key("rotation", "mode in which the part is turned and the force must stay in the band")
    force: list[float] = key(
        meaning="lower and upper limit of the contact force", unit="N", bounds="not negative", size=2
    )
    settling: float = key(
        0.2,
        "time after the beginning of the mode that is left out of the band's metrics",
        unit="s",
        bounds="not negative",
    )
    turn: int = key(6, "number of the task coordinate of the rotation, from 1 on", bounds="positive")
    parts: list[str] = key(["cap", "mount"], "names of the two parts, whose z axes are parallel when aligned", size=2)
    on_contact: list[str] = key([], "modes that may begin in contact only")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.force[0] < self.force[1]:
            raise invalid("force", self.force, "the smaller one first")
        check_distinct("parts", self.parts)

    def check(self, signals: Mapping[str, LoggedSignal], setting: Setting) -> None:
        """Check that parts, modes and coordinate exist.

        Raises:
            BadInputError: one of them does not.
        """
        check_parts({f"parts.{i}": name for i, name in enumerate(self.parts)}, setting)
        check_modes({"mode": self.mode} | {f"on_contact.{i}": each for i, each in enumerate(self.on_contact)}, signals)
        rows = signals["task_position"].rows
        if self.turn > (most := rows.stop - rows.start):
            raise invalid("turn", self.turn, f"at most {most}, the number of coordinates")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `KEPT_FORCE_METRICS`; None where a run did not reach the mode, or a success."""
        found: dict[str, float | None] = dict.fromkeys(KEPT_FORCE_METRICS)
        time, force, torque, angle, speed = self._signals(log)
        touched = np.flatnonzero(force > 0.0)
        if len(touched):
            found["contact_s"] = float(time[touched[0]])
        visited = stays(log)
        found["decided_in_the_air"] = decided_in_the_air(time, force, visited, self.on_contact)
        turning = [stay for stay in visited if stay.mode == self.mode]
        if not turning:
            return found
        stay = turning[0]
        begin, end = np.searchsorted(time, [stay.begin - 1e-9, stay.end - 1e-9])
        found["force_at_switch_N"] = float(force[begin])
        found["tilt_at_switch_deg"] = self._tilt(log, setting, begin)
        kept = slice(begin + int(np.searchsorted(time[begin:], stay.begin + self.settling - 1e-9)), end)
        if kept.start < end:
            inside, turned = force[kept], speed[kept]
            mean = float(turned.mean())
            found["force_min_N"], found["force_max_N"] = float(inside.min()), float(inside.max())
            found["in_band_pct"] = 100.0 * float(np.mean((inside >= self.force[0]) & (inside <= self.force[1])))
            found["lost_pct"] = 100.0 * float(np.mean(force[begin:end] <= 0.0))
            found["turning_rad_s"] = mean
            found["turning_error_pct"] = 100.0 * float(np.abs(turned - mean).max()) / max(abs(mean), 1e-9)
        found["turned_rad"] = float(abs(angle[end] - angle[begin]))
        if any(later.kind == 1 for later in visited):
            found["torque_at_decision_Nm"] = float(abs(torque[end]))
            found["turned_after_decision_rad"] = float(np.abs(angle[end:] - angle[end]).max())
            found["torque_max_Nm"] = float(np.abs(torque[begin:]).max())
            free = np.flatnonzero(np.abs(torque[begin : end + 1]) < _LOCKS)
            since = begin + (int(free[-1]) if free.size else 0)
            found["turned_past_lock_rad"] = float(np.abs(angle[end:] - angle[since]).max())
        return found

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """True force, torque and angle of every variant, from the beginning of the mode on."""
        from forcectl.figures.of_variants import kept_force_figure

        runs = {}
        for name, run in variants_of(log).items():
            time, force, torque, angle, _ = self._signals(run)
            runs[name] = (time - _begin(stays(run), self.mode, time), force, torque, angle)
        return {"kept_force": kept_force_figure(runs, (self.force[0], self.force[1]), title)}

    def _tilt(self, log: Any, setting: Setting, tick: int) -> float:
        """Angle between the z axes of the parts [deg]."""
        turns = (part_orientation(log, setting, name)[tick] for name in self.parts)
        one, other = (turn.apply([0.0, 0.0, 1.0]) for turn in turns)
        return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))

    def _signals(self, log: Any) -> tuple[Any, ...]:
        """Time [s], force [N], torque [Nm], angle [rad] and speed [rad/s], shapes (n,)."""
        wrench, row = log["body_contact_wrench"].values, self.turn - 1
        motion = (log[name].values[:, row] for name in ("task_position", "task_velocity"))
        return log["time"].values, np.abs(wrench[:, 5]), wrench[:, 2], *motion


def _begin(found: list[Stay], mode: str, time: Any) -> float:
    """When the mode began [s]; the end of the log where it never did."""
    return next((stay.begin for stay in found if stay.mode == mode), float(time[-1]) if len(time) else math.nan)

"""A part that is turned under a contact force in a band, until it locks (Fig. 6.17): what is true of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.motion_metrics import KEPT_FORCE_METRICS
from forcectl.analysis.slot import variants_of
from forcectl.analysis.transitions import Stay, stays
from forcectl.diagrams.model import Setting
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOCKS = 0.02  # [Nm] of true torque that the lock begins with


@dataclass(kw_only=True)
class KeptForceAnalysis(Config):
    """Scenario part `!KeptForce`: a rotation under a force in a band, of the truth that a `!ContactTruth` has.

    Force and torque are those along and about the z axis of its frame. Angles and speeds are of the task, as commanded.
    """

    mode: str = key("rotation", "in which it turns, and the force is to stay in the band")
    force: list[float] = key(meaning="smallest and largest of the band", unit="N", bounds="not negative", size=2)
    settling: float = key(0.2, "after the beginning of the mode that is left out", unit="s", bounds="not negative")
    turn: int = key(6, "number of the task coordinate that turns, from 1 on", bounds="positive")
    tilts: list[int] = key([4, 5], "numbers of those that tilt", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.force[0] < self.force[1]:
            raise invalid("force", self.force, "the smaller one first")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `KEPT_FORCE_METRICS`; None where a run never came to the mode, or to a success."""
        found: dict[str, float | None] = dict.fromkeys(KEPT_FORCE_METRICS)
        time, force, torque, angle, speed = self._signals(log)
        touched = np.flatnonzero(force > 0.0)
        if len(touched):
            found["contact_s"] = float(time[touched[0]])
        way = stays(log)
        turning = [stay for stay in way if stay.mode == self.mode]
        if not turning:
            return found
        stay = turning[0]
        begin, end = np.searchsorted(time, [stay.begin - 1e-9, stay.end - 1e-9])
        tilt = log["task_position"].values[begin, [number - 1 for number in self.tilts]]
        found["force_at_switch_N"] = float(force[begin])
        found["tilt_at_switch_deg"] = float(np.degrees(np.abs(tilt)).max(initial=0.0))
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
        if any(later.kind == 1 for later in way):
            found["torque_at_decision_Nm"] = float(abs(torque[end]))
            found["turned_after_decision_rad"] = float(np.abs(angle[end:] - angle[end]).max())
            found["torque_max_Nm"] = float(np.abs(torque[begin:]).max())
            free = np.flatnonzero(np.abs(torque[begin : end + 1]) < _LOCKS)
            found["turned_past_lock_rad"] = float(np.abs(angle[end:] - angle[begin + free[-1]]).max())
        return found

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """True force, torque and angle of every variant, from the beginning of the mode on."""
        from forcectl.figures.kept_force import kept_force_figure

        runs = {}
        for name, run in variants_of(log).items():
            time, force, torque, angle, _ = self._signals(run)
            runs[name] = (time - _begin(stays(run), self.mode, time), force, torque, angle)
        return {"kept_force": kept_force_figure(runs, (self.force[0], self.force[1]), title)}

    def _signals(self, log: Any) -> tuple[Any, ...]:
        """Time [s], force [N], torque [Nm], angle [rad] and speed [rad/s], shapes (n,)."""
        wrench, row = log["body_contact_wrench"].values, self.turn - 1
        motion = (log[name].values[:, row] for name in ("task_position", "task_velocity"))
        return log["time"].values, np.abs(wrench[:, 5]), wrench[:, 2], *motion


def _begin(found: list[Stay], mode: str, time: Any) -> float:
    """When the mode began [s]; the end of the log where it never did."""
    return next((stay.begin for stay in found if stay.mode == mode), float(time[-1]) if len(time) else math.nan)

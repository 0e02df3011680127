"""How a flat tool aligns with a plate by means of the contact torque: metrics of the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from forcectl.analysis.slot import CONTACT_TRUTH, REFERENCE, variants_of
from forcectl.analysis.tables.task_tables import SURFACE_ALIGNMENT_METRICS
from forcectl.arrays import Array
from forcectl.diagrams.model import Setting
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(kw_only=True)
class SurfaceAlignmentAnalysis(Config):
    """Scenario part `!SurfaceAlignment`.

    For one surface, by the true wrench of a `!ContactTruth` at the TCP.
    """

    needs: ClassVar[dict[str, str]] = CONTACT_TRUTH | REFERENCE

    torque: float = key(0.2, "true contact torque below which the tool counts as aligned", unit="Nm", bounds="positive")
    deadline: float = key(3.0, "time from the start by which the tool must be aligned", unit="s", bounds="not negative")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `SURFACE_ALIGNMENT_METRICS`; None where the run ends before the deadline."""
        found: dict[str, float | None] = dict.fromkeys(SURFACE_ALIGNMENT_METRICS)
        time, torque, tilt = _signals(log, setting)
        outside = np.flatnonzero(torque >= self.torque)
        found["tilt_at_start_deg"], found["tilt_at_end_deg"] = float(tilt[0]), float(tilt[-1])
        found["torque_peak_Nm"] = float(torque.max())
        if len(outside) == 0 or outside[-1] + 1 < len(time):
            found["aligned_s"] = float(time[outside[-1] + 1] - time[0]) if len(outside) else 0.0
        after = time - time[0] >= self.deadline - 1e-9
        if after.any():
            found["aligned_torque_Nm"] = float(torque[after].max())
        pressed = after & (log["desired_force"].values.squeeze() != 0.0)
        if pressed.any():
            force, wanted = (log[name].values.squeeze()[pressed] for name in ("contact_force", "desired_force"))
            found["aligned_force_error_pct"] = 100.0 * float(np.max(np.abs(force - wanted) / np.abs(wanted)))
            found["aligned_mean_force_error_pct"] = 100.0 * float(np.mean(force - wanted) / np.mean(np.abs(wanted)))
        return found

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Force, torque and tilt of every variant."""
        from forcectl.figures.of_variants import surface_alignment_figure

        runs = {}
        for name, run in variants_of(log).items():
            time, torque, tilt = _signals(run, setting)
            runs[name] = (time, run["contact_force"].values.squeeze(), torque, tilt)
        return {"surface_alignment": surface_alignment_figure(runs, (self.torque, self.deadline), title)}


def _signals(log: Any, setting: Setting) -> tuple[Array, Array, Array]:
    """Time [s], magnitude of the contact torque at the TCP [Nm], tilt of the tool [deg]; each of shape (k,)."""
    contact, arms = setting.workcell.contact, list(setting.workcell.robot.parts.arms)
    w, x, y, z = log["tool_orientation"].values.reshape(-1, len(arms), 4)[:, arms.index(contact.arm)].T
    axis = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)])
    tilt = np.degrees(np.arccos(np.clip(-axis @ contact.n, -1.0, 1.0)))
    return log["time"].values, np.linalg.norm(log["body_contact_wrench"].values[:, :3], axis=1), tilt
